"""What `deploy/` sets up: a unit that systemd accepts, options that exist, and a restart that never moves."""

import configparser
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from bench_rig import ROOT
from click.testing import CliRunner

from servohil.hil.cli import main
from servohil.hil.run import EXIT_FAULT, EXIT_TELEMETRY

DEPLOY = ROOT / "deploy"
UNIT = DEPLOY / "servohil@.service"
NETWORK = sorted(path for path in DEPLOY.iterdir() if path.suffix in (".link", ".network", ".netdev"))
# systemd.link(5), systemd.network(5), systemd.netdev(5) of systemd 252: the keys of the sections that we use.
KNOWN = {
    ".link": {"Match": {"OriginalName", "Type", "Driver", "Path"}, "Link": {"NamePolicy", "TransmitQueueLength"}},
    ".network": {
        "Match": {"Name", "Type", "Kind"},
        "Link": {"RequiredForOnline", "ActivationPolicy"},
        "CAN": {"BitRate", "SamplePoint", "RestartSec", "BusErrorReporting", "FDMode", "DataBitRate", "Termination"},
    },
    ".netdev": {"NetDev": {"Name", "Kind", "Description"}},
}


def settings(path: Path) -> dict[str, dict[str, list[str]]]:
    """Sections of a unit: key -> its values in order. A key that stands twice is a list, as systemd has it."""
    found: dict[str, dict[str, list[str]]] = {}
    section = ""
    for line in path.read_text().splitlines():
        if line.startswith("["):
            section = line.strip("[]")
            found[section] = {}
        elif line and line[0] not in "#;":
            key, sign, value = line.partition("=")
            assert sign and re.fullmatch(r"[A-Za-z]+", key), f"{path.name}: {line!r}"
            found[section].setdefault(key, []).append(value)
    return found


SERVICE = settings(UNIT)["Service"]


def commands() -> list[list[str]]:
    return [shlex.split(line) for key, lines in SERVICE.items() if key.startswith("Exec") for line in lines]


def test_every_command_and_option_of_the_unit_exists() -> None:
    assert len(commands()) == 2
    for program, name, *rest in commands():
        assert program.endswith("/.venv/bin/hil")
        assert name in main.commands, name
        shown = CliRunner().invoke(main, [name, "--help"]).output
        for word in rest:
            assert not word.startswith("-") or re.search(rf"{re.escape(word.split('=')[0])}\b", shown), word
        assert [word for word in rest if not word.startswith("-")] == ["/etc/servohil/%i.toml"]


def test_a_start_never_moves() -> None:
    """A restart is a start: it ends in DISABLED, and only an operator goes on from there."""
    assert all("--enable" not in command for command in commands())
    assert SERVICE["Restart"] == ["on-failure"]
    refused = 1
    assert set(map(int, SERVICE["RestartPreventExitStatus"][0].split())) == {refused, EXIT_FAULT}
    assert EXIT_TELEMETRY not in (refused, EXIT_FAULT)
    assert settings(UNIT)["Unit"]["StartLimitBurst"] == ["3"]


def test_the_watchdog_is_fed_by_a_child_and_ends_the_controller_in_order() -> None:
    assert (SERVICE["Type"], SERVICE["NotifyAccess"]) == (["notify"], ["all"])
    assert (SERVICE["WatchdogSignal"], SERVICE["KillMode"]) == (["SIGTERM"], ["mixed"])
    # The keep-alive comes every 0.1 s; three of them may be lost, and an orderly end fits before the kill.
    assert 0.4 <= float(SERVICE["WatchdogSec"][0]) <= 5.0
    assert float(SERVICE["TimeoutAbortSec"][0]) > 1.0


def test_the_loop_gets_its_rights_and_nothing_else_gets_more() -> None:
    rights = {"CAP_SYS_NICE", "CAP_IPC_LOCK"}
    assert set(SERVICE["AmbientCapabilities"][0].split()) == set(SERVICE["CapabilityBoundingSet"][0].split()) == rights
    assert "CPUSchedulingPolicy" not in SERVICE  # every thread of telemetry would inherit it
    assert SERVICE["RestrictRealtime"] == ["no"]
    assert {"AF_CAN", "AF_UNIX", "AF_INET"} <= set(SERVICE["RestrictAddressFamilies"][0].split())
    for breaks in ("MemoryDenyWriteExecute", "PrivateNetwork", "PrivateTmp", "PrivateIPC"):
        assert breaks not in SERVICE, f"{breaks} breaks compiling, CAN, the embedded bus or the ring"


@pytest.mark.parametrize("path", NETWORK, ids=lambda path: path.name)
def test_network_files_have_only_keys_that_systemd_knows(path: Path) -> None:
    parser = configparser.ConfigParser(interpolation=None, strict=True)
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read_string(path.read_text())
    known = KNOWN[path.suffix]
    for section in parser.sections():
        assert set(parser[section]) <= known[section], f"{path.name} [{section}]"
    assert len(parser.sections()) >= 1


def test_the_can_link_is_set_as_the_doctor_wants_it() -> None:
    from servohil.hil.doctor_can import LONGEST_QUEUE

    link, network = settings(DEPLOY / "80-servohil-can.link"), settings(DEPLOY / "80-servohil-can.network")
    assert int(link["Link"]["TransmitQueueLength"][0]) <= LONGEST_QUEUE
    assert network["CAN"]["BitRate"] and network["CAN"]["RestartSec"] != ["0"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze on this machine")
def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    """As it stands, but for what this machine lacks: the installed program and the account."""
    text = UNIT.read_text().replace("/opt/servohil/.venv/bin/hil", str(Path(sys.executable).with_name("hil")))
    unit = tmp_path / UNIT.name
    good = verify(unit, text.replace("=servohil\n", "=daemon\n"))
    assert good == "", good
    assert "Sheduling" in verify(unit, text.replace("[Install]", "Sheduling=fifo\n[Install]"))
    assert "parse sec value" in verify(unit, text.replace("WatchdogSec=2", "WatchdogSec=two"))


def verify(unit: Path, text: str) -> str:
    """What `systemd-analyze verify` has to say about our unit; the machine's own units are not our business."""
    unit.write_text(text)
    instance = unit.with_name("servohil@bench.service")
    instance.unlink(missing_ok=True)
    os.link(unit, instance)
    done = subprocess.run(
        ["systemd-analyze", "verify", str(instance)],
        capture_output=True, text=True, check=False, timeout=60, env={**os.environ, "SYSTEMD_COLORS": "0"},
    )  # fmt: skip
    lines = (done.stdout + done.stderr).splitlines()
    return "\n".join(line for line in lines if "servohil@" in line)
