"""Rig files, DBC files, tables, recordings and payloads as nobody should write them: refused by name or read, no more.

What is not one of our own errors is a defect: a person would see a traceback, and a process would end.
"""

import contextlib
import json
from pathlib import Path

import numpy as np
import pytest
from damage import NASTY, damaged_bytes, damaged_lines

from servohil.drivers.dbc import DbcError, load_messages
from servohil.drivers.e2e import MessageProtection
from servohil.hil.config import ConfigError, load_rig
from servohil.hil.inputs import InputsError, parse
from servohil.hil.reactions import ReactionsError, load_reactions
from servohil.hil.recording.layout import About, RecordingError
from servohil.hil.recording.reader import Recording
from servohil.hil.recording.tools import repair
from servohil.hil.recording.writer import RecordingWriter
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.asked import wanted_value
from servohil.hil.telemetry.setup import TelemetryError, TelemetrySetup, load_setup

ROOT = Path(__file__).parents[2]
RIG, DBC = (ROOT / "rigs" / "bench.toml").read_text(), (ROOT / "rigs" / "bench.dbc").read_text()
MESSAGES = ("Position", "PressureAB", "PressureSupplyTank", "ValveStatus", "ValveCommand")
OPEN = {name: MessageProtection(1_000_000, "none") for name in MESSAGES}


def numbers(short: int, long: int) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("n", [short, pytest.param(long, marks=pytest.mark.nightly)])


class Query:
    """As much of a Zenoh query as a value is read from."""

    class Payload(bytes):
        def to_bytes(self) -> bytes:
            return bytes(self)

    def __init__(self, payload: bytes | None, value: str | None = None) -> None:
        self.payload = None if payload is None else self.Payload(payload)
        self.parameters = {} if value is None else {"value": value}


@numbers(150, 25_000)
def test_rig_files(tmp_path: Path, n: int) -> None:
    random = np.random.default_rng(1)
    (tmp_path / "bench.dbc").write_text(DBC)
    path = tmp_path / "rig.toml"
    refused = 0
    for _ in range(n):
        path.write_bytes(damaged_lines(random, RIG).encode("utf-8", "surrogatepass"))
        try:
            load_rig(path).config_hash()
        except ConfigError as error:
            refused += 1
            assert all(line.startswith(str(path)) for line in str(error).splitlines() if line), str(error)
    assert refused > n / 3


@numbers(100, 25_000)
def test_dbc_files(tmp_path: Path, n: int) -> None:
    random = np.random.default_rng(2)
    path = tmp_path / "bench.dbc"
    refused = 0
    for _ in range(n):
        path.write_bytes(damaged_lines(random, DBC).encode("utf-8", "surrogatepass"))
        try:
            for message in load_messages(path, OPEN, MESSAGES):
                assert 1 <= message.length <= 8
                assert all(np.isfinite([s.gain, s.bias]).all() and s.raw_min <= s.raw_max for s in message.signals)
        except DbcError as error:
            refused += 1
            assert str(path) in str(error)
    assert refused > n / 4


@numbers(200, 10_000)
def test_tables_of_reactions(tmp_path: Path, n: int) -> None:
    random = np.random.default_rng(3)
    text = (ROOT / "hil" / "reactions.toml").read_text()
    path = tmp_path / "reactions.toml"
    for _ in range(n):
        path.write_bytes(damaged_lines(random, text).encode("utf-8", "surrogatepass"))
        with contextlib.suppress(ReactionsError):
            load_reactions(path=path)


@numbers(200, 25_000)
def test_recordings(tmp_path: Path, n: int) -> None:
    """Read to the end and repaired; a file that only looks like one says where it is damaged."""
    random = np.random.default_rng(4)
    path, fixed = tmp_path / "r.mcap", tmp_path / "fixed.mcap"
    writer = RecordingWriter(path, About("fuzz", RIG, DBC, {"seed": "1"}))
    writer.checkpoint(b"state")
    for k in range(20):
        writer.add_cycles(bytes(SNAPSHOT.itemsize), [bytes(95) + bytes([k])])
        writer.event({"severity": "info", "code": "gap" if k == 9 else "x", "lost": k, "text": "é"})
        writer.tick(k * 300_000_000)
    writer.close()
    whole = path.read_bytes()
    for k in range(n):
        path.write_bytes(damaged_bytes(random, whole))
        with contextlib.suppress(RecordingError):
            for _ in Recording(path).items():
                pass
        if k % 10 == 0:
            fixed.unlink(missing_ok=True)
            with contextlib.suppress(RecordingError):
                repair(path, fixed)


@numbers(2_000, 200_000)
def test_payloads_of_commands(n: int) -> None:
    random = np.random.default_rng(5)
    for k in range(n):
        text = NASTY[random.integers(len(NASTY))]
        payload = damaged_bytes(random, f'{{"value": {text}}}'.encode("utf-8", "surrogatepass")) if k % 2 else None
        with contextlib.suppress(ValueError):
            value = wanted_value(Query(payload, None if k % 3 else text))  # type: ignore[arg-type]
            assert value is None or np.isfinite(value)


@numbers(2_000, 100_000)
def test_inputs_of_cycles(n: int) -> None:
    random = np.random.default_rng(6)
    whole = bytes(48) + (3).to_bytes(8, "little") + bytes(48 + 72)
    parse(whole)
    for _ in range(n):
        with contextlib.suppress(InputsError):
            assert len(parse(damaged_bytes(random, whole)).frames) < 100


@numbers(300, 10_000)
def test_setups_of_telemetry(tmp_path: Path, n: int) -> None:
    random = np.random.default_rng(8)
    path = tmp_path / "telemetry.json"
    TelemetrySetup("ring", "rig", provenance={"seed": "1"}).save(path)
    whole = path.read_bytes()
    assert json.loads(whole)
    for _ in range(n):
        path.write_bytes(damaged_bytes(random, whole))
        with contextlib.suppress(TelemetryError):
            load_setup(path)
