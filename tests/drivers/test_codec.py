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
from bench_bus import (
    BENCH_DBC,
    COMMAND,
    PRESSURE_ID,
    SENSOR_MESSAGES,
    controller_codec,
    frames_of,
    give,
    node_codec,
    running,
    sensors,
)
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from servohil.drivers import codec_kernels
from servohil.drivers.bits import occupied_bits
from servohil.drivers.codec import NEVER_NS, Kind, MessageProtection, load_codec
from servohil.drivers.frame import FRAME

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
