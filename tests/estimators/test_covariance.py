import numpy as np
import pytest

from servohil.estimators.covariance import CovarianceError, checked_factor, lower_factor


def test_definite_semidefinite_and_badly_scaled_matrices_are_factored():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4))
    for matrix in (root @ root.T, np.diag([1e-24, 1.0, 1e12, 1e-9]), root[:, :2] @ root[:, :2].T, np.zeros((4, 4))):
        factor = lower_factor("Q", matrix, 4, definite=False)
        np.testing.assert_allclose(factor @ factor.T, matrix, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(factor, np.tril(factor))
        assert (np.diag(factor) >= 0).all()


@pytest.mark.parametrize("columns", [1, 3, 7])
def test_any_factor_is_brought_into_triangular_form(columns):
    factor = np.random.default_rng(columns).normal(size=(3, columns))
    lower = checked_factor("chol_Q", factor, 3)
    np.testing.assert_allclose(lower @ lower.T, factor @ factor.T, atol=1e-12)
    np.testing.assert_array_equal(lower, np.tril(lower))


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ([[1.0, 0.5], [0.4, 1.0]], "symmetric"),
        ([[1.0, 2.0], [2.0, 1.0]], "positive"),
        ([[1.0, 0.0], [0.0, -1e-6]], "positive"),
        ([[1e-9, 0.0], [0.0, -1e-12]], "positive"),
        ([[1.0, np.nan], [np.nan, 1.0]], r"P0\[0, 1\] = .*nan.*finite"),
        ([1.0, 1.0], r"shape \(2,\): must be \(2, 2\)"),
        ([["a", "b"], ["c", "d"]], "numbers"),
    ],
)
def test_errors_name_argument_value_and_rule(matrix, words):
    with pytest.raises(CovarianceError, match=words) as caught:
        lower_factor("P0", matrix, 2, definite=False)
    assert "P0" in str(caught.value)


def test_a_singular_matrix_is_refused_where_definiteness_is_needed():
    with pytest.raises(CovarianceError, match="positive definite"):
        lower_factor("P0", np.diag([1.0, 0.0]), 2, definite=True)
    with pytest.raises(CovarianceError, match=r"chol_Q has shape \(3, 2\)"):
        checked_factor("chol_Q", np.ones((3, 2)), 2)
