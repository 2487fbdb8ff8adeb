"""The codec against cantools, against its other end, and against every kind of bad frame."""

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import cantools
import numpy as np
import pytest
from bench_bus import BENCH_DBC, COMMAND, PROTECTIONS, SENSOR_MESSAGES, controller_codec, frames_of, node_codec
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from servohil.drivers import codec_kernels
from servohil.drivers.bits import occupied_bits
from servohil.drivers.codec import NEVER_NS, Codec, Kind, MessageProtection, load_codec
from servohil.drivers.frame import FLAG_ERROR, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE, FRAME

POSITION_ID = 0x121
PRESSURE_ID = 0x122
PLAIN = {"M": MessageProtection(1_000_000, "none")}
# (start, length, big endian, signed, scale, offset)
SIGNAL = st.tuples(
    st.integers(0, 63),
    st.integers(1, 40),
    st.booleans(),
    st.booleans(),
    st.sampled_from([1.0, 0.5, 0.01, 1e-6, -0.25, 3.0]),
    st.sampled_from([0.0, -40.0, 1000.0, 0.125]),
)


@settings(max_examples=100, deadline=None)
@given(st.lists(SIGNAL, min_size=1, max_size=4), st.binary(min_size=8, max_size=8))
def test_agrees_with_cantools(signals: list[tuple], data: bytes) -> None:
    bits = [bit for signal in signals for bit in occupied_bits(*signal[:3])]
    assume(len(bits) == len(set(bits)) and min(bits) >= 0 and max(bits) < 64)
    lines = "".join(
        f' SG_ s{k} : {start}|{length}@{0 if big else 1}{"-" if signed else "+"} ({scale},{offset}) [0|0] "" B\n'
        for k, (start, length, big, signed, scale, offset) in enumerate(signals)
    )
    text = f'VERSION ""\nNS_ :\nBS_:\nBU_: A B\nBO_ 256 M: 8 A\n{lines}'
    oracle = cantools.database.load_string(text, "dbc").messages[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.dbc"
        path.write_text(text)
        reader, writer = load_codec(path, PLAIN, ["M"], []), load_codec(path, PLAIN, [], ["M"])
    expected = oracle.decode(data)
    reader.receive(frames_of((256, data)), 1, 0)
    assert reader.fresh[0] == 1
    for name, value in expected.items():
        assert reader.values[reader.slot(f"M.{name}")] == pytest.approx(value, rel=1e-12, abs=1e-12)
    values = np.array([expected[path.split(".")[1]] for path in sorted(writer.paths, key=writer.slot)])
    assert writer.encode(0, values) == oracle.encode(expected, strict=False)


def test_the_bench_frames_agree_with_cantools() -> None:
    database = cantools.database.load_file(BENCH_DBC)
    node = node_codec()
    data = node.encode(node.message_index("PressureAB"), np.array([123.45e5, -0.5e5]))
    decoded = database.decode_message(PRESSURE_ID, data)
    assert decoded["pressure_a"] == pytest.approx(123.45)
    assert decoded["pressure_b"] == pytest.approx(-0.5)
    assert (decoded["counter"], decoded["crc"]) == (1, data[0])


def sensors(node: Codec, position_m: float = 0.1, pressure_pa: float = 1e7) -> list[tuple[int, bytes]]:
    return [
        (POSITION_ID, node.encode(node.message_index("Position"), np.array([position_m]))),
        (PRESSURE_ID, node.encode(node.message_index("PressureAB"), np.array([pressure_pa, pressure_pa / 2]))),
    ]


def give(codec: Codec, *records: tuple[int, bytes], now_ns: int = 0, **frame: int) -> int:
    return codec.receive(frames_of(*records, **frame), len(records), now_ns)


def running() -> tuple[Codec, Codec]:
    """A controller and a node that have exchanged two sets of sensor frames."""
    controller, node = controller_codec(), node_codec()
    for now_ns in (1000, 2000):
        give(controller, *sensors(node), now_ns=now_ns)
    return controller, node


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-0.05, 0.65), st.floats(-2e5, 3e7), st.floats(-12, 12), st.integers(0, 15)), min_size=2
    )
)
def test_one_end_understands_the_other(stream: list[tuple[float, float, float, int]]) -> None:
    controller, node = controller_codec(), node_codec()
    status = node.message_index("ValveStatus")
    for k, (position, pressure, spool, word) in enumerate(stream):
        records = [*sensors(node, position, pressure), (0x120, node.encode(status, np.array([spool, word])))]
        assert give(controller, *records) == 0
        if k:
            values = controller.values
            assert abs(values[controller.slot("Position.position")] - position) <= 0.5000001e-6
            assert abs(values[controller.slot("PressureAB.pressure_a")] - pressure) <= 500.0001
            assert abs(values[controller.slot("ValveStatus.spool")] - spool) <= 0.5000001e-3
            assert values[controller.slot("ValveStatus.status_word")] == word
            assert controller.fresh.tolist() == [1, 1, 0, 1, 0]


def test_before_the_first_frame() -> None:
    codec = controller_codec()
    assert np.isnan(codec.values).all()
    assert set(codec.last_good_ns) == {NEVER_NS}
    assert codec.receive(frames_of(), 0, 5) == 0
    assert 5 - NEVER_NS > 2**61  # an age that no limit allows, and no overflow


def test_the_first_protected_frame_is_counted_but_not_used() -> None:
    controller, node = controller_codec(), node_codec()
    assert give(controller, *sensors(node)) == 0
    assert controller.counters[:, Kind.INITIAL].tolist() == [1, 1, 0, 0, 0, 0]
    assert not controller.fresh.any()
    assert np.isnan(controller.values).all()
    assert not controller.bad_in_a_row.any()


def test_an_unprotected_message_is_used_at_once(tmp_path: Path) -> None:
    path = tmp_path / "m.dbc"
    path.write_text('BO_ 256 M: 2 A\n SG_ x : 0|16@1+ (1,0) [0|1000] "mm" B\n')
    codec = load_codec(path, PLAIN, ["M"], [])
    assert give(codec, (256, bytes([7, 0]))) == 0
    assert codec.values[0] == 0.007
    assert give(codec, (256, bytes([7, 0]))) == 0  # the same again: there is no counter to object
    assert give(codec, (256, bytes([233, 3]))) == 1
    assert codec.counters[0].tolist() == [2 if k == Kind.OK else k == Kind.OUT_OF_RANGE for k in Kind]


def test_ages_are_counted_from_arrival() -> None:
    controller, node = running()
    give(controller, *sensors(node), now_ns=5_000_000, age_ns=300_000)
    assert controller.last_good_ns[0] == 4_700_000
    give(controller, *sensors(node), now_ns=6_000_000, age_ns=-5)
    assert controller.last_good_ns[0] == 6_000_000


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


def test_every_frame_is_counted_once() -> None:
    rng = np.random.default_rng(7)
    controller, node = running()
    controller.reset()
    total = 0
    for _ in range(300):
        frames = frames_of(*sensors(node), *sensors(node), (0x0A0, bytes(8)), (0x300, bytes(3)))
        raw = frames.view(np.uint8)
        for at in rng.integers(0, len(raw), size=rng.integers(0, 4)):
            raw[at] ^= 1 << rng.integers(8)
        controller.receive(frames, len(frames), 0)
        total += len(frames)
    assert controller.counters.sum() - controller.counters[-1, Kind.BUS_OFF] == total


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 10.001, -10.001, 1e300])
def test_what_cannot_be_sent_is_refused_and_leaves_no_gap(bad: float) -> None:
    controller, node = controller_codec(), node_codec()
    index = controller.message_index(COMMAND)
    give(node, (0x0A0, controller.encode(index, np.array([0.0, 1]))))
    with pytest.raises(ValueError, match=r"ValveCommand\.command = .*-10 to 10"):
        controller.encode(index, np.array([bad, 1]))
    with pytest.raises(ValueError, match=r"ValveCommand\.control_word = 16"):
        controller.encode(index, np.array([0.0, 16]))
    assert give(node, (0x0A0, controller.encode(index, np.array([-10.0, 9])))) == 0
    assert node.counters[0, Kind.OK] == 1
    assert node.values.tolist()[:2] == [-10.0, 9.0]
    assert controller.values[controller.slots(index)].tolist() == [-10.0, 9.0]


def test_the_wrong_number_of_values_is_refused() -> None:
    controller = controller_codec()
    with pytest.raises(ValueError, match="ValveCommand: 1 values given, takes 2"):
        controller.encode(controller.message_index(COMMAND), np.array([1.0]))


def test_limits_are_what_can_be_sent() -> None:
    node = node_codec()
    position = node.slot("Position.position")
    assert (node.minimum[position], node.maximum[position]) == pytest.approx((-0.05, 0.65))
    for limit in (node.minimum[position], node.maximum[position]):
        node.encode(node.message_index("Position"), np.array([limit]))


def test_a_byte_copy_of_the_state_restores_everything() -> None:
    controller, node = running()
    n_f8, n_i8 = controller.state_size
    f8, i8 = np.full(n_f8 + 2, 5.0), np.full(n_i8 + 2, 5, dtype=np.int64)
    other = controller_codec()
    f8[1:-1], i8[1:-1] = controller._f8, controller._i8
    other.attach(f8[1:-1], i8[1:-1])
    index = controller.message_index(COMMAND)
    for _ in range(20):
        batch = frames_of(*sensors(node))
        assert controller.receive(batch, 2, 3) == other.receive(batch, 2, 3) == 0
        assert controller.encode(index, np.array([1, 2])) == other.encode(index, np.array([1, 2]))
    assert f8[1:-1].tobytes() == controller._f8.tobytes()
    assert i8[1:-1].tobytes() == controller._i8.tobytes()
    assert f8[0] == f8[-1] == i8[0] == i8[-1] == 5
    other.reset()
    assert i8[1:-1].tobytes() == controller_codec()._i8.tobytes()


def test_wrong_state_arrays_are_refused() -> None:
    codec = controller_codec()
    n_f8, n_i8 = codec.state_size
    with pytest.raises(ValueError, match="f8"):
        codec.attach(np.zeros(n_f8 + 1), np.zeros(n_i8, dtype=np.int64))
    with pytest.raises(ValueError, match="i8"):
        codec.attach(np.zeros(n_f8), np.zeros(n_i8))


def compiled_variants() -> list[int]:
    return [len(getattr(f, "signatures", ())) for f in (codec_kernels.receive_frames, codec_kernels.encode_message)]


def test_nothing_compiles_in_the_loop() -> None:
    controller, node = running()
    compiled = compiled_variants()
    batch = np.frombuffer(frames_of(*sensors(node)).tobytes(), dtype=FRAME)  # read-only, as from a recording
    controller.receive(batch, 2, 0)
    controller.receive(np.zeros(256, dtype=FRAME)[:64], 3, np.int64(5))
    controller.encode(controller.message_index(COMMAND), np.array([1, 2, 3, 4])[::2])
    assert compiled_variants() == compiled


def stream_digest() -> str:
    """Everything that a long, damaged exchange leaves behind."""
    rng = np.random.default_rng(3)
    controller, node = controller_codec(), node_codec()
    digest = hashlib.sha256()
    index = controller.message_index(COMMAND)
    for k in range(400):
        frames = frames_of(*sensors(node, rng.uniform(-0.05, 0.65), rng.uniform(-2e5, 3e7)), age_ns=k)
        if k % 3 == 0:
            frames.view(np.uint8)[rng.integers(48)] ^= 1 << rng.integers(8)
        rejected = controller.receive(frames, rng.integers(0, 3), k * 1_000_000)
        command = controller.encode(index, np.array([rng.uniform(-10, 10), k % 16]))
        give(node, (0x0A0, command))
        digest.update(bytes([rejected]) + command + controller._f8.tobytes() + controller._i8.tobytes())
        digest.update(node._f8.tobytes() + node._i8.tobytes())
    return digest.hexdigest()


def test_compiled_equals_plain_python() -> None:
    code = "import sys; sys.path.insert(0, sys.argv[1]); import test_codec; print(test_codec.stream_digest())"
    digests = [
        subprocess.run(
            [sys.executable, "-c", code, str(Path(__file__).parent)],
            env=os.environ | {"NUMBA_DISABLE_JIT": disabled},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for disabled in ("0", "1")
    ]
    assert digests[0] == digests[1] != ""


def test_slots_run_through_the_messages_in_order() -> None:
    codec = controller_codec()
    assert [codec.message_index(name) for name in (*SENSOR_MESSAGES, COMMAND)] == list(range(5))
    assert [slot for k in range(5) for slot in codec.slots(k)] == list(range(9))
    assert codec.slot("PressureAB.pressure_b") == codec.slots(1)[1]
    assert codec.receive_ids == (0x121, 0x122, 0x123, 0x120)
    assert codec.transmit_ids == (0x0A0,)
