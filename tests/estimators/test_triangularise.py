import numpy as np
import pytest
from numba import njit

from servohil.estimators.linear_algebra.reflection import reflect_four
from servohil.estimators.linear_algebra.triangularise import (
    solve_transposed,
    triangularise,
    triangularise_below,
    triangularise_onto,
)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (3, 3), (12, 7), (34, 22)])
def test_factor_of_the_same_matrix_upper_with_positive_diagonal(rows, columns):
    rng = np.random.default_rng(rows)
    array = np.zeros((rows + 2, columns + 1))  # larger than what is in use: the rest must not be touched
    array[:] = 7.0
    array[:rows, :columns] = rng.normal(size=(rows, columns))
    gram = array[:rows, :columns].T @ array[:rows, :columns]
    triangularise(array, rows, columns, np.empty(columns))
    upper = np.triu(array[:columns, :columns])
    np.testing.assert_allclose(upper.T @ upper, gram, rtol=1e-13, atol=1e-13 * gram.max())
    np.testing.assert_allclose(upper.T, np.linalg.cholesky(gram), rtol=1e-9, atol=1e-12)
    assert (array[rows:] == 7.0).all() and (array[:, columns:] == 7.0).all()


def test_rows_of_very_different_size_keep_their_relative_accuracy():
    rng = np.random.default_rng(1)
    scale = np.array([1e-12, 1.0, 1e9])
    array = rng.normal(size=(7, 3))
    scaled = array * scale
    triangularise(array, 7, 3, np.empty(3))
    triangularise(scaled, 7, 3, np.empty(3))
    np.testing.assert_allclose(np.triu(scaled[:3]), np.triu(array[:3]) * scale, rtol=1e-13, atol=0)


@pytest.mark.parametrize("array", [np.zeros((5, 3)), -np.eye(3), np.eye(5, 3) * -2, np.full((4, 2), 1e-200)])
def test_singular_and_negative_arrays_give_finite_factors(array):
    array = array.copy()
    gram = array.T @ array
    triangularise(array, len(array), array.shape[1], np.empty(3))
    upper = np.triu(array[: array.shape[1]])
    assert np.isfinite(upper).all() and (np.diag(upper) >= 0).all()
    np.testing.assert_allclose(upper.T @ upper, gram, atol=1e-300)


def test_an_exact_sensor_after_a_vague_start_leaves_its_own_variance():
    # [[sigma, sigma], [s, 0]]: prediction with sigma, sensor with s; the corrected deviation is s
    for sigma, s in ((1e4, 1e-16), (1e20, 1e-20), (-1e4, 1e-16)):
        array = np.array([[sigma, sigma], [s, 0.0]])
        triangularise(array, 2, 2, np.empty(2))
        np.testing.assert_allclose(array[1, 1], s, rtol=1e-12)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (3, 2), (9, 4), (23, 11), (2, 6)])
def test_a_triangle_below_gives_what_its_full_rows_give(rows, columns):
    rng = np.random.default_rng(columns)
    above, square = rng.normal(size=(rows, columns)), rng.normal(size=(columns, columns))
    array = np.full((rows + columns + 1, columns + 2), 7.0)
    array[:rows, :columns] = above
    triangularise_onto(array, rows, columns, square)  # what lies below the diagonal of the square is not read
    triangle = np.triu(square)
    expected = np.linalg.cholesky(above.T @ above + triangle.T @ triangle).T
    np.testing.assert_allclose(np.triu(array[:columns, :columns]), expected, rtol=1e-9, atol=1e-12)
    assert (array[rows + columns :] == 7.0).all() and (array[:, columns:] == 7.0).all()


@pytest.mark.parametrize(("head", "size"), [(0, 3), (1, 1), (1, 4), (3, 7), (3, 14), (5, 6)])
def test_rows_in_triangular_form_give_what_a_decomposition_of_all_gives(head, size):
    rng = np.random.default_rng(size)
    square = rng.normal(size=(size, size))
    square[:head, :head] = np.triu(square[:head, :head])
    array = np.full((size + 1, size + 2), 7.0)
    array[:size, :size] = square
    array[:head, :head][np.tril_indices(head, -1)] = np.nan  # not read
    triangularise_below(array, head, size)
    expected = np.linalg.cholesky(square.T @ square).T
    np.testing.assert_allclose(np.triu(array[:size, :size]), expected, rtol=1e-8, atol=1e-10)
    assert (array[size:] == 7.0).all() and (array[:, size:] == 7.0).all()


@pytest.mark.parametrize(
    ("k", "j", "first", "rows"), [(0, 1, 1, 9), (2, 4, 5, 5), (2, 4, 5, 6), (3, 0, 4, 9), (5, 3, 6, 8)]
)
def test_four_columns_are_reflected_as_plain_arithmetic_says(k, j, first, rows):
    rng = np.random.default_rng(rows)
    array = rng.normal(size=(10, 9))
    v, column = 1.3, array[:, k].copy()
    w = np.where((np.arange(10) >= first) & (np.arange(10) < rows), column, 0.0)
    w[k] = v
    expected = array.copy()
    expected[:, j : j + 4] -= 0.7 * np.outer(w, w @ array[:, j : j + 4])
    plain = array.copy()
    reflect_four(plain, k, j, first, rows, v, 0.7)
    njit(lambda a: reflect_four(a, k, j, first, rows, v, 0.7))(array)
    np.testing.assert_allclose(array, expected, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(plain, expected, rtol=1e-13, atol=1e-14)


def test_forward_substitution():
    rng = np.random.default_rng(3)
    upper = np.triu(rng.normal(size=(6, 6))) + 3 * np.eye(6)
    rhs = rng.normal(size=6)
    solution = rhs.copy()
    solve_transposed(upper, 4, solution)
    np.testing.assert_allclose(upper[:4, :4].T @ solution[:4], rhs[:4], rtol=1e-12)
    np.testing.assert_array_equal(solution[4:], rhs[4:])
