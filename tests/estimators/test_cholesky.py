import numpy as np
import pytest

from servohil.estimators.linear_algebra.cholesky import cholesky, downdate, update


def covariance(size, seed, spread=0.0):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size)) * 10.0 ** (spread * rng.normal(size=size))
    return root.T @ root + 1e-3 * np.diag(np.diag(root.T @ root))


@pytest.mark.parametrize(("size", "spread"), [(1, 0), (4, 0), (4, 5), (11, 0)])
def test_factor_update_and_downdate_are_those_of_the_matrix(size, spread):
    rng = np.random.default_rng(size)
    matrix = covariance(size, size, spread)
    scale = np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    upper = np.full((size + 1, size + 2), 7.0)
    assert cholesky(np.triu(matrix) + np.tril(np.full((size, size), np.nan), -1), size, upper)
    assert (upper[size:] == 7.0).all() and (upper[:, size:] == 7.0).all()
    upper = upper[:size, :size].copy()
    np.testing.assert_allclose(upper, np.linalg.cholesky(matrix).T, rtol=1e-9, atol=0)
    vector = rng.normal(size=size) * np.sqrt(np.diag(matrix))
    grown = upper.copy()
    update(grown, size, vector.copy())
    assert (np.abs(grown.T @ grown - matrix - np.outer(vector, vector)) < 1e-13 * scale).all()
    assert (np.diag(grown) > 0).all() and (np.tril(grown, -1) == 0).all()
    assert downdate(grown, size, vector.copy())
    assert (np.abs(grown.T @ grown - matrix) < 1e-12 * scale).all()
    assert (np.tril(grown, -1) == 0).all()


@pytest.mark.parametrize("entry", [(0, 0), (1, 2), (3, 3)])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_has_no_factor(entry, value):
    matrix = covariance(4, 0)
    matrix[entry] = matrix[entry[::-1]] = value
    assert not cholesky(matrix, 4, np.zeros((4, 4)))


def test_what_is_not_definite_to_rounding_has_no_factor():
    upper = np.zeros((2, 2))
    for correlation, definite in ((0.999, True), (1 - 1e-13, True), (1 - 1e-15, False), (1.0, False), (1.1, False)):
        for scale in (1e-8, 1.0, 1e8):  # the verdict does not depend on units
            matrix = np.array([[1.0, correlation * scale], [correlation * scale, scale * scale]])
            assert cholesky(matrix, 2, upper) == definite, (correlation, scale)
    assert not cholesky(np.zeros((2, 2)), 2, upper)
    assert not cholesky(-np.eye(2), 2, upper)


def test_a_downdate_that_leaves_nothing_is_refused():
    rng = np.random.default_rng(2)
    upper = np.linalg.cholesky(covariance(4, 1)).T.copy()
    unit = rng.normal(size=4)
    direction = upper.T @ unit / np.linalg.norm(unit)  # R'R - v v' is just singular
    for factor, possible in ((0.5, True), (1 - 1e-6, True), (1 + 1e-9, False), (2.0, False), (np.nan, False)):
        assert downdate(upper.copy(), 4, factor * direction) == possible, factor


def test_an_update_of_nothing_and_with_nothing():
    upper = np.zeros((3, 3))
    update(upper, 3, np.zeros(3))
    assert (upper == 0).all()
    update(upper, 3, np.array([0.0, -2.0, 1.0]))
    np.testing.assert_allclose(upper.T @ upper, [[0, 0, 0], [0, 4, -2], [0, -2, 1]])
