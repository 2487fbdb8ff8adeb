import numpy as np
import pytest
from hydraulic_bench import healthy_motion, srukf
from scipy.stats import chi2, norm

from servohil.estimators.consistency import (
    CONSISTENT,
    OVERCONFIDENT,
    PESSIMISTIC,
    ConsistencyError,
    chi2_interval,
    consistency,
    nees,
    nis,
    whiteness,
)

NAN = float("nan")


def test_nees_is_the_quadratic_form_also_with_units_far_apart():
    rng = np.random.default_rng(0)
    units = np.array([1e-9, 1.0, 1e9])
    root = rng.normal(size=(6, 5, 3, 3))
    covariance = root @ root.transpose(0, 1, 3, 2) + 0.1 * np.eye(3)
    true, estimate = rng.normal(size=(2, 6, 5, 3))
    scaled = nees(true * units, estimate * units, covariance * np.outer(units, units))
    assert scaled.shape == (6, 5)
    for i, j in np.ndindex(6, 5):
        error = true[i, j] - estimate[i, j]
        assert scaled[i, j] == pytest.approx(error @ np.linalg.solve(covariance[i, j], error), rel=1e-9)
    assert nees([1.0, 0.0], [0.0, 2.0], np.diag([4.0, 1.0])) == pytest.approx(4.25)


@pytest.mark.parametrize(("dof", "runs", "probability", "family"), [(4, 200, 0.999, 7), (3, 1, 0.95, 1)])
def test_intervals_against_scipy(dof, runs, probability, family):
    tail = (1 - probability) / 2 / family
    low, high = chi2_interval(dof, runs, probability, family)
    assert low == pytest.approx(chi2.ppf(tail, dof * runs) / runs, rel=1e-10)
    assert high == pytest.approx(chi2.isf(tail, dof * runs) / runs, rel=1e-10)


def test_a_consistent_filter_fails_as_often_as_stated_and_wrong_ones_are_named():
    rng = np.random.default_rng(1)
    verdicts = [consistency(rng.chisquare(4, size=(30, 5)), 4, 0.8).verdict for _ in range(2000)]
    passed = verdicts.count(CONSISTENT) / 2000
    assert 0.8 - 0.03 < passed < 0.8 + 0.05  # Bonferroni errs on the side of passing
    assert verdicts.count(OVERCONFIDENT) > 50 and verdicts.count(PESSIMISTIC) > 50
    values = rng.chisquare(4, size=(200, 3))
    assert consistency(values, 4).consistent
    values[:, 1] *= 1.5
    assert consistency(values, 4).verdict == OVERCONFIDENT
    values[:, 2] /= 3.0
    assert consistency(values, 4).verdict == PESSIMISTIC
    values[3, 0] = NAN
    assert not consistency(values[:, :1], 4).consistent


def test_degrees_of_freedom_follow_the_channels_present():
    rng = np.random.default_rng(2)
    freedom = rng.integers(0, 4, size=(3000, 1))
    values = np.where(freedom > 0, rng.chisquare(np.maximum(freedom, 1)), 77.0)
    result = consistency(values, freedom)
    used = freedom > 0
    assert result.consistent
    assert result.mean[0] == pytest.approx(values[used].mean())
    tail, count = 0.0005, used.sum()
    assert result.low[0] == pytest.approx(chi2.ppf(tail, freedom.sum()) / count)
    assert consistency(values, np.where(used, 3, 0)).verdict == PESSIMISTIC


def test_nis_of_a_run_counts_only_steps_with_an_innovation_of_their_own():
    inputs, samples, _ = healthy_motion(400)
    samples[50:60, 1] = NAN
    samples[100] = NAN
    samples[150, 0] = np.inf
    inputs[200, 1] = NAN
    inputs[250, 0] = 1e300
    samples[300, 2] = 1e300
    sums = nis(srukf().run(inputs, samples))
    expected = np.full(400, 3)
    expected[50:60] = 2
    expected[[100, 150, 200, 250, 300]] = 0
    np.testing.assert_array_equal(sums.freedom, expected)
    assert (sums.nis[expected == 0] == 0).all() and (sums.nis[expected > 0] > 0).all()


def test_white_innovations_pass_as_often_as_stated_and_coloured_ones_fail():
    rng = np.random.default_rng(3)
    verdicts = []
    for _ in range(400):
        e = rng.normal(size=(500, 2)) * [1.0, 1e-6]
        e[rng.random(e.shape) < 0.3] = NAN
        verdicts.append(whiteness(e, lags=10, probability=0.8).white)
    assert 0.74 < np.mean(verdicts) < 0.92
    e = rng.normal(size=(4000, 2))
    for k in range(1, 4000):
        e[k, 1] += 0.3 * e[k - 1, 1]
    result = whiteness(e, lags=4)
    assert not result.white and whiteness(e[:, :1], lags=4).white
    np.testing.assert_allclose(result.autocorrelation[:, 1], 0.3 ** np.arange(1, 5), atol=0.05)
    np.testing.assert_allclose(result.bound[:, 0], norm.isf(0.0005 / 8) / np.sqrt([3999, 3998, 3997, 3996]))
    gaps = e.copy()
    gaps[1::2, 0] = NAN
    with pytest.raises(ConsistencyError, match="no samples at some lag"):
        whiteness(gaps, lags=1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: nees([1.0, 1.0], [0.0, 0.0], np.diag([1.0, -1.0])), "P: every covariance must be positive definite"),
        (lambda: nees([1.0, 1.0], [0.0, 0.0], np.ones((2, 2)) * 2), "P: every covariance"),
        (lambda: chi2_interval(0, 1, 0.9), "dof = 0"),
        (lambda: chi2_interval(1, 1, 1.0), "probability = 1.0"),
        (lambda: chi2_interval(1, 1, 0.9, 0), "family = 0"),
        (lambda: consistency(np.zeros(3), 4), r"values has shape \(3,\): must be \(runs, T\)"),
        (lambda: consistency(np.zeros((3, 2)), np.zeros((2, 2))), "dof has shape"),
        (lambda: consistency(np.ones((3, 2)), [1, 0]), "time 1 has no value"),
        (lambda: whiteness(np.zeros((5, 1)), lags=5), "lags = 5"),
        (lambda: whiteness(np.zeros((50, 1)), lags=5), "zero throughout"),
    ],
)
def test_refusals_name_argument_value_and_rule(call, words):
    with pytest.raises(ConsistencyError, match=words):
        call()
