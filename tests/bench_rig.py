"""A rig of a test's own: the bench's configuration on a bus and a port that nobody else uses."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
HIL = [sys.executable, "-m", "servohil.hil.cli"]


# For real processes on a machine that may stall each of them for half a second, in which the cylinder goes on moving:
# small and slow motion, and limits that a stall alone does not break.
PATIENT = {
    "amplitude_m = 0.15": "amplitude_m = 0.05",
    "omega_rad_per_s = 2.0": "omega_rad_per_s = 1.0",
    "speed_max_mps = 1.0": "speed_max_mps = 50.0",
    'pressure_min_pa = "-2 bar"': 'pressure_min_pa = "-100 bar"',
    'pressure_max_pa = "210 bar"': 'pressure_max_pa = "2000 bar"',
    "overruns_hold = 30": "overruns_hold = 1000",
    "overruns_fault = 100": "overruns_fault = 2000",
}


def write_rig(folder: Path, edits: dict[str, str] | None = None, dbc: str | None = None, rig: str = "bench") -> Path:
    """`rigs/bench.toml` with a channel of its own, any free Zenoh port, and text replaced as in `edits`."""
    text = (ROOT / "rigs" / f"{rig}.toml").read_text()
    own = {
        'channel = "vcan0"': f'channel = "t{os.getpid()}-{folder.name[-12:]}"',
        'directory = "runs"': f'directory = "{folder}/runs"',
    }
    if rig == "bench":
        own |= {'interface = "auto"': 'interface = "servohil"', "tcp/127.0.0.1:7447": "tcp/127.0.0.1:0"}
    for old, new in {**own, **(edits or {})}.items():
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in {rig}.toml"
        text = text.replace(old, new)
    (folder / "bench.dbc").write_text(dbc if dbc is not None else (ROOT / "rigs" / "bench.dbc").read_text())
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def write_slow_rig(folder: Path) -> Path:
    """The bench at 50 Hz, `rigs/vcan-vm.toml`, on the embedded bus, PATIENT: for what processes do to each other."""
    embedded = {'interface = "socketcan"': 'interface = "servohil"', 'name = "vcan-vm"': 'name = "bench"'}
    return write_rig(folder, {**embedded, **PATIENT}, rig="vcan-vm")


def hil(*arguments: object, timeout_s: float = 240.0) -> subprocess.CompletedProcess[str]:
    """Run one `hil` command to its end."""
    return subprocess.run(
        [*HIL, *map(str, arguments)], capture_output=True, text=True, timeout=timeout_s, cwd=ROOT, check=False
    )


def start(*arguments: object) -> subprocess.Popen[str]:
    """Start one `hil` command in a session of its own."""
    return subprocess.Popen(
        [*HIL, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=ROOT,
        start_new_session=True,
    )


def wait_until(condition: Callable[[], object], what: str, timeout_s: float = 120.0) -> None:
    """Poll until `condition()` holds; fails naming what was waited for."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout_s:.0f} s for {what}"
        time.sleep(0.01)


def only_folder(runs: Path) -> Path | None:
    """The one run folder in `runs`, once it is there."""
    folders = sorted(runs.glob("*")) if runs.exists() else []
    return folders[0] if folders else None
