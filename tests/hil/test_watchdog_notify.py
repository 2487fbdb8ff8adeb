"""The keep-alive of the service manager, heard by a real datagram socket: only while cycles go on."""

import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from telemetry_rig import FakeRig

from servohil.hil.watchdog_notify import WatchdogNotify

READY = b"READY=1\nSTATUS=the loop runs\nWATCHDOG=1"
ALIVE = b"WATCHDOG=1"


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(20.0)
        yield listener


def heard(listener: socket.socket) -> list[bytes]:
    """What waits in the socket."""
    listener.setblocking(False)
    words = []
    try:
        while True:
            words.append(listener.recv(4096))
    except BlockingIOError:
        return words


def test_ready_with_the_first_cycle_then_alive_while_it_advances(manager: socket.socket) -> None:
    notify = WatchdogNotify({"NOTIFY_SOCKET": manager.getsockname()})
    said = []
    for cycle in (-1, -1, 0, 0, 100, 100, 100, 101):
        notify.beat(cycle)
        said.append(heard(manager))
    assert said == [[], [], [READY], [], [ALIVE], [], [], [ALIVE]]
    notify.close()
    notify.close()
    notify.beat(102)
    assert heard(manager) == []


def test_an_abstract_address() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        name = f"servohil-test-{os.getpid()}"
        listener.bind(f"\0{name}")
        WatchdogNotify({"NOTIFY_SOCKET": f"@{name}"}).beat(0)
        assert heard(listener) == [READY]


@pytest.mark.parametrize(
    "address", ["", "relative", "vsock:2:1234", "/nowhere/at/all", "/" + "x" * 200, "@" + "x" * 200]
)
def test_without_a_manager_it_costs_nothing_and_breaks_nothing(address: str) -> None:
    notify = WatchdogNotify({"NOTIFY_SOCKET": address})
    for cycle in range(3):
        notify.beat(cycle)
    WatchdogNotify({}).beat(0)


def test_ready_is_said_again_until_it_is_heard(tmp_path: Path) -> None:
    path = str(tmp_path / "late")
    notify = WatchdogNotify({"NOTIFY_SOCKET": path})
    notify.beat(0)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as late:
        late.bind(path)
        notify.beat(5)
        assert heard(late) == [READY]


def test_a_manager_that_does_not_read_makes_nobody_wait(manager: socket.socket) -> None:
    notify = WatchdogNotify({"NOTIFY_SOCKET": manager.getsockname()})
    start = time.monotonic()
    for cycle in range(3000):
        notify.beat(cycle)
    assert time.monotonic() - start < 5.0
    assert 0 < len(heard(manager)) < 3000


@pytest.mark.processes
def test_a_controller_that_hangs_is_no_longer_vouched_for(
    manager: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Real controller stand-in, real telemetry process: READY, keep-alives, SIGSTOP, silence, SIGCONT, keep-alives."""
    monkeypatch.setenv("NOTIFY_SOCKET", manager.getsockname())
    with FakeRig(tmp_path) as rig:
        rig.ready()
        assert manager.recv(4096) == READY
        assert [manager.recv(4096) for _ in range(3)] == [ALIVE] * 3
        os.kill(rig.controller.pid, signal.SIGSTOP)
        manager.settimeout(1.5)
        # What was under way when it stopped, and no more.
        with pytest.raises(TimeoutError):
            for _ in range(5):
                manager.recv(4096)
        os.kill(rig.controller.pid, signal.SIGCONT)
        manager.settimeout(20.0)
        assert [manager.recv(4096) for _ in range(3)] == [ALIVE] * 3
