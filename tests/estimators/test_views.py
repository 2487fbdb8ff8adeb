import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from servohil.estimators.linear_algebra.views import matrix_at, vector_at


def use(base, start, rows, columns):
    vector = vector_at(base, start, rows)
    matrix = matrix_at(base, start + rows, rows, columns)
    total = 0.0
    for i in range(vector.shape[0]):
        vector[i] += 100.0
        for j in range(matrix.shape[1]):
            matrix[i, j] *= 10.0 + i + 0.1 * j
        for value in matrix[i]:
            total += value
    return total, vector.size + 10 * matrix.size + 100 * matrix.shape[0]


def test_compiled_views_are_the_slices_that_python_gives():
    plain, compiled = np.arange(40.0), np.arange(40.0)
    assert use(plain, 3, 4, 5) == pytest.approx(njit(use)(compiled, 3, 4, 5))
    np.testing.assert_array_equal(compiled, plain)
    assert (plain[:3] == np.arange(3)).all() and (plain[27:] == np.arange(27, 40)).all()
    assert (plain[3:27] != np.arange(3, 27)).all()


def test_rows_of_a_matrix_count_as_one_behind_the_other():
    tall = np.arange(12.0).reshape(4, 3)
    assert njit(use)(tall.copy(), 1, 2, 3) == pytest.approx(use(tall.copy(), 1, 2, 3))


@njit
def matrix_of(base):
    return matrix_at(base, 0, 2, 2)[0, 0]


@pytest.mark.parametrize("base", [np.zeros((2, 4))[:, ::2], np.zeros(8)[::2], np.zeros(4, dtype=np.float32)])
def test_only_contiguous_float64_arrays_have_views(base):
    with pytest.raises(TypingError):
        matrix_of(base)
