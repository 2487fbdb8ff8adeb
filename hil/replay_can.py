"""`hil replay --can`: a log of a real bus through the controller in shadow mode, into a normal recording.

The controller wakes up at its own rate along the log's times and is given what had arrived until then, as on the bus;
first half a period after the first frame, so that what its sender sends together is taken together.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from servohil.drivers.frame import flags_of
from servohil.hil.assemble import check
from servohil.hil.config import Rig, load_rig
from servohil.hil.config.effective import write_effective
from servohil.hil.cycle import Cycle
from servohil.hil.diagnosis_words import verdict_text
from servohil.hil.gate import DeviceState
from servohil.hil.inputs import InputsBuffer
from servohil.hil.provenance import provenance
from servohil.hil.recorded_rig import changed_rig, parse_settings
from servohil.hil.recording.can_log import CanLog, CanLogError
from servohil.hil.recording.layout import About
from servohil.hil.recording.writer import RecordingWriter

NS_PER_S: Final = 1_000_000_000
RECORDING_FILE: Final = "recording.mcap"
LONGEST_SILENCE_NS: Final = 60 * NS_PER_S  # a longer one ends the log: its times make no sense
BATCH: Final = 500


@dataclass
class Counts:
    """What the log had."""

    frames: int = 0  # handed to the controller
    foreign: int = 0  # of other ids
    sent: int = 0  # marked as sent by the logging machine, and taken like the others
    backwards: int = 0  # stamped before the frame before them; taken as if they came with it
    crowded: int = 0  # more in one cycle than its inputs hold
    stopped: str = ""


def replay_can(
    log_path: Path,
    rig: Rig,
    dbc: Path | None,
    settings: Sequence[str],
    new_folder: Callable[[], Path],
    say: Callable[[str], None],
) -> Cycle:
    """Run the controller of `rig` over the log and write its recording into a new folder; the cycle at its end.

    `dbc`: describes the log's bus instead of the rig's own. Raises CanLogError, ConfigError, DbcError, OSError.
    """
    log = CanLog(log_path)
    changes = parse_settings(settings)
    folder = new_folder()
    loaded = _effective(rig, dbc, changes, folder)
    check(loaded)
    cycle = Cycle(loaded, listen_only=True)
    counts = Counts()
    facts = {name: str(value) for name, value in provenance(config_hash=loaded.config_hash()).items()}
    about = About(
        loaded.name,
        loaded.path.read_text(encoding="utf-8"),
        loaded.dbc_path.read_text(encoding="utf-8"),
        {**facts, "listen_only": "True", "dbc_name": loaded.dbc_path.name, "can_log": log_path.name},
    )
    writer = RecordingWriter(
        folder / RECORDING_FILE, about, rotate_bytes=loaded.recording.rotate_bytes,
        reserve_bytes=loaded.recording.reserve_bytes, sync=False,
    )  # fmt: skip
    try:
        _run(cycle, _instants(log, cycle, counts), writer, counts)
    finally:
        writer.close()
    for line in _lines(log, cycle, counts, writer.cycles):
        say(line)
    if not counts.frames:
        ids = ", ".join(f"0x{can_id:x}" for can_id in cycle.codec.receive_ids)
        raise CanLogError(f"{log_path}: no frame has an id that {loaded.dbc_path.name} and the rig name: {ids}")
    say(f"recording    {folder / RECORDING_FILE}")
    return cycle


def _effective(rig: Rig, dbc: Path | None, changes: Mapping[str, Any], folder: Path) -> Rig:
    """What runs, its files in `folder`."""
    loaded = write_effective(rig, folder)
    if dbc is not None:
        loaded.dbc_path.write_bytes(dbc.read_bytes())
        loaded = load_rig(loaded.path)
    return changed_rig(loaded, changes) if changes else loaded


def _instants(log: CanLog, cycle: Cycle, counts: Counts) -> Iterator[tuple[int, int, list[tuple[int, Any]]]]:
    """(wall clock at t = 0 in ns, cycle number, [(arrival since then in ns, message)]) of each cycle of the log."""
    wanted = frozenset(cycle.codec.receive_ids)
    period = cycle.period_ns
    origin_ns, now_ns, number = 0, -period // 2, -1
    waiting: list[tuple[int, Any]] = []
    for message in log:
        stamp_ns = round(message.timestamp * NS_PER_S)
        if number < 0:
            origin_ns, number = stamp_ns + period // 2, 0
        arrival_ns = stamp_ns - origin_ns
        if arrival_ns < now_ns:
            counts.backwards += 1
            arrival_ns = now_ns
        if arrival_ns - now_ns > LONGEST_SILENCE_NS:
            silence_s = (arrival_ns - now_ns) / NS_PER_S
            counts.stopped = f"stopped at {now_ns / NS_PER_S:.3f} s: the next frame comes {silence_s:.0f} s later"
            break
        now_ns = arrival_ns
        while arrival_ns > number * period:
            yield origin_ns, number, waiting
            waiting = []
            number += 1
        if not message.is_error_frame and message.arbitration_id not in wanted:
            counts.foreign += 1
            continue
        counts.sent += not message.is_rx
        waiting.append((arrival_ns, message))
    if waiting:
        yield origin_ns, number, waiting


def _run(
    cycle: Cycle, instants: Iterator[tuple[int, int, list[tuple[int, Any]]]], writer: RecordingWriter, counts: Counts
) -> None:
    inputs = InputsBuffer(frame=cycle.codec.frame)
    header = inputs.header
    snapshots: list[bytes] = []
    payloads: list[bytes] = []
    for origin_ns, number, arrived in instants:
        if not writer.messages:
            writer.unix_origin_ns = origin_ns
        if not snapshots and writer.wants_checkpoint:
            writer.checkpoint(cycle.arena.save())
        counts.crowded += max(0, len(arrived) - len(inputs.frames))
        taken = arrived[: len(inputs.frames)]
        counts.frames += len(taken)
        t_ns = number * cycle.period_ns
        for k, (arrival_ns, message) in enumerate(taken):
            fill(inputs.frames, k, message, t_ns - arrival_ns)
        header["cycle"], header["t_ns"] = number, t_ns
        payload = inputs.payload(len(taken))
        cycle.step(header, inputs.frames)
        snapshots.append(bytes(cycle.snapshot_bytes))
        payloads.append(bytes(payload))
        if len(snapshots) == BATCH:
            _write(writer, snapshots, payloads, t_ns)
    _write(writer, snapshots, payloads, int(header["t_ns"]))


def _write(writer: RecordingWriter, snapshots: list[bytes], payloads: list[bytes], t_ns: int) -> None:
    writer.add_cycles(b"".join(snapshots), payloads)
    writer.tick(t_ns)
    snapshots.clear()
    payloads.clear()


def fill(frames: Any, at: int, message: Any, age_ns: int) -> None:
    """Write python-can's message as record `at`."""
    room = frames["data"].shape[1]
    data = bytes(message.data[:room]).ljust(room, b"\0")
    frames["id"][at], frames["dlc"][at], frames["flags"][at] = (
        message.arbitration_id,
        min(message.dlc, 255),
        flags_of(message),
    )
    frames["age_ns"][at], frames["data"][at] = age_ns, np.frombuffer(data, np.uint8)


def _lines(log: CanLog, cycle: Cycle, counts: Counts, cycles: int) -> Iterator[str]:
    row = cycle.snapshot
    if log.problem:
        yield log.problem
    period = f"{cycle.period_ns / 1e6:g} ms"
    yield f"{cycles} cycles of {period}, {counts.frames} frames taken, {counts.foreign} of other ids"
    for n, text in (
        (log.malformed, "lines or messages make no sense and were passed over"),
        (counts.sent, "of the frames taken were sent by the machine that made the log"),
        (counts.backwards, "frames are stamped before the frame before them, and were taken as if they came with it"),
        (counts.crowded, "frames found no room in their cycle"),
        (int(row["rx_rejected"]), "frames were refused (length, checksum, counter or range)"),
    ):
        if n:
            yield f"{n} {text}"
    if counts.stopped:
        yield counts.stopped
    yield f"at the end   {DeviceState(int(row['state'])).name}, {verdict_text(row)}"
