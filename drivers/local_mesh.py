"""The embedded bus: a mesh of Unix sockets between the processes of one user on one host.

A bus is a folder, a node on it a listening SOCK_SEQPACKET socket in that folder; every pair of nodes holds one
connection. (Datagram sockets would be simpler, but the kernel queues only net.unix.max_dgram_qlen = 10 of those.) One
record per frame: the 24 bytes of FRAME, or the 80 of FD_FRAME where the data needs them, with the sender's monotonic
clock where the receiver then puts the age.

Guaranteed: order per sender; no echo; nothing leaves the host or the user; a slow node loses frames (counted by the
sender) and delays nobody; a node that dies, even by kill -9, disappears without a trace.
Not guaranteed: order between senders, arbitration by id, the bandwidth limit of a real bus.

Nodes join one after another, under a file lock: a new node connects to all that listen and then listens itself, so
that no pair is connected twice or not at all.
"""

import contextlib
import errno
import fcntl
import os
import re
import secrets
import select
import socket
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.frame import DATA_BYTES, FD_FRAME_STRUCT, FRAME_STRUCT
from servohil.drivers.port import BadBusOption, BusUnavailable
from servohil.drivers.receive_many import AT_ONCE, NO_IDS, ReceiveMany, take_records

CHANNEL_PATTERN: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,31}")
# sun_path holds 108 bytes with the closing zero.
MAX_PATH_BYTES: Final = 107
# The kernel doubles this and charges 768 bytes or so per frame: about 550 frames, 0.1 s of a full bus. What a node has
# not read by then is too old to matter.
SEND_BUFFER_BYTES: Final = 212_992
LISTEN_BACKLOG: Final = 128
JOIN_TIMEOUT_S: Final = 5.0
# A drain reads at most this many times as many frames as it has room for; the rest were not for us.
READS_PER_ROOM: Final = 4
SUFFIX: Final = ".sock"


def buses_folder() -> Path:
    """Where this user's buses live.

    In the temp folder and not in XDG_RUNTIME_DIR: a service, a cron job and a shell of one user see different values of
    the latter, and would quietly sit on different buses.
    """
    return Path(tempfile.gettempdir()) / f"servohil-bus-{os.getuid()}"


def live_channels() -> list[str]:
    """Channels that somebody has used on this host, for discovery."""
    folder = buses_folder()
    if not folder.is_dir():
        return []
    return sorted(path.name for path in folder.iterdir() if path.is_dir())


def _private_folder(path: Path) -> None:
    """Create `path` for this user alone; raises BusUnavailable if it belongs to somebody else or is open to others."""
    with contextlib.suppress(FileExistsError):
        path.mkdir(mode=0o700)
    info = path.lstat()
    if not stat.S_ISDIR(info.st_mode) or info.st_uid != os.getuid() or stat.S_IMODE(info.st_mode) & 0o077:
        raise BusUnavailable(
            f"{path}: must be a folder of user {os.getuid()} with mode 0700; "
            f"it belongs to user {info.st_uid} and has mode {stat.S_IMODE(info.st_mode):04o}"
        )


class Mesh:
    """One node on an embedded bus.

    Raises BadBusOption for a channel name that is no file name, BusUnavailable where the folder cannot be used.
    """

    def __init__(self, channel: str) -> None:
        if not CHANNEL_PATTERN.fullmatch(channel):
            raise BadBusOption(
                f'channel "{channel}": a channel of the embedded bus is 1 to 32 letters, digits, "_", "." or "-"'
            )
        self.channel = channel
        self.dropped = 0
        self.error_frames = 0  # among those drained since the start
        self._peers: dict[int, socket.socket] = {}
        # Replaced, never changed in place: a thread may iterate while another one accepts (python-can's Notifier).
        self._senders: tuple[socket.socket, ...] = ()
        self._epoll = select.epoll()
        self._closed = False
        self._turn = 0
        self._receive = ReceiveMany()
        self._frames: NDArray[Any] | None = None
        self._out: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        try:
            self._join(buses_folder())
        except OSError:
            self.close()
            raise

    def _join(self, base: Path) -> None:
        folder = base / self.channel
        self._path = folder / f"{os.getpid()}-{secrets.token_hex(4)}{SUFFIX}"
        if len(os.fsencode(self._path)) > MAX_PATH_BYTES:
            raise BusUnavailable(
                f"{self._path}: {len(os.fsencode(self._path))} bytes, a Unix socket's path may have {MAX_PATH_BYTES}; "
                "set TMPDIR to a shorter folder or use a shorter channel name"
            )
        _private_folder(base)
        _private_folder(folder)
        with _locked(folder / "lock"):
            for path in sorted(folder.glob(f"*{SUFFIX}")):
                self._connect(path)
            self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self._listener.setblocking(False)
            # A socket inherits the buffer size of the listener it was accepted from.
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
            self._listener.bind(str(self._path))
            self._listener.listen(LISTEN_BACKLOG)
            self._epoll.register(self._listener, select.EPOLLIN)

    def _connect(self, path: Path) -> None:
        peer = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        peer.setblocking(False)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        try:
            peer.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):  # its owner is gone
            peer.close()
            path.unlink(missing_ok=True)
        except BlockingIOError as error:
            peer.close()
            raise BusUnavailable(f"{path}: this node of the bus does not answer; end process {path.stem}") from error
        else:
            self._add(peer)

    def _add(self, peer: socket.socket) -> None:
        self._peers[peer.fileno()] = peer
        self._senders = (*self._senders, peer)
        self._epoll.register(peer, select.EPOLLIN)

    def _accept_waiting(self) -> None:
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:  # nobody (more) there
                return
            peer.setblocking(False)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
            self._add(peer)

    def _stop_sending_to(self, peer: socket.socket) -> None:
        self._senders = tuple(other for other in self._senders if other is not peer)

    def _remove(self, fd: int) -> None:
        peer = self._peers.pop(fd)
        self._stop_sending_to(peer)
        self._epoll.unregister(fd)
        peer.close()

    def send_record(self, record: bytes) -> None:
        """Give one frame's record, stamped with the monotonic clock in `age_ns`, to every other node. Never blocks."""
        self._accept_waiting()
        for peer in self._senders:
            try:
                peer.send(record, socket.MSG_NOSIGNAL)
            except BlockingIOError:
                self.dropped += 1
            except OSError as error:
                if error.errno == errno.ENOBUFS:
                    self.dropped += 1
                else:  # gone; what it sent before stays readable
                    self._stop_sending_to(peer)

    def send_frame(self, can_id: int, dlc: int, flags: int, data: bytes) -> None:
        record = FRAME_STRUCT if len(data) <= DATA_BYTES else FD_FRAME_STRUCT
        self.send_record(record.pack(can_id, dlc, flags, 0, time.monotonic_ns(), data))

    def drain_into(self, frames: NDArray[Any], ids: NDArray[np.int64] = NO_IDS) -> int:
        """Fill `frames` from the front with what waits; returns how many. Never blocks.

        Only frames with one of `ids` (empty: all), and error frames. Nodes are read one after another, each time with
        another one first, and a bounded number of frames: a babbling node can neither starve the others nor hold us.
        """
        if self._closed:
            return 0
        if frames is not self._frames:  # a loop always gives the same
            self._frames, self._out = frames, frames.view(np.uint8).reshape(len(frames), frames.itemsize)
        n, room, reads_left = 0, len(frames), READS_PER_ROOM * len(frames)
        ready = self._epoll.poll(0)
        if any(fd not in self._peers for fd, _ in ready):  # somebody joins, and may have sent already
            self._accept_waiting()
            ready = [event for event in self._epoll.poll(0) if event[0] in self._peers]
        now_ns = time.monotonic_ns()
        self._turn += 1
        first = self._turn % max(len(ready), 1)
        receive = self._receive
        for fd, _ in ready[first:] + ready[:first]:
            while n < room and reads_left > 0:
                most = min(room - n, reads_left, AT_ONCE)
                try:
                    got = receive.receive(fd, most)
                except ConnectionResetError:
                    reads_left -= 1
                    continue  # it closed without reading everything of ours; its own last frames still follow
                except OSError:
                    self._remove(fd)
                    break
                taken, looked, errors = take_records(receive.records, receive.lengths, got, ids, now_ns, self._out, n)
                n += taken
                self.error_frames += errors
                reads_left -= got
                if looked < got:  # it has closed, or is none of ours
                    self._remove(fd)
                    break
                if got < most:
                    break
        return n

    def wait(self, timeout_s: float | None) -> bool:
        """Block until something can be read (or somebody joins), at most `timeout_s`; False if nothing came."""
        return bool(self._epoll.poll(timeout_s, 1))

    def fileno(self) -> int:
        """Readable when a frame waits."""
        return self._epoll.fileno()

    @property
    def node_count(self) -> int:
        """How many other nodes there are."""
        self._accept_waiting()
        return len(self._senders)

    def close(self) -> None:
        """Leave the bus. May be called twice."""
        if self._closed:
            return
        self._closed = True
        for peer in self._peers.values():
            peer.close()
        self._peers.clear()
        self._senders = ()
        self._epoll.close()
        if hasattr(self, "_listener"):
            self._listener.close()
            self._path.unlink(missing_ok=True)


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the file lock of a folder. Raises BusUnavailable if somebody holds it for JOIN_TIMEOUT_S."""
    fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        deadline = time.monotonic() + JOIN_TIMEOUT_S
        while True:
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise BusUnavailable(
                        f"{path}: locked for {JOIN_TIMEOUT_S:g} s by another process that joins this bus"
                    ) from None
                time.sleep(0.001)
        yield
    finally:
        os.close(fd)
