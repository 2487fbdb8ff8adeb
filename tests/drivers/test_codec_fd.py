"""The codec on CAN FD: signals anywhere in 64 bytes against cantools, profile 5, and frames of the wrong format."""

import tempfile
from pathlib import Path
from random import Random

import cantools
import e2e as autosar
import numpy as np
import pytest
from bench_bus import COMMAND, FD_DBC, FD_PROTECTIONS, frames_of, give
from test_codec import PLAIN
from test_dbc_fd import FD_M

from servohil.drivers.bits import occupied_bits
from servohil.drivers.codec import Codec, Kind, load_codec
from servohil.drivers.frame import FD_FRAME, FLAG_BRS, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE, FRAME

FD = FLAG_FD | FLAG_BRS
SENSORS_ID, COMMAND_ID = 0x120, 0x0A0
VALUES = np.array([9.0, 0.25, 1e7, 5e6, 1.4e7, 9e5, -3.0])  # of Actuator, in the order of its slots


def dense_layout(random: Random, length: int) -> list[tuple[int, int, bool, bool, float, float]]:
    """Signals that share their bytes with others: (start, size, big endian, signed, scale, offset) each."""
    taken, signals = set[int](), []
    for _ in range(8 * length):
        where = random.randrange(8 * length), random.randint(1, random.choice([8, 20, 53])), random.random() < 0.5
        bits = set(occupied_bits(*where))
        if not bits & taken and min(bits) >= 0 and max(bits) < 8 * length:
            taken |= bits
            scale = random.choice([1.0, 0.5, 0.01, 1e-6, -0.25, 3.0])
            signals.append((*where, random.random() < 0.5, scale, random.choice([0.0, -40.0, 1000.0, 0.125])))
    return signals


@pytest.mark.parametrize("seed", range(25))
def test_agrees_with_cantools(seed: int) -> None:
    random = Random(seed)
    length = random.choice([8, 12, 16, 20, 24, 32, 48, 64])
    data, signals = random.randbytes(length), dense_layout(random, length)
    assert len(signals) >= length // 4
    lines = "".join(
        f' SG_ s{k} : {start}|{size}@{0 if big else 1}{"-" if signed else "+"} ({scale},{offset}) [0|0] "" B\n'
        for k, (start, size, big, signed, scale, offset) in enumerate(signals)
    )
    text = f'VERSION ""\nNS_ :\nBS_:\nBU_: A B\nBO_ 256 M: {length} A\n{lines}' + FD_M
    oracle = cantools.database.load_string(text, "dbc").messages[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.dbc"
        path.write_text(text)
        reader, writer = load_codec(path, PLAIN, ["M"], []), load_codec(path, PLAIN, [], ["M"])
    expected = oracle.decode(data, decode_choices=False)
    assert give(reader, (256, data), flags=FD) == 0
    assert reader.fresh[0] == 1
    for name, value in expected.items():
        assert reader.values[reader.slot(f"M.{name}")] == pytest.approx(value, rel=1e-12, abs=1e-12)
    values = np.array([expected[path.split(".")[1]] for path in sorted(writer.paths, key=writer.slot)])
    assert writer.encode(0, values) == oracle.encode(expected, strict=False)


def ends() -> tuple[Codec, Codec]:
    """(controller, node) of the FD bench that have exchanged two frames of sensors."""
    controller = load_codec(FD_DBC, FD_PROTECTIONS, ["Actuator"], [COMMAND])
    node = load_codec(FD_DBC, FD_PROTECTIONS, [COMMAND], ["Actuator"])
    for now_ns in (1000, 2000):
        assert give(controller, sensors(node), now_ns=now_ns, flags=FD) == 0
    return controller, node


def sensors(node: Codec, position_m: float = 0.25) -> tuple[int, bytes]:
    values = VALUES.copy()
    values[1] = position_m
    return SENSORS_ID, node.encode(node.message_index("Actuator"), values)


def test_the_fd_bench_from_end_to_end() -> None:
    controller, node = ends()
    assert controller.frame == node.frame == FD_FRAME
    assert controller.fd_flags == node.fd_flags == {SENSORS_ID: FD, COMMAND_ID: FD}
    assert controller.counters[0].tolist() == [1 if kind in (Kind.OK, Kind.INITIAL) else 0 for kind in Kind]
    np.testing.assert_allclose(controller.values[: len(VALUES)], VALUES, atol=5.0, rtol=1e-6)
    _, data = sensors(node)
    assert (len(data), data[2]) == (32, 3)
    assert autosar.p05.e2e_p05_check(data, 0x5E01)
    decoded = cantools.database.load_file(FD_DBC).decode_message("Actuator", data, decode_choices=False)
    assert decoded["pressure_a"] == pytest.approx(100.0)
    assert decoded["spool"] == pytest.approx(-3.0)


def test_a_stream_is_good_over_the_wrap_of_the_counter() -> None:
    controller, node = ends()
    for k in range(600):
        assert give(controller, sensors(node, k * 1e-3), flags=FD) == 0
        assert controller.values[1] == pytest.approx(k * 1e-3)
    assert controller.counters[0, Kind.OK] == 601


BAD = {
    "first bit of the CRC": (Kind.CRC_ERROR, lambda d: bytes([d[0] ^ 1]) + d[1:], {}),
    "last bit of the CRC": (Kind.CRC_ERROR, lambda d: d[:1] + bytes([d[1] ^ 128]) + d[2:], {}),
    "last bit": (Kind.CRC_ERROR, lambda d: d[:31] + b"\x80", {}),
    "all zero": (Kind.CRC_ERROR, lambda d: bytes(32), {}),
    "shorter": (Kind.WRONG_LENGTH, lambda d: d[:24], {}),
    "classic length": (Kind.WRONG_LENGTH, lambda d: d[:8], {}),
    "longer": (Kind.WRONG_LENGTH, lambda d: d + bytes(16), {}),
    "classic": (Kind.WRONG_TYPE, lambda d: d, {"flags": 0}),
    "classic with a bit rate switch": (Kind.WRONG_TYPE, lambda d: d, {"flags": FLAG_BRS}),
    "extended": (Kind.WRONG_TYPE, lambda d: d, {"flags": FD | FLAG_EXTENDED}),
    "remote": (Kind.WRONG_TYPE, lambda d: d, {"flags": FD | FLAG_REMOTE}),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_frame_changes_nothing_but_its_counter(what: str) -> None:
    kind, damage, fields = BAD[what]
    controller, node = ends()
    values, counters = controller.values.copy(), controller.counters.copy()
    can_id, data = sensors(node, 0.5)
    assert give(controller, (can_id, damage(data)), now_ns=3000, **{"flags": FD, **fields}) == 1
    np.testing.assert_array_equal(controller.values, values)
    counters[0, kind] += 1
    np.testing.assert_array_equal(controller.counters, counters)
    assert (controller.last_good_ns[0], controller.bad_in_a_row[0]) == (2000, 1)
    assert give(controller, sensors(node, 0.5), flags=FD) == 0
    assert controller.values[1] == pytest.approx(0.5)


def test_the_sender_chooses_the_bit_rate() -> None:
    controller, node = ends()
    assert give(controller, sensors(node), flags=FLAG_FD) == 0
    assert controller.counters[0, Kind.OK] == 2


def test_repetition_loss_and_masquerade() -> None:
    controller, node = ends()
    frame = sensors(node)
    assert give(controller, frame, frame, flags=FD) == 1
    for _ in range(100):
        sensors(node)
    assert give(controller, sensors(node), flags=FD) == 1
    assert give(controller, sensors(node), flags=FD) == 0
    assert controller.counters[0, [Kind.REPEATED, Kind.WRONG_SEQUENCE]].tolist() == [1, 1]
    stranger = load_codec(FD_DBC, {**FD_PROTECTIONS, "Actuator": FD_PROTECTIONS[COMMAND]}, [COMMAND], ["Actuator"])
    for _ in range(3):
        assert give(controller, sensors(stranger), flags=FD) == 1
    assert controller.counters[0, Kind.CRC_ERROR] == 3


def test_classic_and_fd_messages_side_by_side(tmp_path: Path) -> None:
    path = tmp_path / "m.dbc"
    lines = "".join(f'BO_ {k} {n}: 8 A\n SG_ x : 0|8@1+ (1,0) [0|0] "" B\n' for k, n in ((256, "M"), (257, "C")))
    path.write_text(f'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n{lines}{FD_M}')
    codec = load_codec(path, {"M": PLAIN["M"], "C": PLAIN["M"]}, ["M", "C"], [])
    assert (codec.fd_flags, codec.frame) == ({256: FD}, FD_FRAME)
    records = (256, bytes([1] * 8)), (257, bytes([2] * 8))
    assert give(codec, *records, flags=0) == 1
    assert codec.fresh.tolist() == [0, 1]
    assert give(codec, *records, flags=FD) == 1
    assert codec.fresh.tolist() == [1, 0]
    assert codec.values.tolist() == [1.0, 2.0]


def test_records_without_room_for_the_data_are_not_read_beyond_their_end() -> None:
    """Classic records in front of an FD codec: what they lack must not be taken from the records behind them."""
    controller, node = ends()
    batch = frames_of(sensors(node), sensors(node), flags=FD, frame=FRAME)
    assert batch["dlc"].tolist() == [32, 32]
    assert controller.receive(batch, 1, 3000) == 1
    assert controller.counters[0, Kind.WRONG_LENGTH] == 1
