"""What `hil doctor` looks at: one frozen record of facts about this machine, gathered without judging them.

Every probe leaves the machine as it was: scheduling and memory locks are tried in a child process, sockets and files
are closed and removed at once, nothing is ever sent on a network.
"""

import errno
import importlib.util
import json
import os
import platform
import resource
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Final

from packaging.requirements import Requirement

from servohil.hil.doctor_can import CanLink, can_link
from servohil.hil.realtime_setup import governors

DISTRIBUTION: Final = "servohil"
IFF_UP: Final = 0x1
ARPHRD_CAN: Final = "280"
MULTICAST_GROUP: Final = "239.74.163.2"  # python-can's default for udp_multicast
CHILD_TIMEOUT_S: Final = 20.0
# Runs in a bare interpreter. The anonymous mapping stands for the controller's address space; MCL_ONFAULT (4) lets the
# kernel check it against RLIMIT_MEMLOCK without filling it.
PERMISSIONS_PROBE: Final = """
import ctypes, json, mmap, os, sys
found = {}
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(sys.argv[1])))
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    found["fifo"] = None
except OSError as error:
    found["fifo"] = error.strerror
space = mmap.mmap(-1, int(sys.argv[2]))
libc = ctypes.CDLL(None, use_errno=True)
found["mlockall"] = None if libc.mlockall(7) == 0 else os.strerror(ctypes.get_errno())
print(json.dumps(found))
"""
CONTROLLER_ADDRESS_SPACE_BYTES: Final = 256 << 20


@dataclass(frozen=True)
class Needs:
    """What the checks are held against; the defaults are those of the bench."""

    interface: str = "auto"
    channel: str = "vcan0"
    priority: int = 50
    listen: str = "tcp/127.0.0.1:7447"
    recording_directory: str = "runs"
    rotate_bytes: int = 256_000_000


@dataclass(frozen=True)
class Machine:
    """Facts about a machine. An `..._error` is None where the thing worked, else the system's words."""

    python: tuple[int, int, int]
    wrong_distributions: tuple[str, ...]  # "numpy 1.26 (needs >=2.2)", "zenoh missing"
    asammdf_importable: bool
    can_socket_error: str | None
    channel_state: str  # "up", "down", "absent", "not CAN"
    can_link: CanLink | None  # None where the channel is no CAN interface
    multicast_error: str | None
    local_bus_error: str | None
    fifo_error: str | None
    mlockall_error: str | None
    memlock_limit_bytes: int | None  # None: unlimited
    cores: int
    governors: tuple[str, ...]  # distinct ones; empty where the kernel scales no frequency
    kernel: str
    kernel_realtime: bool
    isolated: str  # processors that the scheduler leaves alone, as "3" or "2-3"; empty: none
    numba_cache_error: str | None
    numba_cache_entries: int
    port_error: str | None
    free_bytes: int
    shm_error: str | None


def _why(error: OSError) -> str:
    return error.strerror or str(error)


def wrong_distributions(distribution: str = DISTRIBUTION) -> tuple[str, ...]:
    """Requirements of an installed distribution that this environment does not meet, in words."""
    wrong = []
    for line in requires(distribution) or []:
        requirement = Requirement(line)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            wrong.append(f"{requirement.name} missing")
            continue
        if not requirement.specifier.contains(found, prereleases=True):
            wrong.append(f"{requirement.name} {found} (needs {requirement.specifier})")
    return tuple(wrong)


def can_socket_error() -> str | None:
    """Open and close a raw CAN socket. None: the kernel has CAN."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return _why(error)
    return None


def channel_state(channel: str, class_net: Path = Path("/sys/class/net")) -> str:
    """ "up", "down", "absent" or "not CAN", as the kernel shows the network interface of this name."""
    folder = class_net / channel
    if not channel or "/" in channel or not folder.is_dir():
        return "absent"
    if (folder / "type").read_text().strip() != ARPHRD_CAN:
        return "not CAN"
    return "up" if int((folder / "flags").read_text(), 16) & IFF_UP else "down"


def multicast_error(group: str = MULTICAST_GROUP) -> str | None:
    """Join the multicast group and ask the routing table for a way to it; a datagram connect sends nothing."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            membership = socket.inet_aton(group) + struct.pack("@I", socket.INADDR_ANY)
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            probe.connect((group, 9))
    except OSError as error:
        return _why(error)
    return None


def local_bus_error() -> str | None:
    """Pass one frame's worth of bytes between two Unix datagram sockets, as the embedded bus does."""
    try:
        with (
            tempfile.TemporaryDirectory(prefix="servohil-") as folder,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
        ):
            receiver.bind(f"{folder}/probe")
            receiver.settimeout(1.0)
            sender.sendto(b"0123456789abcdef", f"{folder}/probe")
            return None if receiver.recv(64) == b"0123456789abcdef" else "the datagram came back changed"
    except OSError as error:
        return _why(error)


def permissions(priority: int) -> tuple[str | None, str | None]:
    """Try SCHED_FIFO and mlockall in a child process: (fifo_error, mlockall_error)."""
    arguments = (str(priority), str(CONTROLLER_ADDRESS_SPACE_BYTES))
    command = [sys.executable, "-I", "-S", "-c", PERMISSIONS_PROBE, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=CHILD_TIMEOUT_S, check=True)
        found = json.loads(done.stdout)
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        why = f"the probe process failed: {type(error).__name__}"
        return why, why
    return found["fifo"], found["mlockall"]


def numba_cache(folder: Path) -> tuple[str | None, int]:
    """(why nothing can be written there or None, number of compiled functions cached there)."""
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    error = None
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as failure:
        error = _why(failure)
    return error, sum(1 for _ in folder.rglob("*.nbi"))


def port_error(listen: str) -> str | None:
    """Bind the end point "tcp/HOST:PORT" and let it go. Other transports than tcp are not looked at."""
    transport, _, rest = listen.partition("/")
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    if transport != "tcp":
        return None
    if not (host and port.isascii() and port.isdigit() and int(port) <= 65535):
        return "not of the form tcp/HOST:PORT"
    try:
        info = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        with socket.socket(info[0][0], socket.SOCK_STREAM) as probe:
            probe.setsockopt(
                socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
            )  # the router sets it too: TIME_WAIT is no obstacle
            probe.bind(info[0][4])
            probe.listen(1)
    except OSError as error:
        return "already in use" if error.errno == errno.EADDRINUSE else _why(error)
    return None


def free_bytes(directory: Path) -> int:
    """Space for an ordinary user on the file system that holds `directory`, existing or yet to be made."""
    existing = directory.resolve()
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    return shutil.disk_usage(existing).free


def shm_error(folder: str = "/dev/shm") -> str | None:
    """Write a page of shared memory and remove it."""
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(4096))
            file.flush()
    except OSError as error:
        return _why(error)
    return None


def isolated(path: Path = Path("/sys/devices/system/cpu/isolated")) -> str:
    """The processors isolated on the kernel's command line; empty for none."""
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def _kernel_realtime() -> bool:
    flag = Path("/sys/kernel/realtime")
    return (flag.exists() and flag.read_text().strip() == "1") or "PREEMPT_RT" in platform.version()


def probe(needs: Needs) -> Machine:
    """Gather all facts; takes about 0.1 s."""
    fifo, mlockall = permissions(needs.priority)
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    cache_error, cache_entries = numba_cache(Path(os.environ["NUMBA_CACHE_DIR"]))
    return Machine(
        python=sys.version_info[:3],
        wrong_distributions=wrong_distributions(),
        asammdf_importable=importlib.util.find_spec("asammdf") is not None,
        can_socket_error=can_socket_error(),
        channel_state=channel_state(needs.channel),
        can_link=can_link(needs.channel) if channel_state(needs.channel) in {"up", "down"} else None,
        multicast_error=multicast_error(needs.channel if needs.interface == "udp_multicast" else MULTICAST_GROUP),
        local_bus_error=local_bus_error(),
        fifo_error=fifo,
        mlockall_error=mlockall,
        memlock_limit_bytes=None if limit == resource.RLIM_INFINITY else limit,
        cores=len(os.sched_getaffinity(0)),
        governors=governors(),
        kernel=platform.release(),
        kernel_realtime=_kernel_realtime(),
        isolated=isolated(),
        numba_cache_error=cache_error,
        numba_cache_entries=cache_entries,
        port_error=port_error(needs.listen),
        free_bytes=free_bytes(Path(needs.recording_directory)),
        shm_error=shm_error(),
    )
