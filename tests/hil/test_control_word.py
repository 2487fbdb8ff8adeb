"""CiA 408 words: bit for bit as in the profile's table (R M H D)."""

import pytest

from servohil.hil.control_word import ACTIVE_BIT, DRIVE_BITS, control_word, status_word
from servohil.hil.gate import DeviceState as S

# The profile's status words (INIT 1000, DISABLED 1001, HOLD 1011, ACTIVE 1111, FAULT_* 0111, 0011, 0001).
STATUS = {
    S.INIT: 0b1000, S.DISABLED: 0b1001, S.HOLD: 0b1011, S.ACTIVE: 0b1111,
    S.FAULT_REACTION: 0b0111, S.FAULT_HOLD: 0b0011, S.FAULT_DISABLED: 0b0001,
}  # fmt: skip


@pytest.mark.parametrize("state", list(S))
def test_status_word_is_the_profiles(state: S) -> None:
    assert status_word(state) == STATUS[state]


def test_the_valve_is_driven_in_the_moving_states_only() -> None:
    driven = {state for state in S if control_word(state) & DRIVE_BITS}
    assert driven == {S.HOLD, S.ACTIVE, S.FAULT_REACTION, S.FAULT_HOLD}


def test_active_is_told_from_all_other_states() -> None:
    assert {state for state in S if control_word(state) & ACTIVE_BIT} == {S.ACTIVE}
