"""Layout and life of the shared-memory file between the controller and the telemetry process.

One page of words (positions, counters, handshake, the command slots), then the data region. Every word has one writer.
A word is a single aligned 8-byte store or load; x86 keeps stores in order and loads in order (TSO), so a position that
is stored after its payload can never be seen before it. A weaker memory model would need fences here.
"""

import contextlib
import mmap
import os
import tempfile
from pathlib import Path
from typing import Final

MAGIC: Final = int.from_bytes(b"SVHILRNG", "little")
VERSION: Final = 1
PAGE: Final = 4096
ALIGN: Final = 16

# Word indices. 0-15 set at creation or attach; 16-31 written by the controller; 32-47 written by telemetry.
W_MAGIC, W_VERSION, W_CAPACITY, W_SNAPSHOT_BYTES = 0, 1, 2, 3
W_WRITER_PID, W_WRITER_START, W_READER_PID, W_READER_START = 4, 5, 6, 7
W_WRITE, W_DROPPED, W_HEARTBEAT, W_MONOTONIC_ORIGIN, W_UNIX_ORIGIN = 16, 17, 18, 19, 20
W_CHECKPOINT_SERVED, W_STOP, W_COMMAND_READ = 21, 22, 23
W_READ, W_READY, W_CHECKPOINT_WANTED, W_COMMAND_WRITE, W_COMMAND_SEQ = 32, 33, 34, 35, 36
W_PUBLISHED, W_BATCHES, W_LOST, W_RECORDED = 37, 38, 39, 40
W_COMMANDS: Final = 64  # 16 slots of 8 words
COMMAND_SLOTS: Final = 16
ENDPOINT_AT: Final = 2048  # utf-8, zero-terminated, written by telemetry before READY
ENDPOINT_BYTES: Final = 512


class RingError(OSError):
    """The ring's file cannot be made, or is not a ring of this version."""


def shared_directory() -> Path:
    """Where the ring lives: memory (`/dev/shm`) where the system has it, else the temporary directory."""
    shm = Path("/dev/shm")
    return shm if shm.is_dir() and os.access(shm, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())


def start_ticks(pid: int) -> int | None:
    """Kernel start time of a living process in clock ticks; None for one that is gone or only waits to be reaped.

    With the pid it names one process for good: pids are used again, the pair is not.
    """
    try:
        stat = Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return None
    fields = stat[stat.rindex(b")") + 2 :].split()
    return None if fields[0] in {b"Z", b"X"} else int(fields[19])


class RingFile:
    """The mapped file: `words` (int64 view of the header page) and `data` (byte view of the data region)."""

    def __init__(self, path: Path, mapping: mmap.mmap) -> None:
        self.path = path
        self._mapping = mapping
        self._whole = memoryview(mapping)
        self.words = self._whole[:PAGE].cast("q")
        self.data = self._whole[PAGE:]
        self.data_words = self.data.cast("q")

    def close(self) -> None:
        """Drop the mapping; the file stays. Harmless when called twice."""
        for view in (self.data_words, self.words, self.data, self._whole):
            view.release()
        self._mapping.close()

    def unlink(self) -> None:
        """Remove the file's name; processes that have it mapped keep it."""
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()

    @property
    def endpoint(self) -> str:
        """Where telemetry's Zenoh session really listens, "" before it does."""
        return bytes(self._whole[ENDPOINT_AT : ENDPOINT_AT + ENDPOINT_BYTES]).split(b"\0", 1)[0].decode()

    @endpoint.setter
    def endpoint(self, text: str) -> None:
        raw = text.encode()[: ENDPOINT_BYTES - 1]
        self._whole[ENDPOINT_AT : ENDPOINT_AT + len(raw) + 1] = raw + b"\0"

    def claim(self, pid_word: int) -> None:
        """Sign as writer (W_WRITER_PID) or reader (W_READER_PID) with this process' pid and start time."""
        self.words[pid_word + 1] = start_ticks(os.getpid()) or 0
        self.words[pid_word] = os.getpid()

    def alive(self, pid_word: int) -> bool:
        """Whether the process that signed there still runs; False if nobody signed."""
        pid = self.words[pid_word]
        return pid > 0 and start_ticks(pid) == self.words[pid_word + 1]


def create_file(capacity: int, snapshot_bytes: int, directory: Path | None = None) -> RingFile:
    """A new file, mode 0600, every page allocated now: no page fault and no SIGBUS on a full file system later.

    Raises RingError naming the directory if there is no room or no right to write.
    """
    if capacity <= 0 or capacity % PAGE:
        raise RingError(f"ring capacity {capacity}: must be a positive multiple of {PAGE} bytes")
    folder = shared_directory() if directory is None else directory
    size = PAGE + capacity
    try:
        descriptor, name = tempfile.mkstemp(prefix=f"servohil-{os.getpid()}-", suffix=".ring", dir=folder)
    except OSError as error:
        raise RingError(f"cannot make a ring in {folder}: {error.strerror}") from error
    try:
        os.posix_fallocate(descriptor, 0, size)
        mapping = mmap.mmap(descriptor, size, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE)
    except OSError as error:
        Path(name).unlink()
        raise RingError(f"cannot make a ring of {size} bytes in {folder}: {error.strerror}") from error
    finally:
        os.close(descriptor)
    ring = RingFile(Path(name), mapping)
    words = ring.words
    words[W_VERSION], words[W_CAPACITY], words[W_SNAPSHOT_BYTES] = VERSION, capacity, snapshot_bytes
    words[W_HEARTBEAT] = -1
    words[W_MAGIC] = MAGIC
    return ring


def open_file(path: Path | str, snapshot_bytes: int) -> RingFile:
    """Map an existing ring. Raises RingError naming the file if it is missing, foreign, cut or of another build."""
    path = Path(path)
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
    except OSError as error:
        raise RingError(f"cannot open the ring {path}: {error.strerror}") from error
    try:
        size = os.fstat(descriptor).st_size
        if size <= PAGE:
            raise RingError(f"{path} is not a ring: {size} bytes")
        mapping = mmap.mmap(descriptor, size, flags=mmap.MAP_SHARED)
    finally:
        os.close(descriptor)
    ring = RingFile(path, mapping)
    words = ring.words
    if words[W_MAGIC] != MAGIC or words[W_CAPACITY] != size - PAGE:
        problem = "is not a ring, or was cut"
    elif words[W_VERSION] != VERSION:
        problem = f"has version {words[W_VERSION]}, this build reads {VERSION}"
    elif words[W_SNAPSHOT_BYTES] != snapshot_bytes:
        problem = f"carries snapshots of {words[W_SNAPSHOT_BYTES]} bytes, this build has {snapshot_bytes}"
    else:
        return ring
    ring.close()
    raise RingError(f"{path} {problem}")
