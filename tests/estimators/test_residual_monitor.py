from dataclasses import replace

import numpy as np
import pytest
from hydraulic_bench import HEALTHY, MEASUREMENT_STD, PROCESS_STD, sine_motion, srukf

from servohil.estimators.leakage.residual_monitor import ARENA_SIZE, MonitorError, ResidualMonitor

PA2_PER_MPA2 = 1e12
SETTINGS = {"threshold_sigma": 8.0, "cusum_drift": 0.5, "cusum_threshold": 40.0, "settle_s": 2.0}
ONES = np.ones(2)


def monitor(**change):
    return ResidualMonitor(1e-3, **{**SETTINGS, "settle_s": 0.0, **change})


def watch(inputs, samples):
    """Run filter and monitor over a motion; the monitor, and its largest CUSUM."""
    ukf, watcher = srukf(PROCESS_STD, MEASUREMENT_STD), ResidualMonitor(1e-3, **SETTINGS)
    worst = 0.0
    for u, y in zip(inputs, samples, strict=True):
        ukf.step(u, y)
        watcher.step(ukf.innovation[1:] * 1e6, np.diag(ukf.S)[1:] * PA2_PER_MPA2, True)
        worst = max(worst, watcher.cusum_a, watcher.cusum_b)
        if watcher.alarm:
            break
    return watcher, worst


@pytest.mark.parametrize("leak", ["leak_internal", "leak_external_a", "leak_external_b"])
@pytest.mark.parametrize(("size", "limit_s"), [(1e-11, 0.1), (1e-12, 1.0)])
@pytest.mark.parametrize("onset", [3000, 3800, 4700])
def test_leaks_are_detected_soon_wherever_in_the_motion_they_begin(leak, size, limit_s, onset):
    faulty = replace(HEALTHY, **{leak: size})
    inputs, samples, _ = sine_motion(onset + 1000, 7, HEALTHY.vector(), faulty.vector(), onset, 3, 0.02)
    watcher, _ = watch(inputs, samples)
    assert watcher.alarm == 1 and watcher.channels in (1, 2, 3)
    assert 0 <= (watcher.since - onset) * 1e-3 < limit_s


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_alarm_in_a_minute_of_healthy_motion_with_sampling_jitter(seed):
    p = HEALTHY.vector()
    inputs, samples, states = sine_motion(60_000, seed, p, p, 60_000, 3, 0.02)
    stale = np.random.default_rng(seed).random(60_000) < 0.02  # and every fiftieth cycle sees the sample before
    stale[0] = False
    samples[stale] = samples[np.flatnonzero(stale) - 1]
    watcher, worst = watch(inputs, samples)
    assert watcher.alarm == 0 and watcher.settled
    assert worst < 0.6 * SETTINGS["cusum_threshold"]  # with room for a model that is not exact
    estimates = srukf().run(inputs, samples).x[3000:]
    error = ((estimates - states[3000:]) ** 2).sum(axis=0) / states[3000:].var(axis=0) / len(estimates)
    assert (100 * error < 0.01).all(), error  # percent


def test_threshold_needs_three_samples_in_a_row():
    watcher = monitor(cusum_threshold=1e3)
    for value in (9.0, 9.0, 7.9, -9.0, -9.0):
        assert watcher.step(np.array([value, 0.0]), ONES, True) == 0
    assert watcher.step(np.array([-9.0, 0.0]), ONES, True) == 1
    assert (watcher.alarm, watcher.channels, watcher.since) == (1, 1, 5)


def test_cusum_is_page_s_recursion_on_both_sides():
    watcher = monitor()
    values = np.random.default_rng(0).normal(size=(500, 2)) * 1.2
    up, down = np.zeros(2), np.zeros(2)
    for row in values:
        watcher.step(row * 3.0, 9.0 * ONES, True)
        up, down = np.maximum(up + row - 0.5, 0), np.maximum(down - row - 0.5, 0)
        np.testing.assert_allclose([watcher.cusum_a, watcher.cusum_b], np.maximum(up, down), rtol=1e-9, atol=1e-12)
    assert (watcher.residual_a_pa, watcher.threshold_b_pa) == (3.0 * values[-1, 0], 24.0)


@pytest.mark.parametrize(("sign", "channel"), [(1, 0), (-1, 0), (1, 1), (-1, 1)])
def test_cusum_alarm_after_the_expected_number_of_samples(sign, channel):
    watcher, residual = monitor(), np.zeros(2)
    residual[channel] = sign * 2.5
    steps = next(k for k in range(100) if watcher.step(residual, ONES, True))
    assert steps + 1 == 21  # 2.0 per sample beyond the drift, and more than 40
    assert watcher.channels == 1 << channel


def test_one_wild_sample_counts_no_more_than_the_threshold():
    watcher = monitor()
    watcher.step(np.array([1e9, 0.0]), ONES, True)
    assert watcher.cusum_a == 7.5


def test_alarm_is_latched_until_acknowledged_and_comes_back_with_the_leak():
    watcher, leak = monitor(), np.array([0.0, 9.0])
    for _ in range(3):
        watcher.step(leak, ONES, True)
    for judging in (True, False):
        assert watcher.step(np.zeros(2), ONES, judging) == 1
    assert watcher.since == 2 and watcher.channels == 2
    watcher.acknowledge()
    assert (watcher.alarm, watcher.channels, watcher.since) == (0, 0, -1)
    assert [watcher.step(leak, ONES, True) for _ in range(3)] == [0, 0, 1]


def test_judges_only_after_uninterrupted_motion():
    watcher, leak = monitor(settle_s=0.1), np.array([20.0, 20.0])
    for _ in range(3):
        for _ in range(100):
            assert watcher.step(leak, ONES, True) == 0
        assert watcher.settled
        watcher.step(leak, ONES, False)
        assert not watcher.settled
    for _ in range(102):
        assert watcher.step(leak, ONES, True) == 0
    assert watcher.step(leak, ONES, True) == 1


@pytest.mark.parametrize("bad", [(np.nan, 1.0), (np.inf, 1.0), (0.0, np.nan), (0.0, 0.0), (0.0, -1.0)])
def test_missing_samples_hold_the_statistics_for_a_few_milliseconds(bad):
    watcher = monitor()
    for _ in range(4):
        watcher.step(np.array([2.5, 0.0]), ONES, True)
    assert watcher.cusum_a == 8.0
    watcher.step(np.array([bad[0], 9.0]), np.array([bad[1], 1.0]), True)
    for _ in range(5):
        assert watcher.step(np.array([99.0, 99.0]), ONES, True) == 0
        assert watcher.cusum_a == 8.0
    watcher.step(np.array([2.5, 0.0]), ONES, True)
    assert watcher.cusum_a == 10.0 and watcher.settled


def test_copying_the_arena_restores_it_and_reset_keeps_the_settings():
    memory = np.zeros(ARENA_SIZE + 2)
    watcher = ResidualMonitor(1e-3, **SETTINGS, arena=memory[1:-1])
    rng = np.random.default_rng(0)
    values = rng.normal(size=(5000, 2)) + 0.4
    for row in values[:3000]:
        watcher.step(row, ONES, True)
    twin = ResidualMonitor(1e-3, 1.0, 0.0, 1.0, 0.0)
    twin.arena[:] = memory[1:-1]
    for row in values[3000:]:
        assert watcher.step(row, ONES, True) == twin.step(row, ONES, True)
    assert twin.arena.tobytes() == watcher.arena.tobytes()
    watcher.reset()
    assert watcher.arena.tobytes() == ResidualMonitor(1e-3, **SETTINGS).arena.tobytes()
    assert watcher.cusum_threshold == 40.0 and watcher.since == -1


@pytest.mark.parametrize(
    ("name", "value"),
    [("threshold_sigma", 0.0), ("cusum_drift", -0.1), ("cusum_threshold", np.nan), ("settle_s", -1.0)],
)
def test_settings_are_refused_by_name_and_value(name, value):
    with pytest.raises(MonitorError, match=f"{name} = {value}"):
        ResidualMonitor(1e-3, **{**SETTINGS, name: value})
    with pytest.raises(MonitorError, match=r"dt = 0\.0"):
        ResidualMonitor(0.0, **SETTINGS)
    with pytest.raises(MonitorError, match=r"arena = float64 \(3,\)"):
        ResidualMonitor(1e-3, **SETTINGS, arena=np.zeros(3))
