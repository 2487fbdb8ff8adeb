"""Reference profiles: derivatives against finite differences, joins, the start, and what is refused."""

import numpy as np
import pytest

from servohil.control.reference import HoldProfile, Profile, ProfileError, SineProfile, StepProfile, evaluate

HOLD = HoldProfile(0.4, blend_s=1.5)
SINE = SineProfile(0.3, 0.15, 2.0, blend_s=2.0)
STEPS = StepProfile((0.2, 0.35, 0.3), dwell_s=1.0, ramp_s=0.4, blend_s=1.7)
PROFILES = [HOLD, SINE, STEPS]
START_M = 0.18


def at(profile: Profile, t_s: float, start_m: float = START_M) -> np.ndarray:
    out = np.full(4, np.nan)
    evaluate(profile.vector(), t_s, start_m, out)
    return out


@pytest.mark.parametrize("profile", PROFILES)
def test_starts_exactly_at_the_measured_position_at_rest(profile: Profile) -> None:
    for t_s in (-1.0, 0.0):
        assert at(profile, t_s).tolist() == [START_M, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("profile", PROFILES)
def test_derivatives_agree_with_finite_differences(profile: Profile) -> None:
    h = 1e-5
    for t_s in np.linspace(0.013, 7.77, 400):
        slope = (at(profile, t_s + h) - at(profile, t_s - h)) / (2.0 * h)
        scale = np.array([1.0, 5.0, 50.0])  # of the derivatives; a join of ramps bends the third
        assert np.all(np.abs(slope[:3] - at(profile, t_s)[1:]) <= 1e-4 * scale), t_s


@pytest.mark.parametrize(
    ("profile", "joins"),
    [(HOLD, [0.0, 1.5]), (SINE, [0.0, 2.0]), (STEPS, [0.0, 1.0, 1.4, 1.7, 2.0, 2.4, 3.0, 3.4, 4.0])],
)
def test_three_derivatives_are_continuous_at_the_joins(profile: Profile, joins: list[float]) -> None:
    for t_s in joins:
        jump = at(profile, t_s + 1e-9) - at(profile, t_s - 1e-9)
        assert np.all(np.abs(jump) < [1e-8, 1e-7, 1e-6, 1e-4]), (t_s, jump)


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


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("start_m", [0.02, 0.58])
def test_a_profile_that_passes_the_check_keeps_the_limits(profile: Profile, start_m: float) -> None:
    profile.check_limits(0.02, 0.58, 1.0)
    path = np.array([at(profile, t_s, start_m) for t_s in np.linspace(0.0, 8.0, 3001)])
    assert path[:, 0].min() >= 0.02
    assert path[:, 0].max() <= 0.58
    assert np.abs(path[:, 1]).max() <= 1.0


@pytest.mark.parametrize(
    ("profile", "text"),
    [
        (SineProfile(0.32, 0.29, 0.1), r"offset_m \+- amplitude_m reaches 0.61 m: allowed 0.02 to 0.58 m"),
        (SineProfile(0.3, -0.29, 0.1), "reaches 0.01 m: allowed"),
        (SineProfile(0.3, 0.15, 7.0), r"profile reaches 1.05\d* m/s: allowed up to 1 m/s"),
        (
            SineProfile(0.3, 0.1, 1.0, blend_s=0.5),
            r"blend_s = 0.5 s reaches .* m/s when entered from 0.\d+ m: allowed up to 1 m/s",
        ),
        (StepProfile((0.1, 0.6), 1.0, 1.0), "levels_m reaches 0.6 m"),
        (StepProfile((0.1, 0.5), 1.0, 0.8), r"profile reaches 1.09375 m/s"),
        (HoldProfile(0.6), "position_m reaches 0.6 m"),
        (HoldProfile(0.5, blend_s=0.9), r"blend_s = 0.9 s reaches .* when entered from 0.02 m"),
    ],
)
def test_a_profile_beyond_a_limit_is_refused_with_value_and_limit(profile: Profile, text: str) -> None:
    with pytest.raises(ProfileError, match=text):
        profile.check_limits(0.02, 0.58, 1.0)


def test_bad_numbers_are_refused_by_name() -> None:
    with pytest.raises(ProfileError, match="offset_m = nan"):
        SineProfile(float("nan"), 0.1, 1.0)
    with pytest.raises(ProfileError, match=r"omega_rad_per_s = 0.0: must be finite and > 0"):
        SineProfile(0.3, 0.1, 0.0)
    with pytest.raises(ProfileError, match=r"blend_s = -1.0"):
        HoldProfile(0.3, blend_s=-1.0)
    with pytest.raises(ProfileError, match="levels_m is empty"):
        StepProfile((), 1.0, 0.5)
    with pytest.raises(ProfileError, match=r"levels_m\[1\] = inf"):
        StepProfile((0.2, float("inf")), 1.0, 0.5)
    with pytest.raises(ProfileError, match=r"ramp_s = 2.0: must be <= dwell_s = 1.0"):
        StepProfile((0.2, 0.3), 1.0, 2.0)


@pytest.mark.parametrize("profile", PROFILES)
def test_compiled_equals_plain(profile: Profile) -> None:
    for t_s in np.linspace(0.0, 5.0, 57):
        plain = np.empty(4)
        getattr(evaluate, "py_func", evaluate)(profile.vector(), t_s, START_M, plain)
        np.testing.assert_allclose(plain, at(profile, t_s), rtol=1e-12, atol=1e-12)
