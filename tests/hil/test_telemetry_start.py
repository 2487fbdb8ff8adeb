"""How the telemetry process starts, and how it says that it cannot. All processes are real."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import zenoh
from telemetry_rig import ROOT, FakeRig, start_alone, until

from servohil.hil.ring import RingWriter
from servohil.hil.telemetry.session import open_hub
from servohil.hil.telemetry.setup import TelemetryError, load_setup

pytestmark = pytest.mark.processes


def test_what_cannot_start_says_why_in_one_line(tmp_path: Path) -> None:
    hub, endpoint = open_hub("tcp/127.0.0.1:0")
    existing = tmp_path / "there.mcap"
    existing.write_bytes(b"")
    cases: list[tuple[dict[str, Any], str]] = [
        ({"listen": endpoint}, f"{endpoint}: the port is in use"),
        ({"listen": "tcp/127.0.0.1"}, "tcp/127.0.0.1: not an endpoint"),
        ({"ring": str(tmp_path / "no.ring")}, "no.ring: No such file"),
        ({"recording": str(tmp_path / "absent" / "r.mcap")}, "absent/r.mcap: No such file"),
        ({"recording": str(existing)}, "there.mcap exists"),
        ({"connect": ("tcp/127.0.0.1:1",)}, "cannot connect to tcp/127.0.0.1:1: nobody listens"),
    ]
    writers = [RingWriter(directory=tmp_path) for _ in cases]
    processes = []
    for i, ((fields, _), writer) in enumerate(zip(cases, writers, strict=True)):
        folder = tmp_path / str(i)
        folder.mkdir()
        processes.append(start_alone(folder, **{"ring": str(writer.file.path), **fields}))
    for (_, expected), writer, process in zip(cases, writers, processes, strict=True):
        _, err = process.communicate(timeout=30)
        assert process.returncode == 2, err
        assert expected in err and err.count("\n") == 1
        assert not writer.reader_alive
        writer.close()
    (tmp_path / "alone.json").write_text('{"ring": "x", "rig": "y", "speed": 3}')
    process = subprocess.run(
        [sys.executable, "-m", "servohil.hil.telemetry", str(tmp_path / "alone.json")],
        check=False,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.returncode == 2 and "alone.json" in process.stderr and "speed" in process.stderr
    (tmp_path / "alone.json").write_text(
        '{"ring": "x", "rig": "y", "parameters": [{"name": "k", "unit": "1", "min": 0, "max": 1, "value": NaN}]}'
    )
    with pytest.raises(TelemetryError, match="k = nan: allowed is 0 to 1"):
        load_setup(tmp_path / "alone.json")
    hub.close()


def test_stop_flag_and_waiting_for_a_subscriber_that_never_comes(tmp_path: Path) -> None:
    writer = RingWriter(directory=tmp_path)
    telemetry = start_alone(tmp_path, ring=str(writer.file.path), wait_for_subscriber_s=60.0)
    until(lambda: writer.file.endpoint, "the session")
    assert not writer.ready
    writer.ask_stop()
    assert telemetry.wait(10) == 0
    assert telemetry.stderr
    telemetry.stderr.close()
    writer.close()


def test_a_client_of_a_router_instead_of_a_hub(tmp_path: Path) -> None:
    router, endpoint = open_hub("tcp/127.0.0.1:0")
    with FakeRig(tmp_path, setup={"connect": [endpoint]}):
        received: list[zenoh.Sample] = []
        subscriber = router.declare_subscriber(f"{ROOT}/state", received.append)
        until(lambda: len(received) > 5, "batches at the router")
        del subscriber
    router.close()


def test_several_sessions_get_ports_of_their_own() -> None:
    sessions = [open_hub("tcp/127.0.0.1:0") for _ in range(3)]
    assert len({endpoint for _, endpoint in sessions}) == 3
    with pytest.raises(TelemetryError, match=sessions[0][1]):
        open_hub(sessions[0][1])
    for session, _ in sessions:
        session.close()
