"""Frames of every kind, damaged and invented, into the codec: nothing bad changes anything but a count."""

from pathlib import Path
from random import Random

import e2e as autosar
import numpy as np
import pytest

from servohil.drivers.codec import Kind, load_codec
from servohil.drivers.dbc import MessageTable
from servohil.drivers.e2e import MessageProtection, data_ids
from servohil.drivers.frame import FLAG_ERROR, FRAME, FRAME_STRUCT

DBC = Path(__file__).parents[2] / "rigs" / "bench.dbc"
SENSORS = ("Position", "PressureAB", "PressureSupplyTank", "ValveStatus")
COMMAND = "ValveCommand"
IDS = {name: data_ids(17 + k) for k, name in enumerate((*SENSORS, COMMAND))}
PROTECTIONS = {name: MessageProtection(1_000_000, "profile2", ids) for name, ids in IDS.items()}
LONG = pytest.param(1_000_000, marks=pytest.mark.nightly)


class Bus:
    """What a disturbed bus carries: what the node sends, some of it damaged or repeated, and pure noise."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        self.node = node = load_codec(DBC, PROTECTIONS, [COMMAND], SENSORS)
        self.last = FRAME_STRUCT.pack(0, 0, 0, 0, 0, bytes(8))
        self.span = [
            (node.minimum[list(node.slots(k))], np.ptp([node.minimum, node.maximum], axis=0)[list(node.slots(k))])
            for k in range(5)
        ]

    def frame(self) -> bytes:
        """The next FRAME."""
        random = self.random
        way = random.randrange(8)
        if way == 0:
            return random.randbytes(FRAME.itemsize)
        if way == 1:
            return self.last
        message = random.randrange(1, 5)
        low, span = self.span[message]
        data = self.node.encode(message, low + random.random() * span)
        can_id, dlc, flags, age_ns = self.node.messages[message].frame_id, 8, 0, random.randrange(10**6)
        if way == 2:
            data = bytes([random.randrange(256), (data[1] & 15) + 1 & 15]) + random.randbytes(6)
        elif way == 3:
            flipped = int.from_bytes(data, "little") ^ 1 << random.randrange(64)
            data = flipped.to_bytes(8, "little")
        elif way == 4:
            can_id = random.choice([0x0A0, 0x120, 0x121, 0x122, 0x123, 0x7FF])
        elif way == 5:
            dlc, flags = random.choice([(random.randrange(17), 0), (8, random.randrange(16))])
            age_ns = random.choice([0, -(2**63), 2**63 - 1])
        self.last = FRAME_STRUCT.pack(can_id, dlc, flags, 0, age_ns, data)
        return self.last


def expected_good(message: MessageTable, dlc: int, flags: int, data: bytes, last_counter: int) -> bool:
    """Whether a receiver may use this frame, by the other implementation of profile 2 and the DBC's ranges."""
    if flags or dlc != 8 or not autosar.p02.e2e_p02_check(data, bytes(IDS[message.name])):
        return False
    if last_counter < 0 or not 1 <= ((data[1] & 15) - last_counter) % 16 <= 3:
        return False
    word = int.from_bytes(data, "little")
    for signal in message.signals:
        raw = word >> signal.start & (1 << signal.length) - 1
        raw -= 1 << signal.length if signal.signed and raw >> signal.length - 1 else 0
        if not signal.raw_min <= raw <= signal.raw_max:
            return False
    return True


@pytest.mark.parametrize("n", [5_000, LONG])
def test_a_bad_frame_changes_nothing_but_counts(n: int) -> None:
    bus = Bus(7)
    codec = load_codec(DBC, PROTECTIONS, SENSORS, [COMMAND])
    assert not any(signal.big_endian for message in codec.messages for signal in message.signals)
    m, values, words = len(codec.messages), codec._f8, codec._i8
    places = {message.frame_id: k for k, message in enumerate(codec.messages)}
    record = bytearray(FRAME.itemsize)
    frames = np.frombuffer(record, FRAME)
    used = 0
    for _ in range(n):
        record[:] = bus.frame()
        can_id, dlc, flags, _, _, data = FRAME_STRUCT.unpack(record)
        at = m if flags & FLAG_ERROR else places.get(can_id, m)
        good = at < codec.n_receive and expected_good(codec.messages[at], dlc, flags, data, int(words[3 * m + at]))
        codec.fresh[:] = 0
        values_before, words_before = values.tobytes(), words.copy()
        rejected = codec.receive(frames, 1, 2_000_000)
        assert bool(codec.fresh.any()) is good, bytes(record)
        used += good
        changed = set(np.flatnonzero(words != words_before).tolist())
        counted = {k for k in changed if k >= 4 * m}
        assert {(k - 4 * m) // len(Kind) for k in counted} == {at}
        assert (words[list(counted)] == words_before[list(counted)] + 1).all()
        assert len(counted) == 1 or counted == {
            4 * m + at * len(Kind) + kind for kind in (Kind.ERROR_FRAME, Kind.BUS_OFF)
        }
        if not good:
            assert values.tobytes() == values_before, bytes(record)
            # Beside the count: the row of bad ones, and the counter that the next frame is compared with.
            assert changed - counted <= {2 * m + at, 3 * m + at} if at < codec.n_receive else changed == counted
            assert words[2 * m + at] == words_before[2 * m + at] + rejected if at < codec.n_receive else True
    assert 0.1 * n < used < 0.7 * n
    kinds = codec.counters.sum(axis=0)
    assert all(kinds[kind] for kind in Kind), kinds  # every kind was met
