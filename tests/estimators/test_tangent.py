"""Derivatives of factors and of a sample period against closed forms and differences."""

import numpy as np
import pytest
from numba import njit

from servohil.estimators.integrate import discrete, rk4
from servohil.estimators.sensitivity.tangent import differentiate_factor, divide_by_factor, triangularise_beside
from servohil.estimators.sensitivity.tangent_model import state_scales, tangent_discrete, tangent_rk4


def derivative_of_factor(a, da):
    """R with R'R = A'A, and its derivative from that of A'A: dR = up(R^-T (dA'A + A'dA) R^-1) R, half the diagonal."""
    upper = np.linalg.cholesky(a.T @ a).T
    inner = np.linalg.solve(upper.T, da.T @ a + a.T @ da) @ np.linalg.inv(upper)
    return upper, (np.triu(inner) - 0.5 * np.diag(np.diag(inner))) @ upper


def differentiated(a, *derivatives):
    rows, size = a.shape
    array = np.hstack([a, *derivatives])
    triangularise_beside(array, rows, size, array.shape[1])
    for j in range(len(derivatives)):
        differentiate_factor(array, size, size * (1 + j))
    return [np.triu(array[:size, size * j : size * (j + 1)]) for j in range(1 + len(derivatives))]


@pytest.mark.parametrize(("rows", "size"), [(1, 1), (4, 4), (12, 7), (30, 5)])
def test_derivative_of_the_factor_equals_the_closed_form(rows, size):
    rng = np.random.default_rng(rows)
    a, *derivatives = rng.normal(size=(4, rows, size))
    found = differentiated(a, *derivatives)
    for da, dr in zip(derivatives, found[1:], strict=True):
        upper, expected = derivative_of_factor(a, da)
        np.testing.assert_allclose(found[0], upper, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(dr, expected, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(found[0].T @ dr + dr.T @ found[0], da.T @ a + a.T @ da, rtol=1e-10, atol=1e-11)


def test_ill_conditioned_factors_keep_their_derivative():
    # columns within 1e-7 of each other: the closed form above has lost all digits here, the product rule has not
    rng = np.random.default_rng(5)
    common = rng.normal(size=(9, 1))
    a = common + 1e-7 * rng.normal(size=(9, 3))
    da = rng.normal(size=(9, 3))
    upper, dr = differentiated(a, da)
    step = 1e-11
    ahead = np.linalg.qr((a + step * da).astype(np.float64), mode="r")
    back = np.linalg.qr((a - step * da).astype(np.float64), mode="r")
    signs = [np.where(np.diag(r) < 0.0, -1.0, 1.0)[:, None] for r in (ahead, back)]
    np.testing.assert_allclose(dr, (ahead * signs[0] - back * signs[1]) / (2 * step), rtol=2e-3, atol=1e-4)
    product = upper.T @ dr + dr.T @ upper
    np.testing.assert_allclose(product, da.T @ a + a.T @ da, rtol=1e-13, atol=1e-13)


def test_a_vanishing_pivot_leaves_finite_numbers():
    rng = np.random.default_rng(1)
    a, da = rng.normal(size=(2, 5, 3))
    a[:, 1] = 0.0
    upper, dr = differentiated(a, da)
    assert np.isfinite(dr).all() and upper[1, 1] == 0.0


def test_division_of_a_row_by_the_factor():
    rng = np.random.default_rng(2)
    upper = np.triu(rng.normal(size=(5, 5))) + 3.0 * np.eye(5)
    block = rng.normal(size=(5, 9))
    out = np.full(5, 7.0)
    divide_by_factor(upper, 4, block, 3, 1, out)
    row = np.concatenate([[0.0], block[1, 4:7]])
    np.testing.assert_allclose(out[1:4], np.linalg.solve(upper[:4, :4].T, row)[1:], rtol=1e-12)
    assert out[0] == out[4] == 7.0


@njit
def bent(x, u, p, dx):
    dx[0] = x[1] - 0.1 * x[0] ** 3
    dx[1] = -p[1] * np.sin(x[0]) - p[0] * np.arctan(5.0 * x[1]) + p[2] * u[0]


@pytest.mark.parametrize(("plain", "tangent"), [(rk4, tangent_rk4), (discrete, tangent_discrete)])
def test_tangents_of_a_sample_period_equal_differences_of_it(plain, tangent):
    n, dt, substeps, u = 2, 0.1, 2, np.array([0.7])
    index, rates = np.array([2.0, 0.0, 0.0]), np.array([2.0, 0.3, 1.0])  # the third tangent moves no parameter
    start = np.array([0.4, -0.3])
    directions = np.array([[0.2, -1.0], [0.0, 0.0], [3.0, 0.5]])

    @njit
    def whole(x, p, stages):
        plain(bent, n, dt, substeps, x, u, p, stages)

    @njit
    def beside(x, tangents, p, scales, stages, scratch):
        tangent(bent, n, 3, 2, dt, substeps, x, tangents, u, p, index, rates, scales, stages, scratch)

    def moved(j, t):
        x, p = start + t * directions[j], np.array([0.5, 2.0, 1.5])
        if j < 2:
            p[int(index[j])] += t * rates[j]
        whole(x, p, np.zeros((5, n)))
        return x

    x, p, found, scales = start.copy(), np.array([0.5, 2.0, 1.5]), directions.copy(), np.zeros(n)
    state_scales(start, np.diag([0.05, 0.1]), n, scales)
    np.testing.assert_array_equal(scales, [0.05, 0.1])
    beside(x, found, p, scales, np.zeros((5, n)), np.zeros((12, n)))
    np.testing.assert_array_equal(p, [0.5, 2.0, 1.5])
    np.testing.assert_array_equal(x, moved(0, 0.0))
    t = 1e-3
    for j in range(3):
        expected = (8.0 * (moved(j, t) - moved(j, -t)) - (moved(j, 2 * t) - moved(j, -2 * t))) / (12.0 * t)
        np.testing.assert_allclose(found[j], expected, rtol=1e-7, atol=1e-7)
