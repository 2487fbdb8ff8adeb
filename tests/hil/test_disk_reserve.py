"""A disk that runs full: the recording ends by itself, closed as it should be, and the loop goes on."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_controller import made_up, made_up_checkpoint, made_up_inputs
from telemetry_rig import FakeRig, until

from servohil.hil.recording.layout import About, DiskReserveReached
from servohil.hil.recording.reader import Cycle, Recording
from servohil.hil.recording.tools import info
from servohil.hil.recording.writer import FLUSH_NS, RecordingWriter

DISK_BYTES = 8 << 20


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system of DISK_BYTES."""
    folder.mkdir()
    try:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", folder], capture_output=True, check=False
        )
    except OSError:
        pytest.skip("no mount command")
    if done.returncode:
        pytest.skip("mounting a tmpfs is not allowed here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def test_it_ends_at_the_reserve_with_a_finished_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter(tmp_path / "r.mcap", About("fake"), reserve_bytes=1000 * 4096)
    real = os.fstatvfs(0)
    free = {"blocks": 1000}

    def statvfs(_descriptor: int) -> os.statvfs_result:
        values = list(real)
        values[1], values[4] = 4096, free["blocks"]  # f_frsize, f_bavail
        return os.statvfs_result(values)

    monkeypatch.setattr(os, "fstatvfs", statvfs)
    writer.checkpoint(made_up_checkpoint(0))
    for k in range(20):
        writer.add_cycles(made_up(k).tobytes(), [made_up_inputs(k)])
        free["blocks"] = 999 if k == 19 else 1000
        if k < 19:
            writer.tick(k * FLUSH_NS)  # exactly the reserve is enough
    with pytest.raises(DiskReserveReached, match=r"4091904 bytes free.*reserve_bytes = 4096000"):
        writer.tick(20 * FLUSH_NS)
    writer.close()  # once more does no harm
    recording = Recording(tmp_path / "r.mcap")
    found = [item for item in recording.items() if isinstance(item, Cycle)]
    assert recording.complete and found == [Cycle(made_up(k).tobytes(), made_up_inputs(k)) for k in range(20)]


@pytest.mark.processes
def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as disk:
        setup = {"recording": str(disk / "r.mcap"), "reserve_bytes": DISK_BYTES - (1 << 20)}
        with FakeRig(tmp_path, setup=setup) as rig:
            rig.ready()
            events = rig.subscribe("event/**")
            until(lambda: any("recording" in str(event.key_expr) for event in events), "the event")
            batches = rig.subscribe("state")
            until(lambda: len(batches) > 20, "batches after the end of the recording")
            os.kill(rig.controller.pid, signal.SIGINT)
            facts = rig.end()
        assert facts["code"] == 0 and facts["dropped"] == 0
        assert "reserve_bytes" in rig.result()["recording_error"]
        found = info(disk / "r.mcap")
        assert found.complete and found.problem is None
        assert 100 < found.cycles < facts["cycles"] and found.last_cycle == found.cycles - 1
        assert found.size_bytes < 3 << 20
