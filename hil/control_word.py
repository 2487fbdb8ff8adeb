"""CiA 408 device control and status words: four bits each, as the bus carries them.

Control word: D (device enabled), H (hold enabled), M (mode active), R (reset of a fault). The status word shows the
state by the same letters; the table is the profile's (states FAULT_* have no R).
"""

from typing import Final

from servohil.hil.gate import DeviceState

D_BIT: Final = 1
H_BIT: Final = 2
ACTIVE_BIT: Final = 4
R_BIT: Final = 8
DRIVE_BITS: Final = H_BIT | ACTIVE_BIT  # the valve is driven while either is set

# (control word we send, status word that shows the state); bit order M H D in the low three, R on top.
_WORDS: Final[dict[DeviceState, tuple[int, int]]] = {
    DeviceState.INIT: (0, R_BIT),
    DeviceState.DISABLED: (D_BIT, R_BIT | D_BIT),
    DeviceState.HOLD: (D_BIT | H_BIT, R_BIT | H_BIT | D_BIT),
    DeviceState.ACTIVE: (D_BIT | H_BIT | ACTIVE_BIT, R_BIT | ACTIVE_BIT | H_BIT | D_BIT),
    DeviceState.FAULT_REACTION: (D_BIT | H_BIT, ACTIVE_BIT | H_BIT | D_BIT),
    DeviceState.FAULT_HOLD: (D_BIT | H_BIT, H_BIT | D_BIT),
    DeviceState.FAULT_DISABLED: (0, D_BIT),
}


def control_word(state: int) -> int:
    """The control word that the controller sends in a device state."""
    return _WORDS[DeviceState(state)][0]


def status_word(state: int) -> int:
    """The status word that shows a device state."""
    return _WORDS[DeviceState(state)][1]
