"""The profile that a [reference] table describes; a trajectory's samples become its spline here."""

from bisect import bisect_right
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.control.references import (
    ChirpProfile,
    PrbsProfile,
    Profile,
    ProfileError,
    RampProfile,
    SCurveProfile,
    SineProfile,
    StepProfile,
    TrajectoryProfile,
)
from servohil.hil.config.controller import Limits
from servohil.hil.config.reference import AnyReference, TrajectoryReference
from servohil.hil.config.trajectory_file import read_trajectory

DEGREE: Final = 7
# The fields of each class are the keys of its table.
PROFILES: Final[dict[str, type[Profile]]] = {
    "sine": SineProfile,
    "step": StepProfile,
    "ramp": RampProfile,
    "s_curve": SCurveProfile,
    "chirp": ChirpProfile,
    "prbs": PrbsProfile,
}


def checked_profile(reference: AnyReference, folder: Path, limits: Limits) -> Profile:
    """The profile of `reference`, within `limits`.

    Args:
        reference: the table.
        folder: where the TOML file lies, and a trajectory's file from there.
        limits: of the rig.

    Raises:
        ProfileError: the condition that is broken, with the lines of the file where it is a trajectory's.
        TrajectoryFileError: the file has changed since the rig was loaded.
    """
    profile: Profile
    if isinstance(reference, TrajectoryReference):
        samples = reference.inline(folder)
        profile = spline_through(np.array(samples.t_s), np.array(samples.position_m), samples.repeat, samples.blend_s)
    else:
        keys: dict[str, Any] = reference.model_dump(exclude={"kind"})
        profile = PROFILES[reference.kind](**keys)
    allowed = (limits.position_min_m, limits.position_max_m, limits.speed_max_mps, limits.acceleration_max_mps2)
    try:
        profile.check_limits(*allowed)
    except ProfileError as error:
        if error.at_s is None or not isinstance(reference, TrajectoryReference) or reference.file is None:
            raise
        rows = read_trajectory(folder / reference.file)
        since = [row.t_s - rows[0].t_s for row in rows]
        after = min(max(bisect_right(since, error.at_s), 1), len(rows) - 1)
        lines = f"lines {rows[after - 1].line} and {rows[after].line}"
        raise ProfileError(f"{folder / reference.file}: between {lines}: {error}") from None
    return profile


def spline_through(
    t_s: NDArray[np.float64], position_m: NDArray[np.float64], repeat: bool, blend_s: float
) -> TrajectoryProfile:
    """The spline of degree 7 through the samples whose velocity, acceleration and jerk are 0 at both ends.

    Its first six derivatives are continuous; time begins with the first sample. Like every spline it swings between
    samples that jump or whose distances in time differ much.

    Args:
        t_s: (N,) increasing, N >= 2.
        position_m: (N,).
        repeat, blend_s: as in `TrajectoryProfile`.
    """
    from scipy.interpolate import PPoly, make_interp_spline  # here: only this kind of reference needs it

    since = t_s - t_s[0]
    spacing = since[-1] / (since.size - 1)  # a time unit in which the equations are well scaled
    rest = [(derivative, 0.0) for derivative in (1, 2, 3)]
    spline = make_interp_spline(since / spacing, position_m, k=DEGREE, bc_type=(rest, rest))
    inner = slice(DEGREE, -DEGREE)  # the knots at the ends stand there eight times
    table = PPoly.from_spline(spline).c[:, inner].T[:, ::-1] / spacing ** np.arange(DEGREE + 1)
    return TrajectoryProfile(since, np.ascontiguousarray(table), repeat, blend_s)
