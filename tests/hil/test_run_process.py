"""`hil run` as an operator meets it: commands and parameters over Zenoh, shadow mode, another bus; real processes."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from bench_rig import hil, start, wait_until, write_slow_rig

from servohil.drivers.can_network import multicast_obstacle
from servohil.drivers.frame import FRAME
from servohil.drivers.open_port import open_port
from servohil.hil.assemble import command_message, load_bus_codec
from servohil.hil.config import load_rig
from servohil.hil.telemetry.session import client_settings, open_session

pytestmark = pytest.mark.processes

ROOT_KEY = "servohil/v1/bench"


class Controller:
    """A running `hil run` with a Zenoh client beside it."""

    def __init__(self, rig: Path, *options: str) -> None:
        self.process = start("run", rig, *options)
        self.lines: list[str] = []
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line)
            if line.startswith("telemetry: "):
                break
        else:
            raise AssertionError("".join(self.lines))
        endpoint = self.lines[-1].split()[1].rstrip(",")
        self.session = open_session(client_settings([endpoint]))
        self.snapshots: list[dict[str, Any]] = []
        self._subscriber = self.session.declare_subscriber(
            f"{ROOT_KEY}/snapshot", lambda sample: self.snapshots.append(json.loads(sample.payload.to_bytes()))
        )

    def ask(self, key: str, payload: Any = None) -> dict[str, Any]:
        """The one reply to a query."""
        body = None if payload is None else json.dumps(payload)
        replies = [
            json.loads((reply.ok or reply.err).payload.to_bytes())
            for reply in self.session.get(f"{ROOT_KEY}/{key}", payload=body, timeout=5.0)
        ]
        assert len(replies) == 1, replies
        return dict(replies[0])

    def wait_state(self, name: str) -> dict[str, Any]:
        self.snapshots.clear()
        wait_until(lambda: any(s["state"] == name for s in self.snapshots), f"state {name}", 60.0)
        return next(s for s in reversed(self.snapshots) if s["state"] == name)

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        self._subscriber.undeclare()
        self.session.close()
        if self.process.poll() is None:
            self.process.send_signal(number)
        output, _ = self.process.communicate(timeout=60)
        return self.process.returncode, "".join(self.lines) + output


@pytest.fixture
def rigs(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """(rig file of the controller: no [plant], as on a rig PC; rig file of the node), the node running."""
    node_rig = write_slow_rig(tmp_path)
    controller_rig = tmp_path / "controller.toml"
    controller_rig.write_text(node_rig.read_text().split("[plant]")[0])
    node = start("rig", node_rig)
    yield controller_rig, node_rig
    node.send_signal(signal.SIGTERM)
    output, _ = node.communicate(timeout=60)
    assert node.returncode == 0, output


def test_an_operator_enables_tunes_holds_and_stops(rigs: tuple[Path, Path]) -> None:
    controller = Controller(rigs[0])
    try:
        controller.wait_state("DISABLED")
        reply = controller.ask("cmd/enable")
        assert reply["ok"] and reply["result"] == "accepted", reply
        assert controller.wait_state("ACTIVE")["active_t_ns"] >= 0
        amplitude = controller.ask("param/reference.amplitude_m")
        assert (amplitude["value"], amplitude["unit"]) == (0.05, "m")
        assert controller.ask("param/reference.amplitude_m", {"value": 0.1})["ok"]
        refused = controller.ask("param/reference.amplitude_m", {"value": 5.0})
        assert not refused["ok"] and "0.28" in json.dumps(refused)  # says what is allowed
        assert controller.ask("param/reference.amplitude_m")["value"] == 0.1
        assert controller.ask("cmd/hold")["ok"]
        controller.wait_state("HOLD")
        stopped = controller.ask("cmd/estop")
        assert stopped["ok"] and stopped["state"] == "FAULT_DISABLED"
        assert not controller.ask("cmd/enable")["ok"]
        wait_until(lambda: controller.ask("cmd/reset")["ok"], "an accepted reset", 30.0)
        controller.wait_state("DISABLED")
        assert controller.ask("cmd/acknowledge")["ok"]
    finally:
        code, output = controller.end()
    assert code == 0, output
    assert "Traceback" not in output


def test_shadow_mode_follows_another_controller_and_never_sends(rigs: tuple[Path, Path]) -> None:
    controller = Controller(rigs[0], "--enable")
    shadow = Controller(rigs[0], "--listen-only")  # no lock: it is no second controller
    try:
        controller.wait_state("ACTIVE")
        wait_until(lambda: shadow.snapshots and abs(shadow.snapshots[-1]["est_velocity_mps"]) > 0.02, "motion", 60.0)
        seen = shadow.snapshots[-1]
        assert seen["state"] == "DISABLED" and seen["command_v"] == 0.0
        assert seen["position_m"] is None or abs(seen["est_position_m"] - seen["position_m"]) < 2e-3
        # A single frame of the shadow would have been a second commander, which stops the controller at once.
        assert controller.wait_state("ACTIVE")["fault"] == 0
        refused = shadow.ask("cmd/enable")
        assert not refused["ok"] and refused["result"] == "refused_state"
        assert shadow.wait_state("DISABLED")
    finally:
        shadow_code, shadow_output = shadow.end(signal.SIGINT)
        code, output = controller.end(signal.SIGINT)
    assert code == 0, output
    assert shadow_code == 0, shadow_output


@pytest.mark.parametrize("twice", [False, True])
def test_the_last_frame_on_the_bus_after_ctrl_c_is_zero_volts(rigs: tuple[Path, Path], twice: bool) -> None:
    rig = load_rig(rigs[0])
    node_side = load_bus_codec(rig, receive=[command_message(rig)], transmit=[])
    controller = Controller(rigs[0], "--enable")
    spy = open_port("servohil", rig.bus.channel, receive_ids=node_side.receive_ids)
    frames = np.zeros(4096, dtype=FRAME)
    command = node_side.slot(rig.signals.command)

    last_id = 0

    def listen() -> float:
        """Take what has come; the voltage of the last command. (Who does not listen misses frames.)"""
        nonlocal last_id
        n = spy.drain(frames)
        node_side.receive(frames, n, 0)
        last_id = int(frames["id"][n - 1]) if n else last_id
        return float(node_side.values[command])

    try:
        wait_until(lambda: abs(listen()) > 0.1, "a valve command", 60.0)
        controller.process.send_signal(signal.SIGINT)
        if twice:
            controller.process.send_signal(signal.SIGINT)
        wait_until(lambda: (listen(), controller.process.poll())[1] is not None, "the end", 60.0)
    finally:
        code, output = controller.end(0)
    assert code == 0 or (twice and code == 2), output  # shut at speed, a chamber may cavitate
    assert listen() == 0.0
    assert float(node_side.values[node_side.slot(rig.signals.control_word)]) == 0.0
    assert last_id == node_side.receive_ids[0]
    spy.close()


def test_the_bench_over_udp_multicast(tmp_path: Path) -> None:
    port = 20_000 + os.getpid() % 20_000
    group = "239.74.163.91"
    obstacle = multicast_obstacle(group, port)
    if obstacle is not None:
        pytest.skip(obstacle)
    rig = write_slow_rig(tmp_path)
    text = rig.read_text().replace('interface = "servohil"', 'interface = "udp_multicast"')
    channel = next(line for line in text.splitlines() if line.startswith("channel = "))
    text = text.replace(channel, f'channel = "{group}"').replace("[bus.options]", f"[bus.options]\nport = {port}")
    rig.write_text(text)
    path = tmp_path / "report.json"
    done = hil("bench", rig, "--duration", 3, "--leak", 0, "--protocol-only", "--json", path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(path.read_text())["bus"]["interface"] == "udp_multicast"


def test_hil_telemetry_refuses_what_is_no_setup(tmp_path: Path) -> None:
    path = tmp_path / "setup.json"
    path.write_text("{}")
    done: subprocess.CompletedProcess[str] = hil("telemetry", path)
    assert done.returncode == 1
    assert "setup.json" in done.stderr and "Traceback" not in done.stderr


def test_hil_doctor_says_a_line_per_check() -> None:
    done = hil("doctor")
    lines = done.stdout.splitlines()
    assert len(lines) >= 10
    assert all(line.split()[0] in {"ok", "warn", "fail"} or line.startswith(" ") for line in lines), done.stdout


def test_zenoh_is_closed_to_other_machines(rigs: tuple[Path, Path]) -> None:
    controller = Controller(rigs[0])
    try:
        with pytest.raises(zenoh.ZError):
            endpoint = controller.lines[-1].split()[1].rstrip(",")
            open_session(client_settings([endpoint.replace("127.0.0.1", "127.0.0.2")]))
    finally:
        code, output = controller.end()
    assert code == 0, output
