"""One controller, one node per bus."""

import os
import re
import secrets
import subprocess
import sys

import pytest

from servohil.drivers.bus_lock import BusLock
from servohil.drivers.port import BusBusy, BusUnavailable

HOLDER = """
import sys
from servohil.drivers.bus_lock import BusLock
lock = BusLock(sys.argv[1], "controller")
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def bus_name() -> str:
    return f"test:{secrets.token_hex(8)}"


def test_the_second_start_names_the_first_process(bus_name: str) -> None:
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, bus_name], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert holder.stdout is not None
    assert holder.stdout.readline() == b"held\n"
    for _ in range(3):
        with pytest.raises(BusBusy, match=rf'"{re.escape(bus_name)}" already has a controller: process {holder.pid}\.'):
            BusLock(bus_name, "controller")
    holder.kill()
    holder.wait()
    BusLock(bus_name, "controller").release()


def test_each_role_and_each_bus_once(bus_name: str) -> None:
    with (
        BusLock(bus_name, "controller"),
        BusLock(bus_name, "node"),
        BusLock(bus_name + "1", "controller"),
        pytest.raises(BusBusy, match=f"process {os.getpid()}"),
    ):
        BusLock(bus_name, "node")
    BusLock(bus_name, "node").release()


def test_releasing_twice(bus_name: str) -> None:
    lock = BusLock(bus_name, "node")
    lock.release()
    lock.release()


def test_unknown_role(bus_name: str) -> None:
    with pytest.raises(ValueError, match=r'"viewer".*controller, node'):
        BusLock(bus_name, "viewer")  # type: ignore[arg-type]


def test_a_name_that_is_too_long() -> None:
    with pytest.raises(BusUnavailable, match="too long"):
        BusLock("x" * 200, "node")
