"""Logs of a bus, from whoever, through the controller in shadow mode; and files that are no logs, or evil ones."""

import struct
import zlib
from pathlib import Path

import can
import numpy as np
import pytest
from click.testing import CliRunner
from recorded_run import RecordedRun

from servohil.drivers.frame import FD_FRAME, FLAG_BRS, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE, FRAME
from servohil.hil.cli import main
from servohil.hil.recording.can_log import CanLog
from servohil.hil.recording.reader import Cycle, Recording
from servohil.hil.replay_can import fill
from servohil.hil.snapshot import SNAPSHOT

N = 1500


def hil(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(main, [*map(str, arguments)])
    assert done.exit_code == code, done.output
    return done.output


@pytest.fixture(scope="module")
def logs(run: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same traffic, commands too, as r.log, r.asc and r.blf."""
    folder = tmp_path_factory.mktemp("logs")
    path = run.record(folder / "r.mcap", N, unix_origin_ns=1_700_000_000_000_000_000)
    for kind in ("candump", "asc", "blf"):
        hil("log", "export", path, "--to", kind, "--commands")
    return folder


def shadow(log: Path, run: RecordedRun, *words: object) -> tuple[str, np.ndarray]:
    """What `hil replay --can` says, and the Snapshots of the recording that it makes."""
    said = hil("replay", "--can", log, "--rig", run.rig, *words)
    path = Path(next(line for line in said.splitlines() if line.startswith("recording ")).split()[1])
    rows = [item.snapshot for item in Recording(path).items() if isinstance(item, Cycle)]
    assert "every Snapshot bit for bit" in hil("replay", path)
    return said, np.frombuffer(b"".join(rows), SNAPSHOT)


@pytest.mark.parametrize("kind", ["log", "asc", "blf"])
def test_the_shadow_estimates_what_the_controller_did(logs: Path, run: RecordedRun, kind: str) -> None:
    """Its own recording, exported with its commands: a watcher of the bus must come to the same estimates."""
    said, rows = shadow(logs / f"r.{kind}", run)
    assert "make no sense" not in said and "were refused" not in said
    own = np.frombuffer(b"".join(snapshot for snapshot, _ in run.cycles[:N]), SNAPSHOT)
    assert len(rows) == N and rows["rx_frames"].tolist() == [n + 1 for n in own["rx_frames"]], "the command as well"
    np.testing.assert_array_equal(rows["position_m"], own["position_m"])
    for name in ("est_position_m", "est_velocity_mps", "est_pressure_a_pa", "est_pressure_b_pa"):
        np.testing.assert_allclose(rows[name][300:], own[name][300:], rtol=1e-9, atol=1e-9)
    assert (rows["command_v"] == 0.0).all(), "a shadow commands nothing"


def test_lines_that_make_no_sense_are_counted_and_passed_over(logs: Path, run: RecordedRun, tmp_path: Path) -> None:
    lines = (logs / "r.log").read_text().splitlines(keepends=True)[:2000]
    lines[700:700] = [
        "nonsense\n",
        "(1.0) can0 12#3#4\n",
        "(x) can0 123#00\n",
        "(1.0) can0 ZZZ#00\n",
        "A" * 9000 + "\n",
    ]
    (tmp_path / "x.log").write_text("".join(lines))
    said, rows = shadow(tmp_path / "x.log", run)
    assert "5 lines or messages make no sense" in said
    assert len(rows) > 350


def test_malformed_lines_of_an_asc_file_cost_only_themselves(logs: Path, tmp_path: Path) -> None:
    lines = (logs / "r.asc").read_text().splitlines(keepends=True)[:300]
    (tmp_path / "good.asc").write_text("".join(lines))
    expected = [(m.arbitration_id, m.timestamp, bytes(m.data)) for m in CanLog(tmp_path / "good.asc")]
    at = next(k for k, line in enumerate(lines) if " Rx " in line) + 20
    lines[at:at] = [" 0.1 1  12G  Rx   d 8 00 00 00 00 00 00 00 00\n", " 0.1 1  123  Rx   d q 00\n"]
    (tmp_path / "x.asc").write_text("".join(lines))
    log = CanLog(tmp_path / "x.asc")
    assert [(m.arbitration_id, m.timestamp, bytes(m.data)) for m in log] == expected and len(expected) > 250
    assert log.malformed == 2


def test_a_foreign_dbc_and_foreign_ids(logs: Path, run: RecordedRun, tmp_path: Path) -> None:
    text = run.rig.with_name("bench.dbc").read_text()
    other = tmp_path / "other.dbc"
    other.write_text(text.replace("BO_ 289 ", "BO_ 1001 "))
    assert other.read_text() != text
    said = hil("replay", "--can", logs / "r.log", "--rig", run.rig, "--dbc", other)
    assert f"{4 * N} frames taken, {N} of other ids" in said
    strange = tmp_path / "strange.log"
    strange.write_text("(1.0) can0 7FF#00\n(1.1) can0 7FE#00\n")
    assert "no frame has an id that" in hil("replay", "--can", strange, "--rig", run.rig, code=1)


def test_a_leap_in_time_ends_the_log(logs: Path, run: RecordedRun, tmp_path: Path) -> None:
    lines = (logs / "r.log").read_text().splitlines(keepends=True)[:1000]
    lines += ["(1.0) can0 120#0201000009000000\n", "(9999999999.0) can0 120#0201000009000000\n"]
    (tmp_path / "x.log").write_text("".join(lines))
    said = hil("replay", "--can", tmp_path / "x.log", "--rig", run.rig)
    assert "stopped at 0." in said and "1 frames are stamped before" in said


def container(data: bytes, size: int | None = None, method: int = 2) -> bytes:
    packed = zlib.compress(data) if method == 2 else data
    body = struct.pack("<H6xL4x", method, len(data)) + packed
    size = len(body) + 16 if size is None else size
    return struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, 10) + body + bytes(size % 4)


HEADER = struct.pack("<4sL", b"LOGG", 144) + bytes(136)
STANDING = struct.pack("<4sHHLL", b"LOBJ", 32, 9, 0, 1) + bytes(40)  # an object of no length: its next one is itself


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("content", "said"),
    [
        (HEADER + container(bytes(80 << 20)), "more than 67108864 bytes"),
        (HEADER + container(STANDING), "an object of 0 bytes"),
        (HEADER + container(STANDING, method=0), "an object of 0 bytes"),
        (HEADER + struct.pack("<4sHHLL", b"LOBJ", 16, 1, 0xFFFFFFFF, 10), "an object of 4294967295 bytes"),
        (HEADER + struct.pack("<4sHHLL", b"LOBJ", 16, 1, 3, 10), "an object of 3 bytes"),
        (struct.pack("<4sL", b"LOGG", 5), "a header of 5 bytes"),
    ],
)
def test_a_blf_file_cannot_fill_the_memory_or_hold_us_up(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "x.blf"
    path.write_bytes(content)
    log = CanLog(path)
    assert list(log) == []
    assert log.problem is not None and said in log.problem


def test_other_files_are_refused_by_name(run: RecordedRun, tmp_path: Path) -> None:
    for name, content, said in (("x.txt", b"", ".log, .asc, .blf"), ("x.blf", b"PK", "not a BLF file")):
        (tmp_path / name).write_bytes(content)
        assert said in hil("replay", "--can", tmp_path / name, "--rig", run.rig, code=1)
    assert "No such file" in hil("replay", "--can", tmp_path / "absent.log", "--rig", run.rig, code=1)


@pytest.mark.parametrize("frame", [FRAME, FD_FRAME])
def test_a_message_becomes_a_frame(frame: np.dtype[np.void]) -> None:
    frames = np.zeros(2, frame)
    room = frame["data"].shape[0]
    remote = can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, is_remote_frame=True, dlc=3)
    fill(frames, 1, remote, 77)
    told = [int(frames[name][1]) for name in ("id", "dlc", "flags", "age_ns")]
    assert told == [0x1ABCDEF0, 3, FLAG_EXTENDED | FLAG_REMOTE, 77]
    data = bytes(range(64))
    fill(frames, 0, can.Message(arbitration_id=1, is_extended_id=False, is_fd=True, bitrate_switch=True, data=data), 0)
    assert frames["flags"][0] == FLAG_FD | FLAG_BRS
    assert frames["dlc"][0] == 64 and bytes(frames["data"][0]) == data[:room]
