"""The reference at one moment, whatever the kind of its profile."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.references.blend import BLEND, KIND, blend_in
from servohil.control.references.chirp import CHIRP, chirp
from servohil.control.references.hold import hold
from servohil.control.references.prbs import PRBS, prbs
from servohil.control.references.ramp import RAMP, ramp
from servohil.control.references.s_curve import S_CURVE, s_curve
from servohil.control.references.sine import SINE, sine
from servohil.control.references.steps import STEPS, steps
from servohil.control.references.trajectory import TRAJECTORY, trajectory

Vector = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(profile: Vector, t_s: float, start_m: float, out: Vector) -> None:
    """Fill out (4,) with position m, velocity m/s, acceleration m/s2 and jerk m/s3 of the reference.

    Pure. Before t = 0 the reference stands at `start_m`.

    Args:
        profile: `.vector()` of one of the profile classes.
        t_s: time since the profile was entered, s.
        start_m: measured position at that moment, m.
        out: (4,) filled.
    """
    time = max(t_s, 0.0)
    kind = int(profile[KIND])
    if kind == SINE:
        sine(profile, time, out)
    elif kind == STEPS:
        steps(profile, time, out)
    elif kind == RAMP:
        ramp(profile, time, out)
    elif kind == S_CURVE:
        s_curve(profile, time, out)
    elif kind == CHIRP:
        chirp(profile, time, out)
    elif kind == PRBS:
        prbs(profile, time, out)
    elif kind == TRAJECTORY:
        trajectory(profile, time, out)
    else:
        hold(profile, time, out)
    blend_in(time, profile[BLEND], start_m, out)
