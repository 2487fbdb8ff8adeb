"""What a filter's step reports instead of raising: a status, and counters that telemetry can show."""

from dataclasses import dataclass
from enum import IntFlag
from typing import Final

# Plain ints for compiled code.
OK: Final = 0
MISSING: Final = 1
GATED: Final = 2
REPAIRED: Final = 4
NOT_FINITE_INPUT: Final = 8
DIVERGED: Final = 16
TOO_OLD: Final = 32
GATE_PATIENCE: Final = 100  # steps
WRONG_SIZE: Final = -1  # of u or y: a programming error, which `step` raises in Python


class Status(IntFlag):
    """Bits of the value that `step` returns."""

    OK = OK
    MISSING = MISSING  # at least one channel of y was NaN; the others were used
    GATED = GATED  # the innovation failed the chi-square gate: predicted, not corrected
    # the correction was numerically meaningless and left out, or a factorisation failed and another form stood in, or
    # a gate shut too long was opened, and the covariance grown by the surprise
    REPAIRED = REPAIRED
    NOT_FINITE_INPUT = NOT_FINITE_INPUT  # u not finite or y infinite: nothing was done
    DIVERGED = DIVERGED  # the prediction was not finite: rolled back to the estimate before
    TOO_OLD = TOO_OLD  # a late measurement from before what the ring of `DelayedFilter` remembers: not used


@dataclass(frozen=True)
class Health:
    """Counts since the last reset."""

    steps: int
    missing: int
    gated: int
    repaired: int
    not_finite_input: int
    diverged: int
    since_full_update: int  # steps in a row whose measurement was not, or only partly, used
    gated_in_a_row: int  # beyond `GATE_PATIENCE` the gate is open: the estimate is wrong rather than the sensor
