from functools import cache

import numpy as np
import pytest
from linear_bench import EHA_A, EHA_B, actuator
from reference_filters import kalman
from scipy.signal import lfilter
from scipy.stats import chi2
from second_order_bench import (
    EHA_P0,
    EHA_Q,
    EHA_R,
    FRICTION,
    HEALTHY,
    LEAKAGE,
    POSITION_STD,
    PRINTED_P0,
    PRINTED_Q,
    PRINTED_R,
    PRINTED_THRESHOLD_M2,
    four_states,
    linear_motion,
    model_of,
    pump_motion,
)

from servohil.estimators.combined_second_order import CombinedSecondOrderFilter
from servohil.estimators.health import Status
from servohil.estimators.manifold.combined_second_order_step import DYNAMIC, OPTIMAL, switch_mode
from servohil.estimators.second_order import SecondOrderFilter

NAN = float("nan")
C = np.eye(1, 3)


def combined(**options):
    return CombinedSecondOrderFilter(actuator(), np.zeros(3), EHA_P0, EHA_Q, EHA_R, **options)


@cache
def motion(name):
    plants = {
        "healthy": ((0, HEALTHY),),
        "friction": ((0, HEALTHY), (1000, FRICTION), (2500, HEALTHY)),
        "leakage": ((0, HEALTHY), (1000, LEAKAGE), (2500, HEALTHY)),
    }
    return pump_motion(4000, 3, plants[name])


def followed(filter_, inputs, samples):
    """Mode (True = dynamic), index and estimate after every step."""
    rows = []
    for u, y in zip(inputs, samples, strict=True):
        filter_.step(u, y)
        rows.append((filter_.mode == "dynamic", filter_.switching_index, filter_.x))
    modes, indices, x = zip(*rows, strict=True)
    return np.array(modes), np.array(indices), np.array(x)


def test_healthy_actuator_is_left_to_the_optimal_filter():
    inputs, samples, _ = motion("healthy")
    filter_ = combined()
    modes, indices, x = followed(filter_, inputs, samples)
    assert not modes.any()
    assert indices.mean() == pytest.approx(1.0, abs=0.1)
    kx, kp, index = np.zeros(3), EHA_P0, 1.0
    for k in range(500):
        predicted = EHA_A @ kx + EHA_B * inputs[k, 0]
        kx, kp, s, _ = kalman(EHA_A, EHA_B, C, EHA_Q, EHA_R, kx, kp, inputs[k], samples[k])
        index += ((samples[k, 0] - predicted[0]) ** 2 / s[0, 0] - index) / 50
        assert (np.abs(x[k] - kx) < [1e-12, 1e-9, 1e-7]).all()
        assert indices[k] == pytest.approx(index, rel=1e-5)


@pytest.mark.parametrize("fault", ["friction", "leakage"])
def test_a_fault_is_left_to_the_dynamic_filter_and_its_end_to_the_optimal(fault):
    inputs, samples, states = motion(fault)
    modes, _, x = followed(combined(), inputs, samples)
    assert not modes[:1000].any()
    assert modes[1050:2500].mean() > 0.99
    assert not modes[3000:].any()  # half a second after the end: the Kalman filter's transient, and the index's
    dynamic = SecondOrderFilter(actuator(), np.zeros(3), EHA_P0, EHA_Q, EHA_R).run(inputs, samples)
    np.testing.assert_array_equal(x[modes], dynamic.x[modes])
    kx, kp, optimal = np.zeros(3), EHA_P0, np.zeros_like(x)
    for k, (u, y) in enumerate(zip(inputs, samples, strict=True)):
        kx, kp, _, _ = kalman(EHA_A, EHA_B, C, EHA_Q, EHA_R, kx, kp, u, y)
        optimal[k] = kx
    error, kalman_error = np.abs(x - states), np.abs(optimal - states)
    rms = np.sqrt(np.mean(error[1050:2500] ** 2, axis=0))
    kalman_rms = np.sqrt(np.mean(kalman_error[1050:2500] ** 2, axis=0))
    assert (rms[:2] < 0.7 * kalman_rms[:2]).all(), (rms, kalman_rms)
    healthy = np.sqrt(np.mean((x - states)[200:1000] ** 2, axis=0))
    noisy = np.sqrt(np.mean((dynamic.x - states)[200:1000] ** 2, axis=0))
    assert (healthy[:2] < 0.7 * noisy[:2]).all()


def test_threshold_is_rarely_exceeded_by_noise():
    """The moments of a running mean of chi-square numbers, at a rate that can be counted: one in a million is not."""
    assert combined(window=1).threshold == pytest.approx(chi2.isf(1e-6, 1))
    assert combined(window=50).threshold == pytest.approx(chi2.isf(1e-6, 99) / 99)
    rng = np.random.default_rng(0)
    window, count = 20, 400_000
    index = lfilter([1 / window], [1, 1 / window - 1], rng.chisquare(1, size=count))[1000:]
    freedom = 2 * window - 1
    assert (index > chi2.isf(1e-2, freedom) / freedom).mean() == pytest.approx(1e-2, rel=0.35)


def test_window_of_one_judges_every_innovation_by_itself():
    """The printed index: e^2 against a threshold; one large innovation switches, the next small one switches back."""
    inputs, samples, _ = motion("healthy")
    filter_ = combined(window=1, threshold=25.0)
    modes, _, _ = followed(filter_, inputs[:300], samples[:300])
    assert not modes.any()
    samples = samples[300:320].copy()
    samples[5] += 20 * POSITION_STD
    modes, indices, _ = followed(filter_, inputs[300:320], samples)
    assert modes[5] and indices[5] > 25 and not modes[:5].any() and not modes[15:].any()


def test_mode_changes_above_the_threshold_and_back_halfway_down():
    modes = []
    index, mode = 1.0, float(OPTIMAL)
    for sample in (4.9, 5.1, 3.1, 4.9, 2.9, 4.9, 5.1):
        index, mode = switch_mode(index, mode, sample, 1.0, 5.0, 3.0)
        assert index == sample
        modes.append(mode == DYNAMIC)
    assert modes == [False, True, True, True, False, False, True]
    index, _ = switch_mode(1.0, float(OPTIMAL), np.inf, 50.0, 5.0, 3.0)
    assert index == 0.98 + 2.0 * 5.0  # one number counts up to a limit


@pytest.mark.nightly
def test_index_is_a_mean_over_the_channels_present():
    system = four_states()
    inputs, outputs, _ = linear_motion(system, 4000, 2, missing=0.2)
    filter_ = CombinedSecondOrderFilter(model_of(system), *system[5:], *system[3:5])
    modes, indices, _ = followed(filter_, inputs, outputs)
    assert not modes.any() and indices.mean() == pytest.approx(1.0, abs=0.1)


def test_printed_settings_switch_as_printed():
    """P2 eq. 77, 78 on e^2 in m2: Q and R that say nothing about the noise, so the index goes without S."""
    printed = CombinedSecondOrderFilter(
        actuator(), np.zeros(3), PRINTED_P0, PRINTED_Q, PRINTED_R, convergence=0.1, cutoff=0.2, window=1,
        threshold=PRINTED_THRESHOLD_M2 / 1e-12, normal_std=[1e-6],
    )  # fmt: skip
    for fault, least in (("friction", 0.6), ("leakage", 0.9)):
        inputs, samples, _ = motion(fault)
        printed.reset()
        modes, indices, _ = followed(printed, inputs, samples)
        assert modes[1050:2500].mean() > least
        assert modes[10:1000].mean() < 0.01 and modes[2600:].mean() < 0.01
        assert indices[500] == pytest.approx((printed_innovation(inputs, samples, 500) / 1e-6) ** 2, rel=1e-4)
    assert printed.health.repaired == 0


def printed_innovation(inputs, samples, step):
    x, p = np.zeros(3), PRINTED_P0
    for u, y in zip(inputs[: step + 1], samples[: step + 1], strict=True):
        e = y[0] - (EHA_A @ x + EHA_B * u[0])[0]
        x, p, _, _ = kalman(EHA_A, EHA_B, C, PRINTED_Q, PRINTED_R, x, p, u, y)
    return e


@pytest.mark.nightly
def test_switching_over_many_seeds():
    filter_ = combined()
    for seed in range(30):
        for plant in (FRICTION, LEAKAGE):
            inputs, samples, _ = pump_motion(4000, seed, ((0, HEALTHY), (1000, plant), (2500, HEALTHY)))
            filter_.reset()
            modes, _, _ = followed(filter_, inputs, samples)
            assert not modes[:1000].any() and modes[1050:2500].mean() > 0.99 and not modes[3200:].any(), (seed, plant)


@pytest.mark.parametrize("gate", [None, 0.9999999])
def test_the_gate_keeps_an_outlier_from_both_filters_and_from_the_index(gate):
    inputs, samples, _ = motion("healthy")
    filter_, clean = combined(gate=gate), combined()
    clean_samples = samples[:1000].copy()
    clean_samples[400] = NAN
    samples = samples[:1000].copy()
    samples[400] += 1e-3
    modes, indices, x = followed(filter_, inputs[:1000], samples)
    expected = followed(clean, inputs[:1000], clean_samples)
    if gate is None:
        assert modes[400] and indices[400] > 4 and not modes[900:].any()  # when the Kalman filter is back, too
    else:
        np.testing.assert_array_equal(indices, expected[1])
        np.testing.assert_array_equal(x, expected[2])
        assert filter_.health.gated == 1 and not modes.any()


def test_fields_are_those_of_the_filter_that_counts():
    inputs, samples, _ = motion("friction")
    filter_ = combined()
    filter_.run(inputs[:1500], samples[:1500])
    dynamic = SecondOrderFilter(actuator(), np.zeros(3), EHA_P0, EHA_Q, EHA_R)
    dynamic.run(inputs[:1500], samples[:1500])
    assert filter_.mode == "dynamic"
    for name in ("x", "P", "S", "innovation", "nis", "loglik"):
        np.testing.assert_array_equal(getattr(filter_, name), getattr(dynamic, name), err_msg=name)
    filter_.reset()
    assert filter_.mode == "optimal" and filter_.switching_index == 1.0
    filter_.run(inputs[:900], samples[:900])
    x, p = np.zeros(3), EHA_P0
    for u, y in zip(inputs[:900], samples[:900], strict=True):
        e = y - C @ (EHA_A @ x + EHA_B * u[0])
        x, p, s, loglik = kalman(EHA_A, EHA_B, C, EHA_Q, EHA_R, x, p, u, y)
    np.testing.assert_allclose(filter_.P, p, rtol=1e-6, atol=1e-16)
    np.testing.assert_allclose(filter_.S, s, rtol=1e-8)
    np.testing.assert_allclose(filter_.innovation, e, atol=1e-12)
    assert filter_.nis == pytest.approx(float(e[0] ** 2 / s[0, 0]), rel=1e-5)
    assert filter_.loglik == pytest.approx(loglik, rel=1e-6)


def test_an_optimal_filter_whose_numbers_mean_nothing_starts_again_from_the_other():
    inputs, samples, states = motion("healthy")
    filter_ = combined()
    filter_.run(inputs[:500], samples[:500])
    places = filter_._places
    optimal = slice(places[3], places[3] + 3)
    for lost in (1e200, 1e20):  # not finite after the prediction; so far off that the correction means nothing
        filter_._own[optimal] = lost
        assert filter_.step(inputs[500], samples[500]) == Status.OK
        assert filter_.mode == "dynamic" and filter_.switching_index > 4
        np.testing.assert_array_equal(filter_._own[optimal], filter_.x)
    modes, _, x = followed(filter_, inputs[502:1000], samples[502:1000])
    assert not modes[200:].any()
    assert (np.abs(x[300:] - states[802:1000]).max(axis=0)[:2] < [6e-6, 2e-3]).all()


def test_survives_gaps_infinities_and_huge_numbers_and_recovers():
    inputs, samples, states = motion("healthy")
    inputs, samples = np.tile(inputs, (3, 1)), np.tile(samples, (3, 1))
    rng = np.random.default_rng(2)
    bad = slice(0, len(samples) - 2000)
    for value, share in ((NAN, 0.2), (np.inf, 0.01), (-np.inf, 0.01), (1e300, 0.02), (1e12, 0.005), (1.0, 0.005)):
        samples[bad][rng.random(samples[bad].shape) < share] = value
    for value, share in ((NAN, 0.01), (np.inf, 0.01), (1e300, 0.01), (1e3, 0.001)):
        inputs[bad][rng.random(inputs[bad].shape) < share] = value
    filter_ = combined(gate=0.999999)
    trajectory = filter_.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all() and np.isfinite(trajectory.nis).all()
    scale = np.sqrt(np.einsum("kii->ki", trajectory.P))
    assert (scale > 0).all()
    correlation = trajectory.P / (scale[:, :, None] * scale[:, None, :])
    assert np.linalg.eigvalsh(correlation[::17]).min() > 0
    assert filter_.mode == "optimal"
    error = np.abs(trajectory.x[-1000:] - states[-1000:]).max(axis=0)  # 1 s after the disturbance
    assert (error < [6e-6, 3e-3, 0.6]).all(), error
    health = filter_.health
    assert min(health.missing, health.not_finite_input, health.diverged, health.repaired, health.gated) > 0


def test_run_step_and_a_copied_arena_agree_bit_for_bit():
    inputs, samples, _ = motion("friction")
    inputs, samples = inputs[900:1300], samples[900:1300].copy()
    samples[20:30] = NAN
    filter_ = combined(arena=np.zeros(CombinedSecondOrderFilter.arena_size(3, 1)))
    _, _, x = followed(filter_, inputs, samples)
    end = filter_.arena.tobytes()
    filter_.reset()
    filter_.run(inputs[:150], samples[:150])
    other = combined()
    other.arena[:] = filter_.arena
    second = other.run(inputs[150:], samples[150:])
    np.testing.assert_array_equal(second.x, x[150:])
    assert other.arena.tobytes() == end and other.mode == "dynamic"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"window": 0.5}, r"window = 0.5: must be a finite number of steps >= 1"),
        ({"window": NAN}, "window = nan"),
        ({"threshold": 1.0}, r"threshold = 1.0: must be a finite number > 1"),
        ({"threshold": "high"}, "threshold = 'high'"),
        ({"convergence": 1.0}, "convergence = 1.0"),
        ({"cutoff": 0.0}, "cutoff = 0.0"),
        ({"normal_std": [0.0]}, r"normal_std = \[0.0\]: must be > 0"),
        ({"normal_std": [1.0, 1.0]}, r"normal_std has shape \(2,\)"),
    ],
)
def test_construction_errors_name_argument_value_and_rule(change, words):
    with pytest.raises(ValueError, match=words):
        combined(**change)
