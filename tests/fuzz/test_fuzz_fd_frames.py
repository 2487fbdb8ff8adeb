"""CAN FD frames of every kind, damaged and invented, into the codec: nothing bad changes anything but a count."""

from pathlib import Path
from random import Random

import cantools
import e2e as autosar
import numpy as np
import pytest

from servohil.drivers.codec import Kind, load_codec
from servohil.drivers.e2e import MessageProtection
from servohil.drivers.frame import FD_FRAME, FD_FRAME_STRUCT, FLAG_BRS, FLAG_ERROR, FLAG_FD

DBC = Path(__file__).parents[2] / "rigs" / "bench-fd.dbc"
DATA_ID, LENGTH, CAN_ID = 0x5E01, 32, 0x120
PROTECTIONS = {
    "Actuator": MessageProtection(1_000_000, "profile5", (DATA_ID,)),
    "ValveCommand": MessageProtection(1_000_000, "profile5", (0x5E02,)),
}
FD = FLAG_FD | FLAG_BRS
LONG = pytest.param(200_000, marks=pytest.mark.nightly)


def disturbed(random: Random, data: bytes, last: bytes) -> bytes:
    """The node's next frame as a FD_FRAME record, or something in its place."""
    can_id, length, flags = CAN_ID, LENGTH, FD
    way = random.randrange(8)
    if way == 0:
        return random.randbytes(FD_FRAME.itemsize)
    if way == 1:
        return last
    if way == 2:  # as many wrong bits as one likes
        wrong = sum(1 << random.randrange(8 * LENGTH) for _ in range(random.randrange(1, 6)))
        data = (int.from_bytes(data, "little") ^ wrong).to_bytes(LENGTH, "little")
    elif way == 3:  # invented, and well protected
        invented = bytearray(random.randbytes(LENGTH))
        invented[2] = data[2]
        autosar.p05.e2e_p05_protect(invented, DATA_ID, increment_counter=False)
        data = bytes(invented)
    elif way == 4:
        length = random.choice([0, 8, 24, 31, 33, 48, 64, 255])
    elif way == 5:
        flags = random.choice([0, FLAG_BRS, FLAG_FD, random.randrange(32)])
    return FD_FRAME_STRUCT.pack(can_id, length, flags, 0, random.choice([0, 10**6, -(2**63)]), data)


@pytest.mark.parametrize("n", [3_000, LONG])
def test_a_bad_frame_changes_nothing_but_counts(n: int) -> None:
    random = Random(11)
    codec = load_codec(DBC, PROTECTIONS, ["Actuator"], ["ValveCommand"])
    node = load_codec(DBC, PROTECTIONS, ["ValveCommand"], ["Actuator"])
    oracle = cantools.database.load_file(DBC).get_message_by_frame_id(CAN_ID)
    index = node.message_index("Actuator")
    at = list(node.slots(index))
    low, span = node.minimum[at], node.maximum[at] - node.minimum[at]
    record = bytearray(FD_FRAME.itemsize)
    frames = np.frombuffer(record, FD_FRAME)
    counter, used, last = -1, 0, bytes(FD_FRAME.itemsize)
    for _ in range(n):
        record[:] = last = disturbed(random, node.encode(index, low + random.random() * span), last)
        can_id, length, flags, _, _, data = FD_FRAME_STRUCT.unpack(record)
        data = data[:LENGTH]
        sound = can_id == CAN_ID and flags & ~FLAG_BRS == FLAG_FD and length == LENGTH
        sound = sound and autosar.p05.e2e_p05_check(data, DATA_ID)
        good = sound and counter >= 0 and 1 <= (data[2] - counter) % 256 <= 3
        if sound and (data[2] != counter):
            counter = data[2]
        if good:
            decoded = oracle.decode(data, decode_choices=False, scaling=True)
            good = all(s.minimum - 1e-9 <= decoded[s.name] <= s.maximum + 1e-9 for s in oracle.signals)
        before, total = codec.values.tobytes(), int(codec.counters.sum())
        codec.receive(frames, 1, 2_000_000)
        assert bool(codec.fresh.any()) is bool(good), bytes(record)
        used += good
        if good:
            slot = codec.slot("Actuator.position")
            assert codec.values[slot] == pytest.approx(decoded["position"], abs=1e-12)
        else:
            assert codec.values.tobytes() == before
        bus_off = bool(flags & FLAG_ERROR and can_id & 0x40)
        assert codec.counters.sum() - total == 1 + bus_off
    assert 0.1 * n < used < 0.7 * n
    met = codec.counters.sum(axis=0)
    expected = set(Kind) - {Kind.OWN_ID, Kind.BUS_OFF, Kind.ERROR_FRAME}
    assert all(met[kind] for kind in expected), met
