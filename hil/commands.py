"""What an operator can ask of the controller, as small integers: they cross a ring and stand in recordings."""

from enum import IntEnum


class Command(IntEnum):
    """Operator commands; `SET_PARAM` carries a parameter index and a value, the others carry nothing."""

    NONE = 0
    ENABLE = 1
    HOLD = 2
    DISABLE = 3
    RESET = 4
    ESTOP = 5
    ACKNOWLEDGE = 6
    SET_PARAM = 7
    SHUTDOWN = 8  # disable and leave the loop; the end of a bench


class Result(IntEnum):
    """What became of the last command; published in the Snapshot of the cycle that applied it."""

    NONE = 0
    ACCEPTED = 1
    REFUSED_STATE = 2  # the device state has no arrow that way
    OUT_OF_RANGE = 3  # a parameter value outside its bounds
    UNKNOWN = 4
