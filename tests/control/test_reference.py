"""Reference profiles of every kind: derivatives against finite differences, joins, the start, and what is refused."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from reference_paths import SMOOTH, STANDING, START_M, at, septic_trajectory

from servohil.control.references import (
    ChirpProfile,
    HoldProfile,
    PrbsProfile,
    Profile,
    ProfileError,
    RampProfile,
    SCurveProfile,
    SineProfile,
    StepProfile,
    TrajectoryProfile,
    evaluate,
)

EVERY = [*SMOOTH, STANDING["s_curve"]]
SINE, STEPS = STANDING["sine"], STANDING["steps"]


def name(profile: Profile) -> str:
    return type(profile).__name__


def joins(profile: Profile) -> list[float]:
    """Times at which the formula changes, of the blend and of the first period."""
    edges = [0.0, profile.blend_s]
    match profile:
        case StepProfile():
            edges += [k * profile.dwell_s + more for k in range(5) for more in (0.0, profile.ramp_s)]
        case RampProfile():
            move, leg, turn = profile.move_s, profile.move_s + profile.pause_s, profile.rounding_s
            parts = (0.0, turn, 0.5 * move, move - turn, move)
            edges += [k * leg + part for k in range(3) for part in parts]
        case ChirpProfile():
            turn = 0.05 * profile.sweep_s
            parts = (0.0, turn, 0.5 * profile.sweep_s, profile.sweep_s - turn)
            edges += [k * profile.sweep_s + part for k in range(4) for part in parts]
        case PrbsProfile():
            edges += [k * profile.bit_s + more for k in range(20) for more in (0.0, profile.ramp_s)]
        case TrajectoryProfile():
            edges += [k * profile.period_s + float(edge) for k in range(2) for edge in profile.breaks_s]
    return edges


@pytest.mark.parametrize("profile", EVERY, ids=name)
def test_starts_exactly_at_the_measured_position_at_rest(profile: Profile) -> None:
    for t_s in (-1.0, 0.0):
        assert at(profile, t_s).tolist() == [START_M, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("profile", EVERY, ids=name)
def test_each_derivative_is_the_difference_quotient_of_the_one_below(profile: Profile) -> None:
    h = 1e-6
    times = np.random.default_rng(5).uniform(0.01, 3.0 * min(profile.period_s, 8.0) + profile.blend_s, 800)
    near_joins = np.add.outer(joins(profile), [-3e-6, 4e-6, 2e-3, -2e-3]).ravel()
    values = {}
    for t_s in (*times, *near_joins[near_joins > 1e-5]):
        values[t_s] = at(profile, t_s), (at(profile, t_s + h) - at(profile, t_s - h)) / (2.0 * h)
    greatest = np.maximum(np.abs([value for value, _ in values.values()]).max(axis=0), 1e-6)
    phases = isinstance(profile, SCurveProfile)  # its jerk jumps: a quotient across that is in between
    for t_s, (value, slope) in values.items():
        error = np.abs(slope[:3] - value[1:]) / greatest[1:]
        assert (error[: 2 if phases else 3] <= 2e-5).all(), (t_s, error)
    if phases:
        wrong = [abs(slope[2] - value[3]) > 1e-4 * greatest[3] for value, slope in values.values()]
        assert sum(wrong) <= 2


@pytest.mark.parametrize("profile", EVERY, ids=name)
def test_nothing_jumps_at_the_joins(profile: Profile) -> None:
    for t_s in joins(profile):
        jump = at(profile, t_s + 1e-9) - at(profile, t_s - 1e-9)
        assert np.all(np.abs(jump) < [1e-8, 1e-7, 1e-6, 5e-5]), (t_s, jump)


def test_after_the_blend_the_sine_is_the_formula() -> None:
    for t_s in (2.0, 3.3, 19.9):
        s, c = np.sin(2.0 * t_s), np.cos(2.0 * t_s)
        np.testing.assert_allclose(at(SINE, t_s), [0.3 + 0.15 * s, 0.3 * c, -0.6 * s, -1.2 * c], rtol=1e-13, atol=1e-13)


def test_steps_stand_on_each_level_in_turn_and_begin_again() -> None:
    for t_s, level in ((1.9, 0.35), (2.9, 0.3), (3.9, 0.2), (4.9, 0.35), (2.5, 0.3)):
        assert at(STEPS, t_s) == pytest.approx([level, 0.0, 0.0, 0.0], abs=1e-12)
    assert at(STEPS, 2.2) == pytest.approx([0.325, -0.05 * 35 / 16 / 0.4, 0.0, at(STEPS, 2.2)[3]])


def test_hold_at_the_start_stands_still() -> None:
    for t_s in (0.0, 0.7, 1.5, 3.0):
        assert at(HoldProfile(START_M), t_s) == pytest.approx([START_M, 0.0, 0.0, 0.0], abs=1e-15)


def path(profile: Profile, start_m: float, until_s: float, samples: int) -> np.ndarray:
    return np.array([at(profile, t_s, start_m) for t_s in np.linspace(0.0, until_s, samples)])


@pytest.mark.parametrize("profile", EVERY, ids=name)
def test_the_extremes_are_those_of_a_dense_look(profile: Profile) -> None:
    at_once = replace(profile, blend_s=1e-9)
    times = np.linspace(1e-9, min(profile.period_s, 12.0) + 1e-9, 20001)
    seen = np.array([at(at_once, t_s) for t_s in times])
    told = profile.extremes()
    bound = 0.03 if isinstance(profile, ChirpProfile) else 1e-4  # that of a chirp is an upper bound
    found = [-seen[:, 0].min(), seen[:, 0].max(), np.abs(seen[:, 1]).max(), np.abs(seen[:, 2]).max()]
    said = [-told.low_m, told.high_m, told.speed_mps, told.acceleration_mps2]
    assert (np.array(found) <= np.array(said) + 1e-5 * np.abs(said) + 1e-12).all(), (found, said)
    assert (np.array(found) >= np.array(said) - bound * np.abs(said) - 1e-12).all(), (found, said)


@pytest.mark.parametrize("profile", EVERY, ids=name)
@pytest.mark.parametrize("start_m", [0.02, 0.58])
def test_a_profile_that_passes_the_check_keeps_the_limits(profile: Profile, start_m: float) -> None:
    seen = path(profile, start_m, profile.blend_s + min(profile.period_s, 8.0), 3001)
    # Just the limits that it needs, so that anything beyond them would show.
    both = np.concatenate([path(profile, end, profile.blend_s, 4001) for end in (0.02, 0.58)])
    told = profile.extremes()
    speed = max(told.speed_mps, np.abs(both[:, 1]).max()) * (1.0 + 1e-5) + 1e-9
    acceleration = max(told.acceleration_mps2, np.abs(both[:, 2]).max()) * (1.0 + 1e-5) + 1e-9
    profile.check_limits(0.02, 0.58, speed, acceleration)
    profile.check_limits(0.02, 0.58, speed)
    assert seen[:, 0].min() >= 0.02
    assert seen[:, 0].max() <= 0.58
    assert np.abs(seen[:, 1]).max() <= speed
    assert np.abs(seen[:, 2]).max() <= acceleration
    with pytest.raises(ProfileError, match=r"m/s( when entered from .* m)?: allowed up to"):
        profile.check_limits(0.02, 0.58, speed * 0.995, acceleration)
    with pytest.raises(ProfileError, match=r"m/s2( when entered from .* m)?: allowed up to"):
        profile.check_limits(0.02, 0.58, speed, acceleration * 0.995)


@pytest.mark.parametrize(
    ("profile", "text"),
    [
        (SineProfile(0.32, 0.29, 0.1), r"offset_m \+- amplitude_m reaches 0.61 m: allowed 0.02 to 0.58 m"),
        (SineProfile(0.3, -0.29, 0.1), "reaches 0.01 m: allowed"),
        (SineProfile(0.3, 0.15, 7.0), r"profile reaches 1.05\d* m/s: allowed up to 1 m/s"),
        (SineProfile(0.3, 0.02, 20.0), r"profile reaches 8 m/s2: allowed up to 6 m/s2"),
        (
            SineProfile(0.3, 0.1, 1.0, blend_s=0.5),
            r"blend_s = 0.5 s reaches .* m/s when entered from 0.\d+ m: allowed up to 1 m/s",
        ),
        (SineProfile(0.3, 0.02, 17.0, blend_s=1.2), r"blend_s = 1.2 s reaches .* m/s2 when entered from 0.\d+ m"),
        (StepProfile((0.1, 0.6), 1.0, 1.0), "levels_m reaches 0.6 m"),
        (StepProfile((0.1, 0.5), 1.0, 0.8), r"profile reaches 1.09375 m/s:"),
        (StepProfile((0.3, 0.4), 1.0, 0.3), r"profile reaches 8.34799 m/s2:"),
        (HoldProfile(0.6), "position_m reaches 0.6 m"),
        (HoldProfile(0.5, blend_s=0.9), r"blend_s = 0.9 s reaches .* when entered from 0.02 m"),
        (RampProfile(0.1, 0.59, 0.2, 1.0, 10.0, 0.0), "from_m, to_m reaches 0.59 m"),
        (RampProfile(0.01, 0.3, 0.2, 1.0, 10.0, 0.0), "from_m, to_m reaches 0.01 m"),
        (RampProfile(0.05, 0.55, 1.1, 5.9, 1e4, 0.0), "profile reaches 1.1 m/s:"),
        (RampProfile(0.1, 0.5, 0.5, 6.5, 1e4, 0.0), "profile reaches 6.5 m/s2:"),
        (SCurveProfile((0.1, 0.59), 9.0, 0.2, 1.0, 10.0), "levels_m reaches 0.59 m"),
        (SCurveProfile((0.1, 0.5), 9.0, 1.1, 5.9, 1e4), "profile reaches 1.1 m/s:"),
        (SCurveProfile((0.1, 0.5), 9.0, 0.5, 6.5, 1e4), "profile reaches 6.5 m/s2:"),
        (ChirpProfile(0.3, 0.29, 0.1, 0.2, 9.0), "amplitude_m reaches 0.01 m"),
        (ChirpProfile(0.3, 0.1, 0.1, 1.7, 60.0), "profile reaches 1.06814 m/s:"),
        (ChirpProfile(0.3, 0.02, 3.0, 0.1, 60.0), r"profile reaches 7.1061\d m/s2:"),
        (PrbsProfile(0.3, 0.59, 1.0, 1.0, 7, 1), "low_m, high_m reaches 0.59 m"),
        (PrbsProfile(0.1, 0.5, 1.0, 0.8, 7, 1), "profile reaches 1.09375 m/s:"),
        (PrbsProfile(0.3, 0.4, 1.0, 0.3, 7, 1), "profile reaches 8.34799 m/s2:"),
        (septic_trajectory(0.3, 0.59, 2.0), "trajectory reaches 0.59 m: allowed 0.02 to 0.58 m, at 2 s"),
        (septic_trajectory(0.3, 0.5, 0.4), "profile reaches 1.09375 m/s: allowed up to 1 m/s, at 0.2 s"),
        (septic_trajectory(0.3, 0.4, 0.3), r"profile reaches 8.3\d* m/s2: allowed up to 6 m/s2, at 0.\d+ s"),
    ],
)
def test_a_profile_beyond_a_limit_is_refused_with_value_and_limit(profile: Profile, text: str) -> None:
    with pytest.raises(ProfileError, match=text):
        profile.check_limits(0.02, 0.58, 1.0, 6.0)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: SineProfile(float("nan"), 0.1, 1.0), "offset_m = nan"),
        (lambda: SineProfile(0.3, 0.1, 0.0), "omega_rad_per_s = 0.0: must be finite and > 0"),
        (lambda: HoldProfile(0.3, blend_s=-1.0), "blend_s = -1.0"),
        (lambda: StepProfile((), 1.0, 0.5), "levels_m is empty"),
        (lambda: StepProfile((0.2, float("inf")), 1.0, 0.5), r"levels_m\[1\] = inf"),
        (lambda: StepProfile((0.2, 0.3), 1.0, 2.0), "ramp_s = 2.0: must be <= dwell_s = 1.0"),
        (lambda: RampProfile(0.1, 0.2, 0.5, 2.0, 50.0, 0.0), "to_m = 0.2: must be at least 0.273438 m from from_m"),
        (lambda: RampProfile(0.1, 0.2, 0.05, 2.0, 50.0, -0.1), "pause_s = -0.1: must be >= 0"),
        (lambda: RampProfile(0.1, 0.2, 0.05, 2.0, 0.0, 0.0), "jerk_mps3 = 0.0: must be finite and > 0"),
        (lambda: SCurveProfile((0.1, 0.5), 1.0, 0.5, 2.0, 20.0), "dwell_s = 1.0: must be >= 1.15 s, which the"),
        (lambda: SCurveProfile((0.1, 0.5), 9.0, 0.5, -2.0, 20.0), "acceleration_mps2 = -2.0: must be finite and"),
        (lambda: ChirpProfile(0.3, 0.1, 0.0, 1.0, 9.0), "first_hz = 0.0: must be finite and > 0"),
        (lambda: PrbsProfile(0.3, 0.3, 1.0, 0.5, 7, 1), "low_m = 0.3: must be < high_m = 0.3"),
        (lambda: PrbsProfile(0.3, 0.4, 1.0, 1.5, 7, 1), "ramp_s = 1.5: must be <= bit_s = 1.0"),
        (lambda: PrbsProfile(0.3, 0.4, 1.0, 0.5, 6, 1), "order = 6: must be 7 to 15"),
        (lambda: PrbsProfile(0.3, 0.4, 1.0, 0.5, 16, 1), "order = 16: must be 7 to 15"),
        (lambda: PrbsProfile(0.3, 0.4, 1.0, 0.5, 7, 0), "seed = 0: must be 1 to 2.order - 1 = 127"),
        (lambda: PrbsProfile(0.3, 0.4, 1.0, 0.5, 7, 128), "seed = 128: must be 1 to"),
    ],
)
def test_bad_numbers_are_refused_by_name(make: Callable[[], Profile], text: str) -> None:
    with pytest.raises(ProfileError, match=text):
        make()


@pytest.mark.parametrize("profile", EVERY, ids=name)
def test_compiled_equals_plain(profile: Profile) -> None:
    for t_s in np.linspace(0.0, 5.0, 57):
        plain = np.empty(4)
        getattr(evaluate, "py_func", evaluate)(profile.vector(), t_s, START_M, plain)
        np.testing.assert_allclose(plain, at(profile, t_s), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", ["sine", "steps", "ramp", "ramp_down", "s_curve", "prbs", "for_ever"])
def test_it_begins_again_after_its_period_and_not_before(kind: str) -> None:
    profile = STANDING[kind]
    times = 4.0 + profile.blend_s + np.linspace(0.0, min(profile.period_s, 20.0), 101)
    first = np.array([at(profile, t_s) for t_s in times])
    np.testing.assert_allclose([at(profile, t_s + profile.period_s) for t_s in times], first, atol=1e-8)
    for part in (0.5, 0.99):
        other = np.array([at(profile, t_s + part * profile.period_s) for t_s in times])
        assert np.abs(other - first)[:, 0].max() > 1e-4
