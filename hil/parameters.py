"""Parameters that an operator may change while the loop runs: name, unit, bounds, and how a set of them must fit
together.

A change is applied at a cycle edge. Reference parameters act from the next entry into ACTIVE: a profile that changes
under a moving piston would jump.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.control.laws.catalogue import LAWS
from servohil.control.references import sine
from servohil.hil.commands import Result
from servohil.hil.config import Rig

Vector = NDArray[np.float64]


class Parameter(NamedTuple):
    """One tunable: dotted name as in the rig file, unit, bounds and the value at the start."""

    name: str
    unit: str
    minimum: float
    maximum: float
    value: float


# Positions in the parameter vector of the cycle state.
THRESHOLD_SIGMA, CUSUM_THRESHOLD, COMMAND_MAX = range(3)
OFFSET, AMPLITUDE, OMEGA = 3, 4, 5  # only with a sine reference
SWITCHING_GAIN: Final = "control.switching_gain"  # the last of the table, where the law has one

N_PARAMETERS: Final = 7


def parameter_table(rig: Rig) -> list[Parameter]:
    """The tunables of a rig, in the order of the cycle's parameter vector."""
    leakage, control, limits, profile = rig.leakage, rig.control, rig.limits, rig.reference
    table = [
        Parameter("leakage.threshold_sigma", "1", 3.0, 50.0, leakage.threshold_sigma),
        Parameter("leakage.cusum_threshold", "1", 5.0, 1e4, leakage.cusum_threshold),
        # Below its dead band the spool lets nothing through.
        Parameter("limits.command_max_v", "V", 0.1 + control.dead_band_v, limits.command_max_v, limits.command_max_v),
    ]
    if profile.kind == "sine":
        low, high = limits.position_min_m, limits.position_max_m
        swing = (high - low) / 2.0
        table += [
            Parameter("reference.offset_m", "m", low, high, profile.offset_m),
            Parameter("reference.amplitude_m", "m", 0.0, swing, profile.amplitude_m),
            Parameter("reference.omega_rad_per_s", "rad/s", 0.01, 100.0, profile.omega_rad_per_s),
        ]
    switching = getattr(control, "switching_gain", 0.0)
    if switching > 0.0:
        table.append(Parameter(SWITCHING_GAIN, "m/s3", 0.01, 20.0 * switching, switching))
    return table


def change(values: Vector, index: int, value: float, table: Sequence[Parameter], rig: Rig) -> Result:
    """Take one parameter when it, and all of them together, stay within bounds; otherwise nothing changes."""
    if not 0 <= index < len(table):
        return Result.UNKNOWN
    if not table[index].minimum <= value <= table[index].maximum:  # so is NaN refused
        return Result.OUT_OF_RANGE
    former = float(values[index])
    values[index] = value
    if not fits_together(values, table, rig):
        values[index] = former
        return Result.OUT_OF_RANGE
    return Result.ACCEPTED


def fits_together(values: Vector, table: Sequence[Parameter], rig: Rig) -> bool:
    """Whether the reference that these values describe stays inside the limits of the rig."""
    if not _has_sine(table):
        return True
    limits = rig.limits
    offset, swing, omega = values[OFFSET], values[AMPLITUDE], values[OMEGA]
    inside = offset - swing >= limits.position_min_m and offset + swing <= limits.position_max_m
    slow = swing * omega <= limits.speed_max_mps
    most = limits.acceleration_max_mps2
    return bool(inside and slow and (most is None or swing * omega**2 <= most))


def put_into_profile(values: Vector, table: Sequence[Parameter], profile: Vector) -> None:
    """Write the reference parameters into the profile vector of `control.references`."""
    if _has_sine(table):
        profile[sine.OFFSET] = values[OFFSET]
        profile[sine.AMPLITUDE] = values[AMPLITUDE]
        profile[sine.OMEGA] = values[OMEGA]


def put_into_gains(values: Vector, table: Sequence[Parameter], gains: Vector, law: str) -> None:
    """Write the switching gain, where the law has one, into its gain vector."""
    place = LAWS[law].switching
    if place is not None and table[-1].name == SWITCHING_GAIN:
        gains[place] = values[len(table) - 1]


def _has_sine(table: Sequence[Parameter]) -> bool:
    return len(table) > OMEGA
