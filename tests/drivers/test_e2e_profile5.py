"""Profile 5 against published vectors, another implementation, and every error of few bits in the longest frame."""

from itertools import combinations

import e2e as autosar
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servohil.drivers import e2e
from servohil.drivers.e2e import (
    CRC16_TABLE,
    MAX_DELTA,
    NO_COUNTER,
    PROFILE5,
    Check,
    MessageProtection,
    crc16,
    p05_check,
    p05_crc,
    p05_protect,
)

ID = 0x1234
PAYLOAD = st.sampled_from([3, 8, 12, 16, 20, 24, 32, 48, 64]).flatmap(lambda n: st.binary(min_size=n, max_size=n))
DATA_ID = st.integers(0, 0xFFFF)


def protected(counter: int, payload: bytes = bytes(8), data_id: int = ID) -> np.ndarray:
    data = np.frombuffer(bytearray(payload), dtype=np.uint8)
    p05_protect(data, len(data), counter, data_id)
    return data


def test_crc_check_value() -> None:
    data = np.frombuffer(b"123456789", dtype=np.uint8)
    assert crc16(data, 0, 9, 0xFFFF) == 0x29B1
    assert crc16(data, 3, 6, crc16(data, 0, 3, 0xFFFF)) == crc16(data, 0, 6, 0xFFFF)


def test_frame_vector() -> None:
    assert protected(1).tobytes().hex() == "cf8d010000000000"


def test_figures_of_the_profile() -> None:
    assert (e2e.P05_POLYNOMIAL, e2e.P05_COUNTER_MODULUS) == (0x1021, 256)
    assert NO_COUNTER not in range(256)


def test_the_table_of_the_crc_is_the_other_implementations() -> None:
    """One byte at a time, from a register of zero."""
    assert CRC16_TABLE.shape == (256,)
    for byte in range(256):
        assert int(CRC16_TABLE[byte]) == autosar.crc.calculate_crc16(bytes([byte]), 0, False)


@settings(max_examples=300, deadline=None)
@given(PAYLOAD, st.integers(0, 255), DATA_ID)
def test_agrees_with_autosar_e2e(payload: bytes, counter: int, data_id: int) -> None:
    ours = protected(counter, payload, data_id)
    theirs = bytearray(payload)
    theirs[2] = counter
    autosar.p05.e2e_p05_protect(theirs, data_id, increment_counter=False)
    assert ours.tobytes() == bytes(theirs)
    assert p05_crc(ours, len(ours), data_id) == int.from_bytes(theirs[:2], "little")


@settings(max_examples=300, deadline=None)
@given(PAYLOAD, st.integers(0, 255), DATA_ID, st.lists(st.integers(0, 511), max_size=4))
def test_a_frame_that_one_accepts_the_other_accepts(payload: bytes, counter: int, data_id: int, flips: list) -> None:
    """Made by either, then damaged in any number of bits, and judged by both."""
    ours = protected(counter, payload, data_id)
    for bit in flips:
        ours[bit // 8 % len(ours)] ^= 1 << bit % 8
    last = (int(ours[2]) - 1) % 256
    accepted = autosar.p05.e2e_p05_check(bytes(ours), data_id)
    expected = (Check.OK, int(ours[2])) if accepted else (Check.CRC_ERROR, last)
    assert p05_check(ours, len(ours), last, MAX_DELTA, data_id) == expected


def syndromes(length: int) -> np.ndarray:
    """(8 * length,) by how much each single wrong bit makes received and computed CRC differ.

    The CRC is linear: an error passes exactly where the syndromes of its bits cancel out.
    """
    good = protected(7, bytes(range(length)))
    found = []
    for bit in range(8 * length):
        bad = good.copy()
        bad[bit // 8] ^= 1 << bit % 8
        found.append((int(bad[0]) | int(bad[1]) << 8) ^ p05_crc(bad, length, ID))
    return np.array(found)


@pytest.mark.parametrize("length", [8, 32, 64])
def test_every_error_of_1_2_or_3_bits_is_detected(length: int) -> None:
    one = syndromes(length)
    first, second = np.triu_indices(len(one), 1)
    two = one[first] ^ one[second]
    assert one.all()
    assert two.all()
    assert not np.isin(two, one).any()  # a third bit that cancels two would be one of them or another


def test_an_error_passes_where_the_syndromes_cancel() -> None:
    """The argument of the test before, with errors of 4 bits: some do pass, and these are the ones."""
    one = syndromes(64)
    pairs: dict[int, tuple[int, int]] = {}
    for pair in combinations(range(24, 200), 2):
        other = pairs.setdefault(int(one[pair[0]] ^ one[pair[1]]), pair)
        if not set(pair) & set(other):
            break
    frame = protected(7, bytes(range(64)))
    for bit in (*pair, *other):
        frame[bit // 8] ^= 1 << bit % 8
        if bit != other[1]:
            assert p05_check(frame, 64, 6, MAX_DELTA, ID)[0] == Check.CRC_ERROR
    assert p05_check(frame, 64, 6, MAX_DELTA, ID)[0] == Check.OK


def test_every_burst_of_up_to_16_bits_behind_the_crc_is_detected() -> None:
    """In the order on the wire, most significant bit of a byte first; every pattern between its two end bits."""
    one = syndromes(64).reshape(64, 8)[:, ::-1].ravel()[16:]
    for first in range(len(one) - 15):
        patterns = np.array([one[first]])
        for k in range(1, 16):
            patterns = np.concatenate([patterns, patterns ^ one[first + k]])
        assert patterns.all()


def test_masquerade_is_detected_whatever_the_other_id() -> None:
    for payload, others in ((bytes(4), range(0x10000)), (bytes(range(64)), range(0, 0x10000, 101))):
        frame = protected(3, payload)
        crc = p05_crc(frame, len(frame), ID)
        assert {other for other in others if p05_crc(frame, len(frame), other) == crc} <= {ID}
        assert p05_check(frame, len(frame), 2, MAX_DELTA, ID ^ 0x100) == (Check.CRC_ERROR, 2)


def test_bytes_beyond_the_length_do_not_count() -> None:
    longer = np.concatenate([protected(1, bytes(12)), np.array([9, 9, 9], dtype=np.uint8)])
    assert p05_check(longer, 12, 0, MAX_DELTA, ID) == (Check.OK, 1)
    assert p05_check(longer, 13, 0, MAX_DELTA, ID) == (Check.CRC_ERROR, 0)


def judge(counters: list[int]) -> list[Check]:
    last, verdicts = NO_COUNTER, []
    for counter in counters:
        code, last = p05_check(protected(counter), 8, last, MAX_DELTA, ID)
        verdicts.append(Check(code))
    return verdicts


def test_a_good_stream_is_good_around_the_clock() -> None:
    assert judge([*range(250, 256), *range(256), *range(5)]) == [Check.INITIAL, *[Check.OK] * 266]


@pytest.mark.parametrize("last", [0, 1, 15, 127, 252, 253, 254, 255])
def test_every_step_of_the_counter(last: int) -> None:
    expected = [Check.REPEATED, Check.OK, *[Check.OK_SOME_LOST] * (MAX_DELTA - 1)]
    expected += [Check.WRONG_SEQUENCE] * (256 - len(expected))
    for delta in range(256):
        frame = protected((last + delta) % 256)
        reference = last if delta == 0 else (last + delta) % 256
        assert p05_check(frame, 8, last, MAX_DELTA, ID) == (expected[delta], reference)


def test_repetition_and_swapped_frames_are_refused_and_the_stream_recovers() -> None:
    assert judge([1, 2, 2, 2, 3])[2:] == [Check.REPEATED, Check.REPEATED, Check.OK]
    assert judge([1, 2, 4, 3, 4, 5])[3:] == [Check.WRONG_SEQUENCE, Check.OK, Check.OK]
    assert judge([1, 2, 90, 91])[2:] == [Check.WRONG_SEQUENCE, Check.OK]


def test_a_crc_error_does_not_move_the_counter() -> None:
    frame = protected(9)
    frame[1] ^= 0x80
    assert p05_check(frame, 8, 8, MAX_DELTA, ID) == (Check.CRC_ERROR, 8)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((1, PROFILE5), "0 given"),
        ((1, PROFILE5, (1, 2)), '2 given, e2e = "profile5" needs 1'),
        ((1, PROFILE5, (0x10000,)), "65536 is not a 16-bit number"),
        ((1, PROFILE5, (-1,)), "-1"),
        ((1, "none", (255,)), "1 given"),
        ((1, "profile4", (1,)), '"profile2", "profile5", "none"'),
    ],
)
def test_bad_protection_is_refused_by_name(arguments: tuple, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        MessageProtection(*arguments)


def test_what_a_good_protection_is() -> None:
    for data_id in (0, 0xFF, 0x100, 0xFFFF):
        assert MessageProtection(1, PROFILE5, (data_id,)).data_ids == (data_id,)
