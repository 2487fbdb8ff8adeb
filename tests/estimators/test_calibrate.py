import numpy as np
import pytest
from scipy.signal import lfilter

from servohil.estimators.leakage.sequential.calibrate import calibrate, long_run_deviation
from servohil.estimators.leakage.sequential.count_alarms import count_alarms
from servohil.estimators.leakage.sequential.cusum import Cusum
from servohil.estimators.leakage.sequential.fixed_threshold import FixedThreshold
from servohil.estimators.leakage.sequential.glr import Glr
from servohil.estimators.leakage.sequential.sequential_test import SequentialTestError
from servohil.estimators.leakage.sequential.sprt import Sprt

RATE_HZ = 1000.0


def correlated(rng, n, rho):
    """AR(1) of variance 1."""
    return lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal(n))


def test_interval_holds_the_true_rate_as_often_as_it_says():
    """On white residuals the true rate of any threshold is known."""
    rng = np.random.default_rng(1)
    test, hours = Cusum.for_rate(1.0, RATE_HZ), 200.0 / 3600.0
    results = [calibrate(test, rng.standard_normal(60_000), hours) for _ in range(18)]
    true = np.array([r.test.hours_between_false_alarms for r in results])
    inside = [r.low_hours <= t <= r.high_hours for r, t in zip(results, true, strict=True)]
    assert sum(inside) >= 13  # 90 % are 16; 12 or fewer in 1 % of cases
    assert abs(np.mean(np.log(true / hours))) < 0.3  # three times 0.4 / sqrt(18)
    assert np.mean([r.slope for r in results]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("test", "rho"),
    [
        (Cusum(RATE_HZ, 1.0, 1.0), 0.3), (Cusum(RATE_HZ, 1.0, 1.0), 0.6), (Sprt(RATE_HZ, 1.0, 1.0, 1e-3), 0.3),
        (FixedThreshold(RATE_HZ, 1.0, 3), 0.6), (Glr(RATE_HZ, 1.0, 20), 0.3),
    ],
)  # fmt: skip
def test_correlated_residuals_alarm_at_the_stated_rate(test, rho):
    rng = np.random.default_rng(2)
    seconds = 40.0
    result = calibrate(test, correlated(rng, 300_000, rho), seconds / 3600.0)
    assert result.low_hours < seconds / 3600.0 < result.high_hours
    z = correlated(rng, 4_000_000, rho)
    alarms, stated = count_alarms(result.test, z).sum(), 4000.0 / seconds
    assert stated / 1.6 < alarms < stated * 1.6  # 10 % of the count, 15 % of the calibration, three times
    white = test.with_hours(seconds / 3600.0)
    assert count_alarms(white, z).sum() > 2.5 * stated


def test_long_run_deviation_of_an_autoregression():
    rng = np.random.default_rng(3)
    for rho in (0.0, 0.6, 0.9, -0.5):
        z = correlated(rng, 400_000, rho)
        z[1000:1100] = np.nan
        assert long_run_deviation(z) == pytest.approx(np.sqrt((1.0 + rho) / (1.0 - rho)), rel=0.15)


def test_strong_correlation_is_in_reach_in_long_run_deviations():
    rng = np.random.default_rng(4)
    z = correlated(rng, 300_000, 0.9)
    test, hours = Cusum(RATE_HZ, 1.0, 0.5), 60.0 / 3600.0
    with pytest.raises(SequentialTestError, match="support"):
        calibrate(Cusum(RATE_HZ, 1.0, 2.0), z, 10.0)
    unit = long_run_deviation(z)
    result = calibrate(test, z / unit, hours)
    assert 0.6 < result.slope < 1.4
    fresh = correlated(rng, 4_000_000, 0.9) / unit
    assert 4000.0 / 60.0 / 1.8 < count_alarms(result.test, fresh).sum() < 4000.0 / 60.0 * 1.8
    # A shift of half a long-run deviation: the predicted delay of white residuals holds.
    shifted = count_alarms(result.test, fresh[:500_000] + 0.5).sum()
    assert result.test.delay_s(0.5) == pytest.approx(500.0 / shifted, rel=0.15)


def test_missing_samples_do_not_count():
    rng = np.random.default_rng(5)
    z = rng.standard_normal(200_000)
    gaps = np.full(400_000, np.nan)
    gaps[::2] = z
    test = Cusum(RATE_HZ, 1.0, 1.0)
    whole, holed = (calibrate(test, record, 60.0 / 3600.0) for record in (z, gaps))
    assert whole.test == holed.test


def test_the_same_record_gives_the_same_threshold():
    z = np.random.default_rng(6).standard_normal(100_000)
    test = Sprt(RATE_HZ, 1.0, 1.0, 1e-3)
    assert calibrate(test, z, 0.01) == calibrate(test, z, 0.01)


def test_what_a_record_cannot_support_is_refused_with_what_it_can():
    z = np.random.default_rng(7).standard_normal(60_000)
    test = Cusum(RATE_HZ, 1.0, 1.0)
    with pytest.raises(
        SequentialTestError, match=r"0.0167 h of these residuals support [\d.e-]+ to [\d.]+ h"
    ) as refusal:
        calibrate(test, z, 1e5)
    attained = float(str(refusal.value).split(" to ")[1].removesuffix(" h"))
    assert calibrate(test, z, 0.99 * attained).low_hours > 0.99 * attained / 3.05
    with pytest.raises(SequentialTestError, match="support"):
        calibrate(test, z, 1.02 * attained)
    for hours in (np.nan, -1.0, 0.0, 1e-7):
        with pytest.raises(SequentialTestError, match="hours_between_false_alarms"):
            calibrate(test, z, hours)


@pytest.mark.parametrize("z", [np.zeros(100_000), np.full(1000, np.nan), np.ones(10), np.zeros((4, 4)), np.zeros(0)])
def test_records_without_false_alarms_are_refused(z):
    with pytest.raises(SequentialTestError, match="residuals"):
        calibrate(Cusum(RATE_HZ, 1.0, 1.0), z, 1.0)
