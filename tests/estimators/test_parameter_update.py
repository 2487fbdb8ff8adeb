"""The recursion of the parameters against P4's equations in plain numpy, and the excitation gate against a ring."""

import numpy as np
import pytest

from servohil.estimators.sensitivity.excitation import watch_excitation
from servohil.estimators.sensitivity.parameter_doubt import gather, recentre, refuted, reopen
from servohil.estimators.sensitivity.parameter_update import LARGEST_RESIDUAL, forget, gauss_newton, remember_error


def update(jacobian, residuals, noise, covariance, held):
    rows, k = jacobian.shape
    factor = np.linalg.cholesky(covariance).T.copy()
    change = np.zeros(k)
    seen, gain, stack = np.zeros((k, rows)), np.zeros((k, rows)), np.zeros((rows + k, max(rows, k)))
    scratch = np.zeros(2 * max(rows, k) + rows)
    done = gauss_newton(
        jacobian, residuals.copy(), rows, noise, len(noise), k, factor, held, seen, stack, gain, scratch, change
    )
    return done, change, factor.T @ factor


@pytest.mark.parametrize(("rows", "k", "held"), [(2, 3, []), (5, 2, []), (3, 4, [1, 2]), (1, 1, [0])])
def test_step_equals_the_equations(rows, k, held):
    rng = np.random.default_rng(rows)
    jacobian, residuals = rng.normal(size=(rows, k)), 0.1 * rng.normal(size=rows)
    noise, root = np.triu(rng.normal(size=(rows, rows))), rng.normal(size=(k, k))
    theta = root @ root.T + 0.1 * np.eye(k)
    mask = np.zeros(k)
    mask[held] = 1.0
    done, change, found = update(jacobian, residuals, noise, theta, mask)
    seen = np.where(mask > 0.0, 0.0, jacobian)
    delta = noise.T @ noise
    gain = theta @ seen.T @ np.linalg.inv(delta + seen @ theta @ seen.T)
    gain[held] = 0.0
    rest = np.eye(k) - gain @ seen
    assert done
    np.testing.assert_allclose(change, gain @ residuals, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(found, rest @ theta @ rest.T + gain @ delta @ gain.T, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(found[np.ix_(held, held)], theta[np.ix_(held, held)], rtol=1e-12)
    assert (change[held] == 0.0).all()


def test_a_linear_regression_is_solved_as_by_least_squares():
    rng = np.random.default_rng(3)
    true, theta = np.array([2.0, -1.0, 0.5]), 1e6 * np.eye(3)
    rows = rng.normal(size=(200, 2, 3))
    samples = rows @ true + rng.normal(size=(200, 2))
    found = np.zeros(3)
    for jacobian, y in zip(rows, samples, strict=True):
        _, change, theta = update(jacobian, y - jacobian @ found, np.eye(2), theta, np.zeros(3))
        found += change
    expected = np.linalg.lstsq(rows.reshape(-1, 3), samples.ravel(), rcond=None)[0]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(theta, np.linalg.inv(rows.reshape(-1, 3).T @ rows.reshape(-1, 3)), rtol=1e-4)


def test_outliers_move_the_parameters_no_farther_than_the_limit():
    jacobian, theta = np.eye(2), 0.25 * np.eye(2)
    small = update(jacobian, np.array([3.0, -4.0]), np.eye(2), theta, np.zeros(2))
    large = update(jacobian, np.array([3e9, -4e9]), np.eye(2), theta, np.zeros(2))
    np.testing.assert_allclose(small[1], [0.6, -0.8])
    norm = np.linalg.norm(large[1])
    np.testing.assert_allclose(norm, 0.2 * np.sqrt(1.25) * LARGEST_RESIDUAL * np.sqrt(2))
    np.testing.assert_allclose(large[1] / norm, [0.6, -0.8])
    np.testing.assert_allclose(large[2], small[2])


@pytest.mark.parametrize("residuals", [np.array([np.nan, 0.0]), np.array([np.inf, 0.0]), np.array([1e200, 0.0])])
def test_meaningless_numbers_change_nothing(residuals):
    theta = np.diag([1.0, 2.0])
    done, _, found = update(np.eye(2), residuals, np.eye(2), theta, np.zeros(2))
    assert not done
    np.testing.assert_allclose(found, theta, rtol=1e-14)
    assert not update(np.zeros((2, 2)), np.ones(2), np.zeros((2, 2)), theta, np.zeros(2))[0]


def test_forgetting_stops_at_the_largest_variance():
    covariance = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 3.0]])
    factor = np.linalg.cholesky(covariance).T.copy()
    forget(factor, 3, 0.8, np.array([100.0, 1.1, 100.0]))
    found = factor.T @ factor
    np.testing.assert_allclose(np.diag(found), [2.5, 1.1, 3.75])
    scale = np.sqrt(np.diag(found) / np.diag(covariance))
    np.testing.assert_allclose(found, covariance * np.outer(scale, scale))


def gathered(rng, wrong, moved):
    """[R, z] of 40 samples of three parameters that are wrong by `wrong`, then moved."""
    window, jacobian = np.zeros((3, 4)), rng.normal(size=(40, 3))
    residuals = jacobian @ wrong + rng.normal(size=40)
    for a in range(0, 40, 2):
        columns = np.vstack([jacobian[a : a + 2].T, residuals[a : a + 2]])
        gather(window, 3, columns, 2, np.zeros(20))
    recentre(window, 3, moved)
    return window, jacobian, residuals - jacobian @ moved


def test_window_in_doubt_equals_least_squares():
    rng = np.random.default_rng(5)
    window, jacobian, residuals = gathered(rng, np.array([0.0, 0.3, 0.0]), np.array([0.1, 0.0, 0.0]))
    root = np.triu(0.05 * rng.normal(size=(4, 4)))
    theta, largest = root.T @ root, np.array([4.0, 1.0, 2.0, 1.0])
    np.testing.assert_allclose(window[:, :3].T @ window[:, :3], jacobian.T @ jacobian, rtol=1e-10)
    np.testing.assert_allclose(window[:, :3].T @ window[:, 3], jacobian.T @ residuals, rtol=1e-9, atol=1e-10)
    for held in (np.zeros(4), np.array([0.0, 0.0, 1.0, 0.0])):
        on = held[:3] == 0.0

        def cost(variances, on=on):
            seen = jacobian[:, on]
            return residuals @ np.linalg.solve(np.eye(40) + seen * variances[:3][on] @ seen.T, residuals)

        limit = np.sqrt((cost(np.diag(theta)) - cost(largest)) / on.sum())
        for factor, expected in ((0.999, True), (1.001, False)):
            assert refuted(window, 4, 3, held, root.copy(), largest, factor * limit, np.zeros(100)) == expected


def test_only_what_explains_a_jump_is_reopened():
    rng = np.random.default_rng(6)
    window, _, _ = gathered(rng, np.array([0.0, 3.0, 0.0]), np.zeros(3))
    root = np.triu(0.03 * rng.normal(size=(4, 4))) + 0.03 * np.eye(4)
    theta, largest = root.T @ root, np.array([4.0, 1.0, 2.0, 1.0])
    factor = root.copy()
    reopen(window, 4, 3, np.zeros(4), factor, largest, 3.0, np.zeros(100))
    expected = theta.copy()
    expected[1], expected[:, 1] = 0.0, 0.0
    expected[1, 1] = 1.0
    np.testing.assert_allclose(factor.T @ factor, expected, atol=1e-15)


def test_mean_of_the_prediction_errors_follows_p4_and_leaves_missing_channels():
    s, forgetting = np.array([[4.0, 1.0], [1.0, 9.0]]), 0.9
    factor, stack = np.zeros((2, 2)), np.zeros((3, 2))
    e = np.array([1.0, -2.0])
    remember_error(factor, 2, e, e, forgetting, s, stack, np.zeros(1))
    expected = forgetting * np.diag([4.0, 9.0]) + (1 - forgetting) * np.outer(e, e)
    np.testing.assert_allclose(factor.T @ factor, expected)
    missing = np.array([np.nan, 5.0])
    remember_error(factor, 2, missing, missing, forgetting, s, stack, np.zeros(1))
    found = factor.T @ factor
    np.testing.assert_allclose(found[0, 0], expected[0, 0])
    np.testing.assert_allclose(found[1, 1], forgetting * expected[1, 1] + (1 - forgetting) * 25.0)
    np.testing.assert_allclose(found[0, 1], np.sqrt(forgetting) * expected[0, 1])


def test_excitation_of_a_window_against_its_largest_and_a_least_value():
    n, m, k, window, memory = 1, 2, 3, 4, 50.0
    rng = np.random.default_rng(0)
    sums, clock, held = np.zeros((4, k)), np.zeros(1), np.zeros(k)
    weights, threshold, least = np.array([2.0, 1.0, 0.5]), np.array([0.5, 0.0, 0.5]), 0.6
    history, largest = [], np.zeros(k)
    for step in range(60):
        size = np.array([1.0 if step < 20 or step > 45 else 0.2, 0.1, 1.0])[:, None]
        of_state, of_outputs = size[:2] * rng.normal(size=(2, n)), size[:2] * rng.normal(size=(2, m))
        jacobian = size.T * rng.normal(size=(2, k))
        y = np.array([0.0, np.nan if step % 3 == 0 else 0.0])
        rows = 0 if step % 7 == 0 else 2
        watch_excitation(
            of_state, of_outputs, jacobian, rows, y, weights, n, m, k, 2, window, memory, threshold, least, sums,
            clock, held,
        )  # fmt: skip
        present = np.where(np.isnan(y), 0.0, weights[1:])
        model = weights[0] * of_state[:, 0] ** 2 + (of_outputs**2) @ present
        added = np.concatenate([model, [np.sum(jacobian[:, 2] ** 2)]]) if rows else np.zeros(k)
        history.append(added)
        passed = step % window + 1
        norm = np.sum(history[max(0, step - window - passed + 1) :], axis=0) * window / (window + passed)
        largest = np.maximum(norm, largest * (1.0 - 2.0 / memory))
        np.testing.assert_allclose(sums[2], norm, rtol=1e-12)
        enough = np.maximum(least**2, np.array([0.25, 0.0, 0.0]) * largest)
        np.testing.assert_array_equal(held, norm < enough)
    assert np.sum(history) > 0.0
