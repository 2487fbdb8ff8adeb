"""From amounts to flows and levels: how much oil each leak takes now, and whether that is a warning or an alarm."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.changes import LEAK_UNIT, N_LEAKS
from servohil.estimators.models.cylinder import AMBIENT, PA_PER_MPA

Vector = NDArray[np.float64]
C = at.C

MEMORY_S: Final = 3.0  # of the mean pressure differences: about a period of motion
SIGNIFICANT: Final = 6.0  # standard deviations by which a leak that grew too slowly to be an event exceeds the baseline
HYSTERESIS: Final = 0.7  # a level ends below this share of where it begins
NONE, WARNING, ALARM = range(3)


@njit(nogil=True, cache=True, error_model="numpy")
def update_levels(arena: Vector, settings: Vector, p: Vector, x: Vector) -> None:
    """After a block: mean pressure differences, flows, levels.

    An alarm is latched until it is acknowledged; a warning goes with its cause.

    Args:
        arena, settings: of the diagnosis.
        p: parameters; only the ambient pressure is read.
        x: (4,) estimate, for the pressures, MPa.
    """
    ambient = p[AMBIENT]
    share = min(1.0, arena[at.BLOCK_CYCLES] * settings[at.DT_S] / MEMORY_S)
    present = (
        abs(x[2] - x[3]) * PA_PER_MPA,
        max(x[2] * PA_PER_MPA - ambient, 0.0),
        max(x[3] * PA_PER_MPA - ambient, 0.0),
    )
    highest = NONE
    largest = 0.0
    for j in range(N_LEAKS):
        old = arena[at.DIFFERENCE_PA + j]
        arena[at.DIFFERENCE_PA + j] = present[j] if old == 0.0 else old + share * (present[j] - old)
        per_unit = LEAK_UNIT * arena[at.DIFFERENCE_PA + j]
        above = arena[at.KNOWN + j] + arena[at.THETA + j] - arena[at.BASELINE + j]
        deviation = np.sqrt(max(arena[at.COVARIANCE + j * C + j], 0.0))
        arena[at.COEFFICIENT + j] = above * LEAK_UNIT
        arena[at.COEFFICIENT_STD + j] = deviation * LEAK_UNIT
        arena[at.FLOW + j] = above * per_unit
        if arena[at.MODE] < at.WATCHING:
            continue
        if above > SIGNIFICANT * deviation and arena[at.FLOW + j] > settings[at.WARN]:
            arena[at.NAMED + j] = 1.0
        if arena[at.NAMED + j] == 0.0:
            continue
        flow = arena[at.FLOW + j]
        level = NONE
        for candidate in (WARNING, ALARM):
            begins = settings[at.WARN] if candidate == WARNING else settings[at.ALARM]
            if flow >= begins or (arena[at.LEVEL] >= candidate and arena[at.LEAK] == j and flow >= HYSTERESIS * begins):
                level = candidate
        if level == NONE and flow < HYSTERESIS * settings[at.WARN] and above < SIGNIFICANT * deviation:
            arena[at.NAMED + j] = 0.0  # it has closed
        if level > highest or (level == highest and level > NONE and flow > largest):
            highest, largest = level, flow
            arena[at.LEAK] = j
    if highest == ALARM and arena[at.LEVEL] < ALARM:  # by its edge: what was acknowledged ends with its cause
        arena[at.LATCHED] = 1.0
    arena[at.LEVEL] = highest
    if highest == NONE and arena[at.LATCHED] == 0.0:
        arena[at.LEAK] = -1.0
