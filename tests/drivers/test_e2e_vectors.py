"""End-to-end protection held against an independent implementation, and the figures that are published."""

from itertools import product

import e2e as autosar
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servohil.drivers import e2e
from servohil.drivers.e2e import CRC_TABLE, Check, MessageProtection, data_ids, p02_check, p02_protect

# `rigs/bench.toml` carries these numbers, and so does whatever device was set up from it.
IDS_OF_17 = (17, 180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, 172, 252, 192, 54)
IDS = np.array(IDS_OF_17)


def test_the_data_ids_are_the_published_ones() -> None:
    assert data_ids(17) == IDS_OF_17
    assert data_ids(0x17) == tuple(value ^ 17 ^ 0x17 for value in IDS_OF_17)
    assert [value ^ 17 for value in IDS_OF_17] == list(data_ids(0))


def test_two_data_ids_differ_in_an_even_number_of_bits() -> None:
    for one, other in product(data_ids(0), repeat=2):
        assert (one ^ other).bit_count() % 2 == 0
    assert len(set(data_ids(0))) == 16


def test_figures_of_the_profile() -> None:
    """AUTOSAR profile 2 has 16 counts and 16 data ids; the codes stand in recordings."""
    assert (e2e.POLYNOMIAL, e2e.DATA_ID_COUNT, e2e.COUNTER_MODULUS, e2e.MAX_DELTA) == (0x2F, 16, 16, 3)
    assert e2e.NO_COUNTER not in range(16)
    assert [check.name for check in Check] == [
        "OK", "OK_SOME_LOST", "INITIAL", "REPEATED", "WRONG_SEQUENCE", "CRC_ERROR",
    ]  # fmt: skip
    assert [int(check) for check in Check] == list(range(6))


def test_the_table_of_the_crc_is_the_other_implementations() -> None:
    """One byte at a time, from a register of zero; theirs starts at 0xFF and ends with an xor of it."""
    assert CRC_TABLE.shape == (256,)
    for byte in range(256):
        theirs = autosar.crc.calculate_crc8_h2f(bytes([byte ^ 0xFF]), 0xFF, True)
        assert int(CRC_TABLE[byte]) == theirs ^ 0xFF


@settings(max_examples=200, deadline=None)
@given(
    st.binary(min_size=2, max_size=8),
    st.integers(0, 15),
    st.binary(min_size=16, max_size=16),
    st.lists(st.tuples(st.integers(0, 63), st.booleans()), max_size=4),
)
def test_a_frame_that_one_accepts_the_other_accepts(
    payload: bytes, counter: int, ids: bytes, flips: list[tuple[int, bool]]
) -> None:
    """Made by either, then damaged in any number of bits, and judged by both."""
    ours = np.frombuffer(bytearray(payload), np.uint8)
    listed = np.frombuffer(ids, np.uint8).astype(np.int64)
    p02_protect(ours, len(ours), counter, listed)
    for bit, _ in flips:
        ours[bit // 8 % len(ours)] ^= 1 << bit % 8
    code, last = p02_check(ours, len(ours), (int(ours[1]) - 1) % 16, 3, listed)
    accepted = autosar.p02.e2e_p02_check(bytes(ours), ids)
    assert (code == Check.OK) is accepted
    assert (code == Check.CRC_ERROR) is not accepted
    assert last == (int(ours[1]) & 15 if accepted else (int(ours[1]) - 1) % 16)


@pytest.mark.parametrize("max_delta", [1, 2, 3, 15])
def test_the_tolerance_is_the_callers(max_delta: int) -> None:
    """Up to `max_delta` counts on: good; the first is plainly so."""
    for last, delta in product(range(16), range(1, 16)):
        frame = np.zeros(8, np.uint8)
        p02_protect(frame, 8, (last + delta) % 16, IDS)
        code, reference = p02_check(frame, 8, last, max_delta, IDS)
        expected = Check.OK if delta == 1 else Check.OK_SOME_LOST if delta <= max_delta else Check.WRONG_SEQUENCE
        assert (code, reference) == (expected, (last + delta) % 16)


def test_what_a_good_protection_is() -> None:
    whole = MessageProtection(1, "profile2", tuple(range(0, 256, 17)))
    assert (whole.period_ns, whole.e2e, len(whole.data_ids)) == (1, "profile2", 16)
    assert {0, 255} <= set(whole.data_ids)
    assert MessageProtection(1, "none").data_ids == ()
    assert MessageProtection(1, data_ids=data_ids(3)).e2e == "profile2"
    with pytest.raises(ValueError, match="15 given"):
        MessageProtection(1, "profile2", tuple(range(15)))
    with pytest.raises(ValueError, match="17 given"):
        MessageProtection(1, "profile2", tuple(range(17)))
    with pytest.raises(ValueError, match="period_ns = -1"):
        MessageProtection(-1, "none")
    with pytest.raises(ValueError, match="256 is not a byte"):
        MessageProtection(1, "none", (256,))
    assert not hasattr(whole, "__dict__")
    with pytest.raises(AttributeError):
        whole.e2e = "none"  # type: ignore[misc]
