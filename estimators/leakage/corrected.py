"""The model with what is known to have changed: parameters, inputs and measurements as they are now."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage.changes import (
    AGAINST_MOTION,
    AGAINST_OPENING,
    ALWAYS,
    CHANGES,
    INPUT,
    N_CHANGES,
    PARAMETER,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MOVES, PLACE, UNIT, WHEN, TABLE_COLUMNS = range(5)  # columns of the table that `change_table` makes
# Widths over which a sign changes: the model's derivatives stay finite there.
REST_MPS: Final = 5e-3
CENTRE_V: Final = 0.02


def change_table(p: Vector) -> Matrix:
    """(N_CHANGES, TABLE_COLUMNS) of what moves what, for the configured parameters p of the cylinder."""
    rows = [(c.moves, c.place, c.unit * (p[c.place] if c.relative else 1.0), c.when) for c in CHANGES]
    return np.array(rows, dtype=np.float64)


@njit(nogil=True, cache=True, error_model="numpy")
def sharing(when: float, velocity: float, valve_v: float) -> float:
    """By which part a change acts now."""
    if when == ALWAYS:
        return 1.0
    if when == AGAINST_MOTION:
        return velocity / np.sqrt(velocity * velocity + REST_MPS * REST_MPS)
    if when == AGAINST_OPENING:
        return -valve_v / np.sqrt(valve_v * valve_v + CENTRE_V * CENTRE_V)
    return 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def correct(table: Matrix, amounts: Vector, velocity: float, p: Vector, u: Vector, y: Vector) -> None:
    """Add the changes to p and u, and take them out of y, in place.

    Args:
        table: of `change_table`.
        amounts: (N_CHANGES,) in the units of the changes.
        velocity: m/s, for friction.
        p: (14,) parameters; on entry as configured.
        u: (3,) valve V, supply Pa, tank Pa.
        y: (3,) position m, pressures A and B MPa; NaN stays NaN.
    """
    valve = u[0]
    for j in range(N_CHANGES):
        amount = amounts[j] * table[j, UNIT] * sharing(table[j, WHEN], velocity, valve)
        place = int(table[j, PLACE])
        if table[j, MOVES] == PARAMETER:
            p[place] += amount
        elif table[j, MOVES] == INPUT:
            u[place] += amount
        else:
            y[place] -= amount
