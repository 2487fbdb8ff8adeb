"""One reference profile of every kind, and its value at a time."""

import numpy as np

from servohil.control.references import (
    ChirpProfile,
    HoldProfile,
    PrbsProfile,
    Profile,
    RampProfile,
    SCurveProfile,
    SineProfile,
    StepProfile,
    TrajectoryProfile,
    evaluate,
)

START_M = 0.18


def at(profile: Profile, t_s: float, start_m: float = START_M) -> np.ndarray:
    out = np.full(4, np.nan)
    evaluate(vector_of(profile), t_s, start_m, out)
    return out


_VECTORS: dict[int, tuple[Profile, np.ndarray]] = {}


def vector_of(profile: Profile) -> np.ndarray:
    """`profile.vector()`, kept: some take a while."""
    if id(profile) not in _VECTORS:
        _VECTORS[id(profile)] = profile, profile.vector()
    return _VECTORS[id(profile)][1]


def septic_trajectory(from_m: float, to_m: float, duration_s: float, there_and_back: bool = False) -> TrajectoryProfile:
    """The one polynomial of degree 7 from rest to rest."""
    row = (to_m - from_m) * np.array([0.0, 0, 0, 0, 35, -84, 70, -20]) / duration_s ** np.arange(8.0)
    rows = np.array([row, -row]) if there_and_back else row[None, :].copy()
    rows[0, 0] = from_m
    if there_and_back:
        rows[1, 0] = to_m
    return TrajectoryProfile(np.arange(len(rows) + 1) * duration_s, rows, repeat=there_and_back, blend_s=1.3)


STANDING: dict[str, Profile] = {
    "hold": HoldProfile(0.4, blend_s=1.5),
    "sine": SineProfile(0.3, 0.15, 2.0, blend_s=2.0),
    "steps": StepProfile((0.2, 0.35, 0.3), dwell_s=1.0, ramp_s=0.4, blend_s=1.7),
    "ramp": RampProfile(0.2, 0.5, 0.25, 1.2, 40.0, pause_s=0.3, blend_s=1.6),
    "ramp_down": RampProfile(0.5, 0.2, 0.25, 2.0, 12.0, pause_s=0.0, blend_s=1.6),
    "s_curve": SCurveProfile((0.2, 0.5, 0.47, 0.3), 2.0, 0.4, 2.0, 25.0, blend_s=1.9),
    "chirp": ChirpProfile(0.3, 0.04, 0.2, 1.5, 4.0, blend_s=1.8),
    "chirp_down": ChirpProfile(0.3, 0.04, 1.5, 0.2, 4.0, blend_s=1.8),
    "prbs": PrbsProfile(0.25, 0.32, 0.5, 0.35, 7, 5, blend_s=2.1),
    "once": septic_trajectory(0.25, 0.4, 1.6),
    "for_ever": septic_trajectory(0.25, 0.4, 1.6, there_and_back=True),
}
SMOOTH = [profile for kind, profile in STANDING.items() if kind != "s_curve"]
