"""The sequential tests against their stated rates and predicted delays, and against plain references."""

from math import inf, log, nan

import numpy as np
import pytest
from scipy.stats import chi2, norm

from servohil.estimators.leakage.sequential.count_alarms import count_alarms
from servohil.estimators.leakage.sequential.cusum import Cusum
from servohil.estimators.leakage.sequential.fixed_threshold import FixedThreshold, run_length
from servohil.estimators.leakage.sequential.glr import Glr
from servohil.estimators.leakage.sequential.sequential_test import SequentialTestError
from servohil.estimators.leakage.sequential.sprt import Sprt, wald_thresholds

RATE_HZ = 1000.0
CHUNK = 500_000
MAKERS = {
    "fixed": lambda hours: FixedThreshold.for_rate(hours, RATE_HZ),
    "fixed 3 in a row": lambda hours: FixedThreshold.for_rate(hours, RATE_HZ, 3),
    "cusum 1": lambda hours: Cusum.for_rate(hours, RATE_HZ),
    "cusum 0.25": lambda hours: Cusum.for_rate(hours, RATE_HZ, 0.25),
    "sprt 1": lambda hours: Sprt.for_rate(hours, RATE_HZ),
    "sprt 0.5": lambda hours: Sprt.for_rate(hours, RATE_HZ, 0.5, 0.05),
    "glr 50": lambda hours: Glr.for_rate(hours, RATE_HZ, 50),
    "glr 200": lambda hours: Glr.for_rate(hours, RATE_HZ, 200),
}
every_test = pytest.mark.parametrize("name", MAKERS)


def alarms_on_white_noise(test, hours, seed, shift=0.0):
    """Alarms in so many hours of white residuals, and the samples."""
    rng, arena, alarms = np.random.default_rng(seed), np.zeros(test.arena_size), 0
    chunks = max(round(hours * 3600.0 * RATE_HZ / CHUNK), 1)
    for _ in range(chunks):
        alarms += int(count_alarms(test, rng.standard_normal(CHUNK) + shift, arena=arena).sum())
    return alarms, chunks * CHUNK


def poisson_interval(count, probability=0.99):
    """Exact interval of the mean of a Poisson number (Garwood)."""
    tail = 0.5 * (1.0 - probability)
    return (0.5 * chi2.ppf(tail, 2 * count) if count else 0.0), 0.5 * chi2.isf(tail, 2 * count + 2)


def check_rate(name, hours_between, hours, seed, probability=0.99):
    test = MAKERS[name](hours_between)
    assert test.hours_between_false_alarms == pytest.approx(hours_between, rel=1e-3)
    alarms, samples = alarms_on_white_noise(test, hours, seed)
    low, high = poisson_interval(alarms, probability)
    expected = samples / RATE_HZ / 3600.0 / hours_between
    assert low <= expected <= high, f"{alarms} alarms, {expected:.0f} stated"


@every_test
def test_measured_false_alarm_rate_is_the_stated_one(name):
    check_rate(name, 20.0 / 3600.0, 1.0 if name.startswith("glr") else 4.0, 1)


@pytest.mark.nightly
@pytest.mark.parametrize(("hours_between", "hours"), [(1.0 / 60.0, 6.0), (0.2, 40.0)])
@every_test
def test_measured_false_alarm_rate_is_the_stated_one_when_rarer(name, hours_between, hours):
    check_rate(name, hours_between, hours, 2, 0.999)  # 16 intervals: 98 % that all hold


@every_test
@pytest.mark.parametrize("shift", [-0.5, 1.0, 2.0])
def test_predicted_delay(name, shift):
    test = MAKERS[name](20.0 / 3600.0)
    try:
        predicted = test.delay_s(shift)
    except SequentialTestError as refusal:  # the short window alone
        assert name == "glr 50" and shift == -0.5 and str(round(test.smallest_shift, 3)) in str(refusal)
        return
    rng = np.random.default_rng(3)
    measured = CHUNK / count_alarms(test, rng.standard_normal(CHUNK) + shift).sum() / RATE_HZ
    tolerance = 0.06 if name.startswith("glr") else 0.02
    assert predicted == pytest.approx(measured, rel=tolerance + 3.0 * np.sqrt(measured * RATE_HZ / CHUNK))


def test_plain_threshold_of_the_published_table():
    """Both sides at half the time between false alarms have the threshold of one side."""
    for seconds, threshold in ((60.0, 4.15), (3600.0, 5.01), (86400.0, 5.59), (3.156e7, 6.54)):
        test = FixedThreshold.for_rate(seconds / 2.0 / 3600.0, RATE_HZ)
        assert test.threshold == pytest.approx(threshold, abs=0.006)
    for seconds, delay_s in ((60.0, 1.2), (3600.0, 32.0), (86400.0, 444.0), (3.156e7, 18.0 * 3600.0)):
        test = FixedThreshold.for_rate(seconds / 2.0 / 3600.0, RATE_HZ)
        assert test.delay_s(1.0) == pytest.approx(delay_s, rel=0.025)


@pytest.mark.parametrize(("probability", "persistence"), [(0.5, 1), (0.5, 2), (0.3, 3), (0.02, 4), (0.9, 20)])
def test_run_of_successes_by_its_absorbing_chain(probability, persistence):
    chain = np.diag(np.full(persistence - 1, probability), 1)
    chain[:, 0] += 1.0 - probability
    steps = np.linalg.solve(np.eye(persistence) - chain, np.ones(persistence))[0]
    assert run_length(probability, persistence) == pytest.approx(steps, rel=1e-9)


@pytest.mark.parametrize(
    ("window", "threshold", "samples"),
    [(200, 12.0, 463.0), (200, 16.0, 2745.0), (200, 20.0, 17800.0), (50, 14.0, 1153.0)],
)
def test_glr_run_length_of_simulations(window, threshold, samples):
    """Simulated with 2000 to 20 000 alarms; the chi-square quantile alone is 4 to 8 times as long."""
    assert Glr(RATE_HZ, threshold, window).samples_between_false_alarms == pytest.approx(samples, rel=0.025)
    assert 0.9 * samples / norm.sf(np.sqrt(threshold)) / 2.0 > 3.0 * samples


def test_glr_statistic_by_brute_force():
    rng = np.random.default_rng(4)
    test, z = Glr(RATE_HZ, 20.0, 20), rng.standard_normal(130) * 2.0
    arena = np.zeros(test.arena_size)
    for n in range(len(z)):
        statistic = test.step(arena, test.settings(), z[n])
        onsets = range(max(0, n - 19), n + 1)
        assert statistic == pytest.approx(max(z[k : n + 1].sum() ** 2 / (n + 1 - k) for k in onsets))


def test_sums_and_ratios_by_definition():
    rng = np.random.default_rng(5)
    cusum, sprt, fixed = Cusum(RATE_HZ, 9.0, 0.8), Sprt(RATE_HZ, 9.0, 0.8, 0.1), FixedThreshold(RATE_HZ, 3.0, 3)
    arenas = [np.zeros(t.arena_size) for t in (cusum, sprt, fixed)]
    up = down = rise = fall = 0.0
    seen = []
    for z in rng.standard_normal(500):
        seen.append(abs(z))
        up, down = max(up + z - 0.4, 0.0), max(down - z - 0.4, 0.0)
        rise, fall = (s + norm.logpdf(z, m) - norm.logpdf(z) for s, m in ((rise, 0.8), (fall, -0.8)))
        rise, fall = (0.0 if s <= sprt.lower else s for s in (rise, fall))
        assert cusum.step(arenas[0], cusum.settings(), z) == pytest.approx(max(up, down), abs=1e-12)
        assert sprt.step(arenas[1], sprt.settings(), z) == pytest.approx(max(rise, fall), abs=1e-12)
        expected = min(seen[-3:]) if len(seen) >= 3 else 0.0
        assert fixed.step(arenas[2], fixed.settings(), z) == expected


def test_wald():
    """ln((1 - beta) / alpha), ln(beta / (1 - alpha)); the rate of the restarted test is alpha per E[N | no fault]."""
    upper, lower = wald_thresholds(1e-6, 1e-3)
    assert (upper, lower) == (pytest.approx(13.81, abs=0.01), pytest.approx(-6.91, abs=0.01))
    test = Sprt.for_errors(1e-6, 1e-3, RATE_HZ, 0.1)
    assert (test.threshold, test.lower) == (pytest.approx(upper), pytest.approx(lower))
    # Siegmund's correction moves either boundary out by 0.583 shifts; the formulas of Wald are then right.
    a, b = upper + 0.0583, lower - 0.0583
    alpha = np.expm1(b) / (np.exp(b) - np.exp(a))
    mean_length = -(alpha * a + (1.0 - alpha) * b) / (0.5 * 0.1**2)
    assert test.samples_between_false_alarms == pytest.approx(0.5 * mean_length / alpha, rel=0.01)
    plain = Sprt.for_errors(1e-6, 1e-3, RATE_HZ)
    assert plain.delay_samples(1.0) == pytest.approx(28.0, rel=0.06)


@every_test
def test_missing_sample_holds(name):
    test = MAKERS[name](1.0)
    settings, rng = test.settings(), np.random.default_rng(6)
    gaps, whole = np.zeros(test.arena_size), np.zeros(test.arena_size)
    for z in rng.standard_normal(400) + 0.5:
        held = [test.step(gaps, settings, missing) for missing in (nan, inf, -inf)]
        assert held == [held[0]] * 3
        assert test.step(gaps, settings, z) == test.step(whole, settings, z)
    np.testing.assert_array_equal(gaps, whole)


@every_test
def test_wild_samples_stay_finite_and_a_fresh_start_forgets_them(name):
    test = MAKERS[name](1.0)
    arena, settings = np.zeros(test.arena_size), test.settings()
    assert settings[0] == test.threshold
    for z in (1e308, 1e308, -1e308, -1e308, 1e308, 0.0, 5e-324):
        assert np.isfinite(test.step(arena, settings, z)) and np.isfinite(arena).all()
    arena[:] = 0.0
    assert test.step(arena, settings, 0.1) < test.threshold


@every_test
def test_sides_are_alike(name):
    test = MAKERS[name](1.0)
    one, other, settings = np.zeros(test.arena_size), np.zeros(test.arena_size), test.settings()
    for z in np.random.default_rng(7).standard_normal(300) * 1.5:
        assert test.step(one, settings, z) == test.step(other, settings, -z)
    assert test.delay_s(1.5) == test.delay_s(-1.5)


@pytest.mark.parametrize("test", [Cusum(RATE_HZ, 5.0, 1.0), Sprt(RATE_HZ, 5.0, 1.0, 1e-3)])
def test_a_long_fault_is_forgotten(test):
    arena, settings = np.zeros(test.arena_size), test.settings()
    for _ in range(100_000):
        statistic = test.step(arena, settings, 3.0)
    assert statistic == 10.0 * test.threshold
    for _ in range(200):
        statistic = test.step(arena, settings, 0.0)
    assert statistic < test.threshold


@every_test
@pytest.mark.parametrize("hours", [0.0, -1.0, 1e-9, 1e9, nan, inf])
def test_rate_out_of_range_is_refused_with_the_attainable_one(name, hours):
    with pytest.raises(SequentialTestError, match=r"hours_between_false_alarms = .* attains [\d.e-]+ to 2.78e\+05 h"):
        MAKERS[name](hours)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Cusum.for_rate(1.0, 0.0), "rate_hz = 0.0"),
        (lambda: Cusum.for_rate(1.0, RATE_HZ, 0.01), "shift_sigma = 0.01: attainable is 0.1 to 4"),
        (lambda: Sprt.for_rate(1.0, RATE_HZ, 5.0), "shift_sigma = 5.0: attainable is 0.1 to 4"),
        (lambda: Sprt.for_rate(1.0, RATE_HZ, 1.0, 0.7), "miss = 0.7: attainable is"),
        (lambda: Sprt.for_errors(0.5, 0.6, RATE_HZ), "alpha = 0.5, beta = 0.6"),
        (lambda: FixedThreshold.for_rate(1.0, RATE_HZ, 0), "persistence = 0: attainable is 1 to 50"),
        (lambda: Glr.for_rate(1.0, RATE_HZ, 5), "window = 5: attainable is 20 to 10000"),
        (lambda: Glr.for_rate(1.0, nan), "rate_hz = nan"),
        (lambda: Cusum.for_rate(1.0, RATE_HZ).delay_s(0.0), "shift_sigma = 0.0"),
        (lambda: Glr.for_rate(1.0, RATE_HZ, 100).delay_s(0.1), "a window of 100 samples .* attain 0.7"),
    ],
)
def test_bad_settings_are_refused(make, words):
    with pytest.raises(SequentialTestError, match=words):
        make()


def test_thresholds_rise_and_delays_grow_with_the_time_between_false_alarms():
    for make in MAKERS.values():
        tests = [make(hours) for hours in (0.01, 1.0, 100.0, 1e5)]
        assert np.all(np.diff([t.threshold for t in tests]) > 0.0)
        assert np.all(np.diff([log(t.delay_s(2.0)) for t in tests]) > 0.0)
