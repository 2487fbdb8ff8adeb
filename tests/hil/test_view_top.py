"""The terminal view: what it shows of a rig's messages, and that it says so when it has none or old ones."""

import io
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from rich.console import Console
from telemetry_rig import FakeRig
from view_messages import said

from servohil.hil.cli import main
from servohil.hil.view import top
from servohil.hil.view.freshness import STALE_NS
from servohil.hil.view.top import Screen

S = 1_000_000_000
SNAPSHOT = {"state": "ACTIVE", "cycle": 12345, "t_ns": 12_345_000_000, "position_m": 0.31234, "est_position_m": 0.31230,
            "std_position_m": 0.0001, "pressure_b_pa": None, "command_v": -1.5}  # fmt: skip
LEAKS = {"internal": {"flow_m3ps": 1.7e-5}, "external_a": {"flow_m3ps": 0.0}, "external_b": {"flow_m3ps": None}}
DIAGNOSIS = {"mode": "watching", "level": "alarm", "leak": "internal", "leaks": LEAKS, "text": "internal leak, A to B"}
HEALTH = {"overruns": 7, "rate_hz": 999.96, "lateness_us": {"p50": 12.34, "p99": 99.0, "p999": 150.0, "max": 4321.0}}


def shown(screen: Screen, now_ns: int, problem: str | None = None) -> str:
    console = Console(width=110, record=True, file=io.StringIO())
    console.print(screen.render(now_ns, problem))
    return console.export_text()


def full() -> Screen:
    screen = Screen("bench", "tcp/127.0.0.1:7447")
    event = {"severity": "alarm", "t_ns": 12_000_000_000, "text": "leak found"}
    screen.take([said("snapshot", SNAPSHOT, S), said("diagnosis", DIAGNOSIS, S), said("health", HEALTH, S),
                 said("event/alarm/leak", event, S)])  # fmt: skip
    return screen


def test_everything_an_operator_asks_for_is_on_one_screen() -> None:
    screen = full()
    assert screen.complete
    text = shown(screen, S)
    parts = "bench at tcp/127.0.0.1:7447|ACTIVE|12345|312.34|312.30|0.20|-1.50|mm|bar"
    parts += "|internal|1.020|watching; leak alarm|12.3|4321.0|1000.0|7|leak found"
    for part in parts.split("|"):
        assert part in text, part
    assert "STALE" not in text and len(text.splitlines()) <= 40


def test_old_data_are_called_old() -> None:
    assert "STALE: no new cycle for 0.5 s" in shown(full(), S + STALE_NS + 1)
    frozen = full()
    frozen.take([said("snapshot", SNAPSHOT, 3 * S)])  # the same cycle again
    assert "STALE: no new cycle for 2.0 s" in shown(frozen, 3 * S)


def test_before_anything_came_it_says_why() -> None:
    screen = Screen("bench", "tcp/127.0.0.1:7447")
    assert not screen.complete
    assert "no data: nobody listens there" in shown(screen, S, "nobody listens there")


@pytest.mark.parametrize(
    "rubbish",
    [
        {},
        {"cycle": "x", "t_ns": "y", "state": 3, "position_m": "z", "leaks": [1]},
        {"leaks": {"internal": 3}, "lateness_us": 4, "cycle": True, "severity": []},
    ],
)
def test_rubbish_is_a_dash_and_no_traceback(rubbish: dict[str, Any]) -> None:
    screen = full()
    screen.take([said(name, rubbish, S) for name in ("snapshot", "diagnosis", "health", "event/x/y")])
    shown(screen, S)


def test_once_without_a_rig_ends_with_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(top, "ONCE_S", 0.3)
    done = CliRunner().invoke(main, ["top", "--connect", "tcp/127.0.0.1:1", "--rig", "bench", "--once"])
    assert done.exit_code == 1
    assert "bench: nobody" in done.output and "Traceback" not in done.output


@pytest.mark.parametrize(
    ("endpoint", "says"), [("tcp/127.0.0.1:0", "any free port"), ("tls/rig-pc:7447", "--credentials is missing")]
)
def test_an_endpoint_that_cannot_be_reached_is_refused_with_what_is_allowed(endpoint: str, says: str) -> None:
    for command in ("top", "view"):
        done = CliRunner().invoke(main, [command, "--connect", endpoint, "--rig", "bench"])
        assert done.exit_code == 1 and says in done.output and "allowed" in done.output


@pytest.mark.processes
def test_once_shows_a_running_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(top, "ONCE_S", 60.0)
    with FakeRig(tmp_path, leak_at=0) as rig:
        rig.ready()
        start = time.monotonic()
        done = CliRunner().invoke(main, ["top", "--connect", rig.endpoint, "--rig", "fake", "--once"])
        assert done.exit_code == 0, done.output
        assert "DISABLED" in done.output and "external_b" in done.output and "leak alarm" in done.output
        assert time.monotonic() - start < 60.0
