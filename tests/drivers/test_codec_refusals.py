"""Every kind of frame that the codec must not use, and how it recovers afterwards."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from bench_bus import (
    BENCH_DBC,
    COMMAND,
    POSITION_ID,
    PRESSURE_ID,
    PROTECTIONS,
    controller_codec,
    give,
    running,
    sensors,
)

from servohil.drivers.codec import Kind, load_codec
from servohil.drivers.frame import FLAG_ERROR, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE

BAD_FRAMES = {
    "crc, one bit": (Kind.CRC_ERROR, lambda d: d[:5] + bytes([d[5] ^ 0x10]) + d[6:], {}),
    "all zero": (Kind.CRC_ERROR, lambda d: bytes(8), {}),
    "all ones": (Kind.CRC_ERROR, lambda d: b"\xff" * 8, {}),
    "short": (Kind.WRONG_LENGTH, lambda d: d[:7], {}),
    "empty": (Kind.WRONG_LENGTH, lambda d: b"", {}),
    "long": (Kind.WRONG_LENGTH, lambda d: d, {"dlc": 12}),
    "extended": (Kind.WRONG_TYPE, lambda d: d, {"flags": FLAG_EXTENDED}),
    "remote": (Kind.WRONG_TYPE, lambda d: d, {"flags": FLAG_REMOTE}),
    "FD": (Kind.WRONG_TYPE, lambda d: d, {"flags": FLAG_FD}),
}


@pytest.mark.parametrize("what", BAD_FRAMES)
def test_a_bad_frame_changes_nothing_but_its_counter(what: str) -> None:
    kind, damage, frame = BAD_FRAMES[what]
    controller, node = running()
    values, last_good = controller.values.copy(), controller.last_good_ns.copy()
    counters = controller.counters.copy()
    (_, position), _ = sensors(node, 0.5, 2e7)
    assert give(controller, (POSITION_ID, damage(position)), now_ns=3000, **frame) == 1
    np.testing.assert_array_equal(controller.values, values)
    np.testing.assert_array_equal(controller.last_good_ns, last_good)
    counters[0, kind] += 1
    np.testing.assert_array_equal(controller.counters, counters)
    assert controller.bad_in_a_row.tolist() == [1, 0, 0, 0, 0]
    assert not controller.fresh.any()
    # The stream goes on with the next good frame, one count later.
    assert give(controller, *sensors(node, 0.5)) == 0
    assert controller.bad_in_a_row[0] == 0
    assert controller.values[0] == pytest.approx(0.5)


def test_masquerade_another_message_under_our_id() -> None:
    controller, node = running()
    _, (_, pressures) = sensors(node)
    assert give(controller, (POSITION_ID, pressures)) == 1
    assert controller.counters[0, Kind.CRC_ERROR] == 1


def test_out_of_range_refuses_the_whole_message() -> None:
    """pressure_b is impossible: pressure_a of the same frame must not get through either."""
    text = BENCH_DBC.read_text(encoding="cp1252").replace("[-2|300]", "[-300|300]")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wide.dbc"
        path.write_text(text, encoding="cp1252")
        sender = load_codec(path, PROTECTIONS, [], ["PressureAB"])
    controller = controller_codec()
    for _ in range(2):
        give(controller, (PRESSURE_ID, sender.encode(0, np.array([1e7, 1e7]))))
    assert give(controller, (PRESSURE_ID, sender.encode(0, np.array([2e7, -2.01e5])))) == 1
    assert controller.values[controller.slot("PressureAB.pressure_a")] == 1e7
    assert controller.counters[1, Kind.OUT_OF_RANGE] == 1
    # The sender is known to be there and in sequence: the next frame is plainly OK.
    assert give(controller, (PRESSURE_ID, sender.encode(0, np.array([2e7, -2e5])))) == 0
    assert controller.counters[1, Kind.OK_SOME_LOST] == 0


def test_repeated_frames_are_refused_for_as_long_as_they_come() -> None:
    controller, node = running()
    frame = sensors(node)[0]
    assert give(controller, frame, frame, frame) == 2
    assert controller.bad_in_a_row[0] == 2
    assert controller.counters[0, Kind.REPEATED] == 2


@pytest.mark.parametrize(("lost", "refused"), [(1, 0), (2, 0), (3, 1), (7, 1), (14, 1)])
def test_loss_and_recovery(lost: int, refused: int) -> None:
    controller, node = running()
    for _ in range(lost):
        sensors(node)
    assert give(controller, sensors(node)[0]) == refused
    assert controller.counters[0, Kind.WRONG_SEQUENCE if refused else Kind.OK_SOME_LOST] == 1
    assert give(controller, sensors(node)[0]) == 0
    assert controller.bad_in_a_row[0] == 0


def test_several_frames_of_a_message_in_one_batch_the_last_good_one_counts() -> None:
    controller, node = running()
    batch = [sensors(node, position)[0] for position in (0.2, 0.3, 0.4)]
    bad = (POSITION_ID, bytes(8))
    assert give(controller, *batch, bad, now_ns=9) == 1
    assert controller.values[0] == pytest.approx(0.4)
    assert controller.fresh[0] == 1
    assert controller.bad_in_a_row[0] == 1


def test_a_second_commander_is_noticed() -> None:
    controller, other = controller_codec(), controller_codec()
    index = controller.message_index(COMMAND)
    assert give(controller, (0x0A0, other.encode(index, np.array([1.0, 15])))) == 1
    assert controller.counters[index, Kind.OWN_ID] == 1
    assert np.isnan(controller.values[controller.slots(index)]).all()


def test_foreign_and_error_frames_are_counted_apart() -> None:
    controller, _ = running()
    assert give(controller, (0x7FF, bytes(8)), (0x0A1, b"")) == 0
    assert controller.counters[-1, Kind.FOREIGN] == 2
    assert give(controller, (0x40, bytes(8)), (POSITION_ID, bytes(8)), flags=FLAG_ERROR) == 0
    assert controller.counters[-1, Kind.ERROR_FRAME] == 2
    assert controller.counters[-1, Kind.BUS_OFF] == 1
    assert controller.counters[:-1].sum() == 4
