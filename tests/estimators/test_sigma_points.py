import numpy as np
import pytest
from numba import njit

from servohil.estimators.model import difference
from servohil.estimators.sigma_point.sigma_points import SigmaPointError, draw, mean, scaled_weights

subtract = njit(difference)


@pytest.mark.parametrize("n", [1, 4, 11])
@pytest.mark.parametrize(("alpha", "beta", "kappa"), [(1, 2, 0), (0.52, 2, 0), (1.9, 2, 0), (1, 0, 1), (1.2, 2, -0.5)])
def test_points_carry_the_mean_and_covariance_they_were_drawn_from(n, alpha, beta, kappa):
    rng = np.random.default_rng(n)
    x, root = rng.normal(size=n), np.tril(rng.normal(size=(n, n)))
    weights = scaled_weights(n, alpha, beta, kappa)
    points = np.empty((2 * n + 1, n))
    draw(x, np.ascontiguousarray(root.T), weights.spread, n, points)
    average = np.empty(n)
    mean(subtract, points, 2 * n + 1, n, weights.outer, np.empty(n), average)
    np.testing.assert_allclose(average, x, rtol=1e-12)
    deviations = points[1:] - x
    np.testing.assert_allclose(weights.outer * deviations.T @ deviations, root @ root.T, rtol=1e-10, atol=1e-10)
    lam = alpha**2 * (n + kappa) - n
    assert weights.covariance_centre == pytest.approx(lam / (n + lam) + 1 - alpha**2 + beta, abs=1e-12)


@pytest.mark.parametrize(
    ("alpha", "allowed"), [(0.517, False), (0.519, True), (1.93, True), (1.94, False), (1e-3, False)]
)
def test_the_stated_range_of_alpha_is_the_one_that_works(alpha, allowed):
    for n in (1, 4, 11):
        if allowed:
            assert scaled_weights(n, alpha, 2.0, 0.0).covariance_centre >= 0
        else:
            with pytest.raises(SigmaPointError, match=r"alpha = .*beta = 2.0, kappa = 0.0.*between 0\.5176 and 1\.932"):
                scaled_weights(n, alpha, 2.0, 0.0)


def test_the_range_named_in_the_message_is_tight_for_other_settings():
    with pytest.raises(SigmaPointError, match="between") as caught:
        scaled_weights(4, 0.1, 1.0, 2.0)
    low, high = (float(word.rstrip(",")) for word in str(caught.value).split("between ")[1].split(" and "))
    for edge, inside in ((low, 1.001), (high, 0.999)):
        assert scaled_weights(4, edge * inside, 1.0, 2.0).covariance_centre >= 0
        with pytest.raises(SigmaPointError):
            scaled_weights(4, edge / inside, 1.0, 2.0)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((0.0, 2, 0), "alpha"), ((float("nan"), 2, 0), "alpha"), ((1, float("inf"), 0), "beta"), ((1, 2, -4), "kappa"),
        ((1, -1.5, 0), "no alpha"),
    ],
)  # fmt: skip
def test_nonsense_is_refused_by_name(arguments, name):
    with pytest.raises(SigmaPointError, match=name):
        scaled_weights(4, *arguments)
