"""End-to-end protection against published vectors, another implementation, and exhaustive errors."""

import e2e as autosar
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from servohil.drivers.e2e import (
    MAX_DELTA,
    NO_COUNTER,
    Check,
    MessageProtection,
    crc8_h2f,
    data_ids,
    p02_check,
    p02_crc,
    p02_protect,
)

IDS = np.array(data_ids(0x11))


def protected(counter: int, payload: bytes = bytes(8), ids: np.ndarray = IDS) -> np.ndarray:
    data = np.frombuffer(bytearray(payload), dtype=np.uint8)
    p02_protect(data, len(data), counter, ids)
    return data


def test_crc_check_value() -> None:
    data = np.frombuffer(b"123456789", dtype=np.uint8)
    assert crc8_h2f(data, 0, 9, 0xFF) ^ 0xFF == 0xDF


def test_frame_vector() -> None:
    assert protected(1, ids=np.arange(16)).tobytes().hex() == "6a01000000000000"


@settings(max_examples=300, deadline=None)
@given(st.binary(min_size=2, max_size=8), st.integers(0, 15), st.binary(min_size=16, max_size=16))
def test_agrees_with_autosar_e2e(payload: bytes, counter: int, ids: bytes) -> None:
    ours = protected(counter, payload, np.frombuffer(ids, dtype=np.uint8).astype(np.int64))
    theirs = bytearray(payload)
    theirs[1] = (theirs[1] & 0xF0) | counter
    autosar.p02.e2e_p02_protect(theirs, ids, increment_counter=False)
    assert ours.tobytes() == bytes(theirs)
    assert autosar.p02.e2e_p02_check(ours.tobytes(), ids)


def test_the_high_nibble_beside_the_counter_is_data() -> None:
    assert protected(5, bytes([0, 0xA7, 1, 2]))[1] == 0xA5


@njit
def undetected_errors(ids: np.ndarray) -> np.ndarray:
    """How many of all 1-, 2- and 3-bit errors, under each counter, pass the CRC. (4,) by number of bits.

    The CRC is linear and the data id depends on the counter alone: the payload makes no difference.
    """
    passed = np.zeros(4, np.int64)
    frame = np.zeros(8, np.uint8)
    for counter in range(16):
        for first in range(64):
            for second in range(first, 64):
                for third in range(second, 64):
                    if first == second and second != third:
                        continue  # the two-bit errors are those with second == third
                    bits = 1 if first == third else 2 if second == third else 3
                    frame[:] = 0x5A
                    p02_protect(frame, 8, counter, ids)
                    frame[first >> 3] ^= 1 << (first & 7)
                    if bits > 1:
                        frame[second >> 3] ^= 1 << (second & 7)
                    if bits > 2:
                        frame[third >> 3] ^= 1 << (third & 7)
                    passed[bits] += frame[0] == p02_crc(frame, 8, ids)
    return passed


@pytest.mark.parametrize("base", [0x00, 0xA4])
def test_every_1_2_and_3_bit_error_is_detected(base: int) -> None:
    assert undetected_errors(np.array(data_ids(base))).tolist() == [0, 0, 0, 0]


def test_arbitrary_data_ids_do_not_detect_every_error() -> None:
    """Why `data_ids` exists; and that the exhaustive search above can find something."""
    assert undetected_errors(np.arange(16) * 17)[1:].sum() > 0


def test_masquerade_is_detected_under_every_counter() -> None:
    for counter in range(16):
        frame = protected(counter, b"\0\0position", IDS)[:8].copy()
        for base in range(256):
            other = np.array(data_ids(base))
            code, _ = p02_check(frame, 8, (counter - 1) % 16, MAX_DELTA, other)
            expected = p02_crc(frame, 8, other) == frame[0]
            assert (code == Check.OK) == expected
    frame = protected(3)
    verdicts = [p02_check(frame, 8, 2, MAX_DELTA, np.array(data_ids(base)))[0] for base in range(256)]
    assert [base for base, code in enumerate(verdicts) if code != Check.CRC_ERROR] == [0x11]


def test_bytes_beyond_the_length_do_not_count() -> None:
    frame = protected(1, bytes(5))
    longer = np.concatenate([frame, np.array([9, 9, 9], dtype=np.uint8)])
    assert p02_check(longer, 5, 0, MAX_DELTA, IDS) == (Check.OK, 1)


def judge(counters: list[int]) -> list[Check]:
    last, verdicts = NO_COUNTER, []
    for counter in counters:
        code, last = p02_check(protected(counter), 8, last, MAX_DELTA, IDS)
        verdicts.append(Check(code))
    return verdicts


def test_a_good_stream_is_good_around_the_clock() -> None:
    assert judge([*range(16), *range(16)]) == [Check.INITIAL, *[Check.OK] * 31]


@pytest.mark.parametrize("last", range(16))
@pytest.mark.parametrize("delta", range(16))
def test_every_step_of_the_counter(last: int, delta: int) -> None:
    expected = [Check.REPEATED, Check.OK, *[Check.OK_SOME_LOST] * (MAX_DELTA - 1)]
    expected += [Check.WRONG_SEQUENCE] * (16 - len(expected))
    assert judge([last, (last + delta) % 16])[1] == expected[delta]


def test_repetition_is_refused_for_as_long_as_it_lasts() -> None:
    assert judge([1, 2, 2, 2, 3])[2:] == [Check.REPEATED, Check.REPEATED, Check.OK]


def test_a_long_loss_costs_one_more_frame() -> None:
    assert judge([1, 2, 9, 10])[2:] == [Check.WRONG_SEQUENCE, Check.OK]


def test_swapped_frames_are_noticed_and_the_stream_recovers() -> None:
    verdicts = judge([1, 2, 4, 3, 5, 6])
    assert verdicts[3] == Check.WRONG_SEQUENCE
    assert verdicts[5] == Check.OK


def test_two_interleaved_senders_never_agree() -> None:
    """Two streams, eight counts apart: the second commander case for a receiver."""
    mixed = [counter for k in range(20) for counter in (k % 16, (k + 8) % 16)]
    assert set(judge(mixed)[1:]) == {Check.WRONG_SEQUENCE}


def test_a_crc_error_does_not_move_the_counter() -> None:
    frame = protected(9)
    frame[4] ^= 1
    assert p02_check(frame, 8, 3, MAX_DELTA, IDS) == (Check.CRC_ERROR, 3)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((0, "none"), "period_ns = 0"),
        ((1, "profile1"), '"profile1"'),
        ((1, "profile2", (1, 2)), "2 given"),
        ((1, "profile2", (256, *range(15))), "256"),
        ((1, "profile2", (*range(15), -1)), "-1"),
    ],
)
def test_bad_protection_is_refused_by_name(arguments: tuple, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        MessageProtection(*arguments)
