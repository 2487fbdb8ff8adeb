"""Exports are read back by other libraries than those that wrote them, and compared with what was recorded."""

import csv
import os
import subprocess
from itertools import pairwise
from pathlib import Path

import can
import numpy as np
import pytest
from bench_rig import hil
from click.testing import CliRunner
from fake_controller import N_FRAMES, PERIOD_NS, made_up, made_up_checkpoint, made_up_inputs
from pyarrow import parquet
from recorded_run import RecordedRun

from servohil.drivers.frame import FD_FRAME, FLAG_BRS, FLAG_FD
from servohil.hil.cli import main
from servohil.hil.inputs import InputsBuffer, parse
from servohil.hil.recording import export_mdf
from servohil.hil.recording.columns import Block
from servohil.hil.recording.export_can import write_can
from servohil.hil.recording.layout import About
from servohil.hil.recording.writer import RecordingWriter
from servohil.hil.snapshot import FIELDS, SNAPSHOT, SNAPSHOT_VERSION

ORIGIN_NS = 1_700_000_000_000_000_000  # 2023-11-14T22:13:20 UTC
N = 300


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """N made-up cycles, 7 missing before cycle 200, in two files."""
    path = tmp_path / "r.mcap"
    writer = RecordingWriter(path, About("fake", "", "", {"seed": "7"}), unix_origin_ns=ORIGIN_NS, rotate_bytes=100)
    writer.checkpoint(made_up_checkpoint(0))
    for begin in range(0, N, 100):
        if begin == 200:
            writer.gap(7)
        cycles = range(begin, begin + 100)
        writer.add_cycles(b"".join(made_up(k).tobytes() for k in cycles), [made_up_inputs(k) for k in cycles])
        if begin == 100:
            writer.tick(10**9)
            writer.checkpoint(made_up_checkpoint(200))
    writer.close()
    assert (tmp_path / "r-001.mcap").exists()
    return path


def log(*arguments: object, code: int = 0) -> str:
    """`hil log` with `arguments`: what it says."""
    done = CliRunner().invoke(main, ["log", *map(str, arguments)])
    assert done.exit_code == code, done.output
    assert "Traceback" not in done.output
    return done.output


def test_csv_has_every_signal_with_unit_and_every_digit(recording: Path) -> None:
    said = log("export", recording, "--to", "csv")
    assert "300 cycles" in said and "7 cycles are missing" in said
    with recording.with_suffix(".csv").open(newline="") as stream:
        head, *rows = csv.reader(stream)
    assert head == ["time_s [s]", "utc", *(f"{name} [{unit}]" for name, _, unit, _ in FIELDS)]
    assert len(rows) == N
    for k in (0, 1, 17, 250):
        expected = made_up(k)[0].tolist()
        assert float(rows[k][0]) == pytest.approx(k * 1e-3, abs=1e-12)
        assert rows[k][1] == f"2023-11-14T22:13:20.{k * PERIOD_NS:09d}Z"
        assert [float(text or "nan") for text in rows[k][2:]] == pytest.approx(expected, rel=0, abs=0, nan_ok=True)


def test_parquet_has_the_same_with_units_in_its_metadata(recording: Path) -> None:
    log("export", recording, "--to", "parquet", "--output", recording.parent / "x.parquet")
    table = parquet.read_table(recording.parent / "x.parquet")
    assert table.num_rows == N and table.schema.metadata[b"seed"] == b"7"
    expected = np.concatenate([made_up(k) for k in range(N)])
    for name, _, unit, meaning in FIELDS:
        assert table.schema.field(name).metadata == {b"unit": unit.encode(), b"meaning": meaning.encode()}
        assert table.column(name).to_numpy().tobytes() == np.ascontiguousarray(expected[name]).tobytes(), name
    assert table.column("time_s").to_numpy() == pytest.approx(np.arange(N) * 1e-3, abs=1e-12)
    assert table.column("utc").cast("int64").to_numpy().tolist() == [ORIGIN_NS + k * PERIOD_NS for k in range(N)]


READERS = {"blf": can.BLFReader, "asc": can.ASCReader, "candump": can.CanutilsLogReader}


@pytest.mark.parametrize("kind", READERS)
def test_bus_traffic_comes_back_through_the_public_readers(recording: Path, kind: str) -> None:
    out = recording.parent / f"x{'.log' if kind == 'candump' else '.' + kind}"
    assert f"{N * N_FRAMES} frames received" in log("export", recording, "--to", kind, "--output", out)
    with READERS[kind](str(out)) as reader:
        messages = list(reader)
    assert len(messages) == N * N_FRAMES
    start = messages[0].timestamp
    for k, message in enumerate(messages):
        cycle = k // N_FRAMES
        assert (message.arbitration_id, message.is_rx, message.is_extended_id) == (0x100 + k % N_FRAMES, True, False)
        assert message.timestamp - start == pytest.approx(cycle * 1e-3, abs=2e-6)
        assert bytes(message.data) == b"", "made-up frames have length 0"
    if kind == "candump":
        assert start == pytest.approx(ORIGIN_NS * 1e-9, abs=1e-3)


def test_frames_of_can_fd_keep_their_data_and_their_kind(tmp_path: Path) -> None:
    inputs = InputsBuffer(3, FD_FRAME)
    data = bytes(range(24))
    inputs.frames[0] = (0x120, 24, FLAG_FD | FLAG_BRS, 0, 500_000, np.frombuffer(data.ljust(64, b"\0"), np.uint8))
    inputs.frames[1] = (0x121, 8, 0, 0, 0, np.arange(64, dtype=np.uint8))
    inputs.header["t_ns"] = 1_000_000_000
    block = Block(np.zeros(1, SNAPSHOT), [bytes(inputs.payload(2))], 0)
    write_can([block], tmp_path / "r.log", "candump", lambda *_: (0xA0, data[:12], FLAG_FD))
    first, second, command = can.CanutilsLogReader(tmp_path / "r.log")
    assert (first.is_fd, first.bitrate_switch, bytes(first.data), first.timestamp) == (True, True, data, 0.9995)
    assert (second.is_fd, bytes(second.data)) == (False, bytes(range(8)))
    assert (command.is_fd, command.bitrate_switch, bytes(command.data)) == (True, False, data[:12])


def test_commands_are_rebuilt_as_they_were_sent(run: RecordedRun, tmp_path: Path) -> None:
    """The node had understood every one of them: its own decoding of what is rebuilt gives the recorded voltage."""
    path = run.record(tmp_path / "r.mcap", 600)
    assert "received and sent" in log("export", path, "--to", "candump", "--commands")
    with can.CanutilsLogReader(str(tmp_path / "r.log")) as reader:
        messages = list(reader)
    sent = [message for message in messages if not message.is_rx]
    assert len(sent) == 600 and len({message.arbitration_id for message in sent}) == 1
    assert len(messages) == 600 + sum(len(parse(inputs).frames) for _, inputs in run.cycles[:600])
    counters = [message.data[1] & 0x0F for message in sent]
    assert all((b - a) % 16 == 1 for a, b in pairwise(counters)), "the counter of profile 2"


def test_a_cut_recording_is_exported_as_far_as_it_goes(recording: Path) -> None:
    second = recording.with_name("r-001.mcap")
    whole = second.read_bytes()
    second.write_bytes(whole[: len(whole) // 2])
    said = log("export", recording, "--to", "csv")
    assert "r-001.mcap was cut off" in said and "200 cycles" in said
    assert "cut off" in log("info", recording, code=1)
    assert "complete" in log("repair", second)
    log("info", second.with_name("r-001-repaired.mcap"))
    second.write_bytes(whole[:-100])
    assert "cut off" in log("info", recording, code=1), "the index is missing: other tools would refuse it"
    assert "exists" in log("export", recording, "--to", "csv", code=1)


def test_foreign_and_future_recordings_say_what_is_allowed(recording: Path, tmp_path: Path) -> None:
    foreign = tmp_path / "foreign.mcap"
    foreign.write_bytes(b"MDF     4.10")
    for words in (("info", foreign), ("repair", foreign), ("export", foreign, "--to", "csv")):
        assert "foreign.mcap is not a recording" in log(*words, code=1)
    now, named = str(SNAPSHOT_VERSION).encode(), b"snapshot_version\x01\0\0\0"
    recording.write_bytes(recording.read_bytes().replace(named + now, named + b"9"))
    said = log("export", recording, "--to", "csv", code=1)
    assert "snapshot version 9" in said and f"this build has version {SNAPSHOT_VERSION}" in said
    assert not list(tmp_path.glob("*.csv")), "nothing half made is left"


def test_mf4_says_how_to_get_what_writes_it(recording: Path, tmp_path: Path) -> None:
    said = log("export", recording, "--to", "mf4", "--mdf-python", tmp_path / "python", code=1)
    assert "no such Python" in said and "make mdf" in said
    stranger = tmp_path / "stranger"
    stranger.write_text("#!/bin/sh\nexit 1\n")
    stranger.chmod(0o755)
    assert "cannot import asammdf" in log("export", recording, "--to", "mf4", "--mdf-python", stranger, code=1)
    assert log("export", recording, "--to", "csv", "--mdf-python", stranger, code=2)


@pytest.mark.skipif(not os.access(export_mdf.MDF_PYTHON, os.X_OK), reason="no .venv-mdf: make mdf")
def test_mf4_has_every_signal(recording: Path) -> None:
    done = hil("log", "export", recording, "--to", "mf4")
    assert done.returncode == 0, done.stderr
    asked = f"""
from asammdf import MDF
mdf = MDF({str(recording.with_suffix(".mf4"))!r})
for name in ("nis", "est_position_m", "cycle"):
    signal = mdf.get(name)
    print(name, len(signal), signal.unit, repr(float(signal.samples[17])), round(float(signal.timestamps[17]), 9))
print(mdf.header.start_time.timestamp())
"""
    told = subprocess.run([export_mdf.MDF_PYTHON, "-I", "-c", asked], capture_output=True, text=True, check=True)
    row = made_up(17)[0]
    assert told.stdout.splitlines() == [
        *(f"{name} 300 {unit} {float(row[name])!r} 0.017" for name, unit in (("nis", "1"), ("est_position_m", "m"))),
        "cycle 300 1 17.0 0.017",
        str(ORIGIN_NS / 1e9),
    ]
