"""Recorded frames on a bus again: each once, in order, at its time; never where they pass for real."""

import os
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from recorded_run import RecordedRun

from servohil.drivers.bus_lock import BusLock
from servohil.drivers.frame import FD_FRAME, FLAG_BRS, FLAG_EXTENDED, FLAG_FD, FRAME
from servohil.drivers.local_port import LocalPort
from servohil.hil import replay_bus
from servohil.hil.cli import main
from servohil.hil.inputs import HEADER_BYTES, InputsBuffer, parse
from servohil.hil.recording.columns import Block, Reading
from servohil.hil.replay_bus import Frames, fd_flags, is_harmless, send_timed
from servohil.hil.snapshot import SNAPSHOT


def test_only_virtual_buses_are_harmless(tmp_path: Path) -> None:
    for name in ("vcan0", "slcan0", "can0"):
        (tmp_path / name).mkdir()
    for interface in ("servohil", "virtual", "udp_multicast"):
        assert is_harmless(interface, "anything", tmp_path)
    assert is_harmless("socketcan", "vcan0", tmp_path)
    for interface, channel in (
        *(("socketcan", name) for name in ("can0", "slcan0", "vcan7")),
        ("pcan", "PCAN_USBBUS1"),
    ):
        assert not is_harmless(interface, channel, tmp_path)


def test_auto_is_judged_by_what_it_becomes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_bus, "socketcan_obstacle", lambda _: None)
    assert not is_harmless("auto", "can0", tmp_path)
    monkeypatch.setattr(replay_bus, "socketcan_obstacle", lambda _: "there is none")
    assert is_harmless("auto", "can0", tmp_path)


def test_a_real_bus_is_refused_before_it_is_opened(
    run: RecordedRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = run.record(tmp_path / "r.mcap", 50)
    opened = []

    def open_port(*words: str, **_: object) -> None:
        opened.append(words)
        raise OSError("opened")

    monkeypatch.setattr(replay_bus, "open_port", open_port)
    words = ["replay", str(path), "--realtime", "--interface", "socketcan", "--channel", "can0"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 1 and not opened
    assert "--interface socketcan --channel can0: real nodes may listen there" in done.output
    assert "--yes-a-real-bus" in done.output
    CliRunner().invoke(main, [*words, "--yes-a-real-bus"])
    assert opened == [("socketcan", "can0")]


class Clocked:
    """A port that notes when each frame came."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int, bytes]] = []

    def send(self, can_id: int, data: bytes) -> bool:
        self.seen.append((time.monotonic_ns(), can_id, data))
        return True


def test_frames_are_sent_at_their_times_and_not_before() -> None:
    port = Clocked()
    frames = [(k * 20_000_000, k, bytes([k])) for k in range(10)]
    start = time.monotonic_ns()
    assert send_timed(port, iter(frames), lambda: False)[0] == 10  # type: ignore[arg-type]
    assert [(can_id, data) for _, can_id, data in port.seen] == [(k, bytes([k])) for k in range(10)]
    assert all(at - start >= due for (at, _, _), (due, _, _) in zip(port.seen, frames, strict=True))
    port.seen.clear()
    assert send_timed(port, iter([(10**12, 1, b"")]), lambda: True) == (0, 0)  # type: ignore[arg-type]


def test_what_a_port_cannot_send_is_counted(run: RecordedRun, tmp_path: Path) -> None:
    snapshot, payload = run.cycles[30]
    changed = bytearray(payload)
    frames = np.frombuffer(changed, FRAME, offset=HEADER_BYTES)
    frames["flags"][0] = FLAG_EXTENDED
    frames["age_ns"] = [500_000 - 100_000 * k for k in range(len(frames))]
    path = run._replace(cycles=[run.cycles[29], (snapshot, bytes(changed))]).record(tmp_path / "r.mcap")
    found = Frames(Reading(path))
    times = [due for due, _, _ in found]
    before = len(parse(run.cycles[29][1]).frames)
    assert found.left_out == 1 and len(times) == before + len(frames) - 1
    assert times[before:] == [1_000_000 - 500_000 + 100_000 * k for k in range(1, len(frames))]


def test_frames_of_can_fd_go_onto_the_bus_as_such() -> None:
    inputs = InputsBuffer(2, FD_FRAME)
    data = bytes(range(24))
    inputs.frames[0] = (0x120, 24, FLAG_FD | FLAG_BRS, 0, 0, np.frombuffer(data.ljust(64, b"\0"), np.uint8))
    inputs.frames[1] = (0x121, 8, 0, 0, 0, np.zeros(64, np.uint8))
    block = Block(np.zeros(1, SNAPSHOT), [bytes(inputs.payload(2))], 0)
    reading: Any = SimpleNamespace(blocks=lambda: iter([block]))
    found = Frames(reading)
    assert list(found) == [(0, 0x120, data), (0, 0x121, bytes(8))] and found.left_out == 0
    assert fd_flags(reading) == {0x120: FLAG_FD | FLAG_BRS}
    channel = f"replay-fd-{os.getpid()}"
    sender, listener = LocalPort(channel, (), fd=fd_flags(reading)), LocalPort(channel, None)
    try:
        assert send_timed(sender, iter(found), lambda: False)[0] == 2
        got = np.zeros(9, FD_FRAME)
        assert listener.drain(got) == 2
        assert got["flags"][:2].tolist() == [FLAG_FD | FLAG_BRS, 0] and got["data"][0, :24].tobytes() == data
    finally:
        sender.close()
        listener.close()


def test_a_listener_on_the_embedded_bus_gets_every_frame_in_order(run: RecordedRun, tmp_path: Path) -> None:
    path = run.record(tmp_path / "r.mcap", 30)
    channel = f"replay-{os.getpid()}"
    listener = LocalPort(channel, None)
    try:
        done = CliRunner().invoke(main, ["replay", str(path), "--realtime", "--channel", channel])
        assert done.exit_code == 0, done.output
        got = np.zeros(1000, FRAME)
        n = listener.drain(got)
        expected = np.concatenate([parse(payload).frames for _, payload in run.cycles[:30]])
        assert f"{len(expected)} frames sent" in done.output and n == len(expected) > 100
        for name in ("id", "dlc", "data"):
            assert (got[name][:n] == expected[name]).all()
        with BusLock(f"servohil:{channel}", "node"):
            done = CliRunner().invoke(main, ["replay", str(path), "--realtime", "--channel", channel])
            assert done.exit_code == 1 and "already has a node" in done.output
    finally:
        listener.close()
