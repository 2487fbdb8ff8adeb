"""Reference profiles, evaluated inside the cycle: position and three derivatives, continuous.

A profile g(t) travels as one float64 vector: [kind, blend_s, numbers of the kind]. It is always entered from the
position measured at the moment of enabling (t = 0): r = (1 - beta) start + beta g, where beta(t / blend_s) is the
septic polynomial from 0 to 1 whose first three derivatives vanish at both ends. So r starts exactly at `start_m`, at
rest and without acceleration or jerk, and equals g from t = blend_s on. Being a mean of the two, it never leaves the
range that `start_m` and the profile span.

All kinds have a continuous jerk but one: that of the time-optimal `SCurveProfile` is piecewise constant.
"""

from servohil.control.references.chirp import ChirpProfile
from servohil.control.references.evaluate import evaluate
from servohil.control.references.hold import HoldProfile
from servohil.control.references.prbs import PrbsProfile
from servohil.control.references.profile import Profile, ProfileError
from servohil.control.references.ramp import RampProfile
from servohil.control.references.s_curve import SCurveProfile
from servohil.control.references.sine import SineProfile
from servohil.control.references.steps import StepProfile
from servohil.control.references.trajectory import TrajectoryProfile

__all__ = [
    "ChirpProfile",
    "HoldProfile",
    "PrbsProfile",
    "Profile",
    "ProfileError",
    "RampProfile",
    "SCurveProfile",
    "SineProfile",
    "StepProfile",
    "TrajectoryProfile",
    "evaluate",
]
