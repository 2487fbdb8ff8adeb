"""The embedded bus when nodes come, go, stall and die."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from servohil.drivers import local_mesh
from servohil.drivers.frame import FRAME
from servohil.drivers.local_mesh import Mesh, buses_folder, live_channels
from servohil.drivers.local_port import LocalPort
from servohil.drivers.port import BadBusOption, BusUnavailable

DEADLINE_S = 60.0
# Joins, sends three frames, says so, and waits to be killed.
PEER = """
import sys
from servohil.drivers.local_mesh import Mesh
mesh = Mesh("bench")
for k in range(3):
    mesh.send_frame(0x100 + k, 1, 0, bytes([k]))
print(mesh.node_count, flush=True)
sys.stdin.read()
"""


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def ids(mesh: Mesh, room: int = 256) -> list[int]:
    frames = np.zeros(room, dtype=FRAME)
    return frames["id"][: mesh.drain_into(frames)].tolist()


def started_peer() -> subprocess.Popen:
    peer = subprocess.Popen([sys.executable, "-c", PEER], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert peer.stdout is not None
    peer.stdout.readline()
    return peer


def test_kill_9_of_a_peer_leaves_nothing_behind() -> None:
    first, second = Mesh("bench"), Mesh("bench")
    peer = started_peer()
    assert first.node_count == second.node_count == 2
    os.kill(peer.pid, signal.SIGKILL)
    peer.wait()
    # What it sent in time is still there, for each of us.
    assert ids(first) == ids(second) == [0x100, 0x101, 0x102]
    # We go on without noticing ...
    for k in range(50):
        first.send_frame(k, 0, 0, b"")
        second.send_frame(0x200 + k, 0, 0, b"")
    assert ids(second) == list(range(50))
    assert ids(first) == list(range(0x200, 0x232))
    assert first.node_count == second.node_count == 1
    assert first.dropped == second.dropped == 0
    # ... and whoever joins next clears up its socket.
    stale = set((buses_folder() / "bench").glob(f"{peer.pid}-*.sock"))
    assert len(stale) == 1
    third = Mesh("bench")
    assert third.node_count == 2
    assert not stale & set((buses_folder() / "bench").iterdir())
    for mesh in (first, second, third):
        mesh.close()


def test_a_peer_that_returns_is_a_new_node() -> None:
    mesh = Mesh("bench")
    for _ in range(2):
        peer = started_peer()
        assert ids(mesh) == [0x100, 0x101, 0x102]
        peer.kill()
        peer.wait()
        until(lambda: ids(mesh) == [] and mesh.node_count == 0)
    mesh.close()


def test_a_stalled_node_delays_nobody() -> None:
    sender, stalled, reader = Mesh("bench"), Mesh("bench"), Mesh("bench")
    received = 0
    for k in range(3000):
        sender.send_frame(k % 0x7FF, 8, 0, bytes(8))
        received += len(ids(reader))
    assert received == 3000
    assert sender.dropped > 1000
    got = 0
    while batch := ids(stalled):
        got += len(batch)
    assert got + sender.dropped == 3000
    assert got >= 256  # a whole batch fits
    # It reads again, and hears again.
    sender.send_frame(0x123, 0, 0, b"")
    assert ids(stalled) == [0x123]
    for mesh in (sender, stalled, reader):
        mesh.close()


def test_joining_at_once_connects_each_pair_once() -> None:
    count = 12
    barrier = threading.Barrier(count)
    meshes: list[Mesh] = []

    def join() -> None:
        barrier.wait()
        meshes.append(Mesh("bench"))

    threads = [threading.Thread(target=join) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [mesh.node_count for mesh in meshes] == [count - 1] * count
    for k, mesh in enumerate(meshes):
        mesh.send_frame(k, 0, 0, b"")
    for k, mesh in enumerate(meshes):
        assert sorted(ids(mesh)) == [other for other in range(count) if other != k]
        assert ids(mesh) == []
    for mesh in meshes:
        mesh.close()


def test_a_babbling_node_does_not_starve_another() -> None:
    babbler, quiet, reader = Mesh("bench"), Mesh("bench"), Mesh("bench")
    for _ in range(400):
        babbler.send_frame(0x001, 0, 0, b"")
    quiet.send_frame(0x7FF, 0, 0, b"")
    heard: list[int] = []
    for _ in range(2):
        heard += ids(reader, room=64)
    assert 0x7FF in heard
    for mesh in (babbler, quiet, reader):
        mesh.close()


def test_one_drain_reads_a_bounded_number_of_frames_that_are_not_for_us() -> None:
    sender, reader = Mesh("bench"), Mesh("bench")
    for _ in range(100):
        sender.send_frame(0x001, 0, 0, b"")
    sender.send_frame(0x002, 0, 0, b"")
    frames = np.zeros(4, dtype=FRAME)
    drains = [reader.drain_into(frames, np.array([0x002])) for _ in range(10)]
    assert sum(drains) == 1
    assert drains[0] == 0
    sender.close()
    reader.close()


def test_a_frame_keeps_its_flags_and_gets_an_age() -> None:
    sender, reader = Mesh("bench"), Mesh("bench")
    before = time.monotonic_ns()
    sender.send_frame(0x1FFFFFFF, 3, 7, b"abc")
    frames = np.zeros(1, dtype=FRAME)
    assert reader.drain_into(frames) == 1
    frame = frames[0]
    assert (frame["id"], frame["dlc"], frame["flags"], frame["data"].tobytes()) == (0x1FFFFFFF, 3, 7, b"abc\0\0\0\0\0")
    assert 0 < frame["age_ns"] <= time.monotonic_ns() - before
    sender.close()
    reader.close()


def test_buses_do_not_hear_each_other() -> None:
    one, other = Mesh("one"), Mesh("other")
    one.send_frame(1, 0, 0, b"")
    assert ids(other) == []
    assert live_channels() == ["one", "other"]
    one.close()
    other.close()


def test_waiting_ends_when_a_frame_comes() -> None:
    sender, reader = Mesh("bench"), Mesh("bench")
    assert reader.wait(0) or ids(reader) == []  # somebody has joined
    assert not reader.wait(0)
    sender.send_frame(1, 0, 0, b"")
    assert reader.wait(DEADLINE_S)
    sender.close()
    reader.close()


@pytest.mark.parametrize("channel", ["", ".", "..", "a/b", "../x", "-x", "x" * 33, "a b", "kanal\n", "ä"])
def test_channel_names_are_file_names(channel: str) -> None:
    with pytest.raises(BadBusOption, match="1 to 32 letters"):
        Mesh(channel)


def test_a_path_that_is_too_long_for_a_unix_socket(bus_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = bus_root / ("d" * 60)
    deep.mkdir()
    monkeypatch.setattr(local_mesh.tempfile, "tempdir", str(deep))
    with pytest.raises(BusUnavailable, match=r"1\d\d bytes.*107.*TMPDIR"):
        Mesh("x" * 32)


@pytest.mark.parametrize("which", ["base", "channel"])
def test_a_folder_that_others_can_enter_is_refused(which: str) -> None:
    Mesh("bench").close()
    folder = buses_folder() if which == "base" else buses_folder() / "bench"
    folder.chmod(0o755)
    with pytest.raises(BusUnavailable, match=rf"{folder}: must be .* mode 0700; .*0755"):
        Mesh("bench")


def test_a_link_in_place_of_the_folder_is_refused(bus_root: Path) -> None:
    elsewhere = bus_root / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    buses_folder().symlink_to(elsewhere)
    with pytest.raises(BusUnavailable, match="must be a folder"):
        Mesh("bench")


def test_the_bus_is_private_to_the_user() -> None:
    mesh = Mesh("bench")
    for folder in (buses_folder(), buses_folder() / "bench"):
        assert folder.stat().st_mode & 0o777 == 0o700
    mesh.close()


def test_a_join_that_never_ends_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_mesh, "JOIN_TIMEOUT_S", 0.05)
    Mesh("bench").close()
    with (
        local_mesh._locked(buses_folder() / "bench" / "lock"),
        pytest.raises(BusUnavailable, match=r"locked for 0\.05 s"),
    ):
        Mesh("bench")


def test_a_node_leaves_no_socket_behind() -> None:
    mesh = Mesh("bench")
    mesh.close()
    mesh.close()
    assert [path.name for path in (buses_folder() / "bench").iterdir()] == ["lock"]


def test_the_port_counts_what_a_stalled_listener_lost() -> None:
    port, stalled = LocalPort("bench", None), Mesh("bench")
    assert all(port.send(0x100, bytes(8)) for _ in range(2000))
    assert port.health.sent == 2000
    assert port.health.dropped > 500
    assert port.health.send_failed == 0
    port.close()
    stalled.close()
