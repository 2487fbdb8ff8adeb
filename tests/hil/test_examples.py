"""The examples, run as a reader would run them, against real processes."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from telemetry_rig import RIG, FakeRig

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
LINE = re.compile(r" *(\d+) +(-?\d+\.\d{6}|nan) m +-?\d+\.\d{5} m/s +-?\d+\.\d{3} V")


@pytest.mark.processes
def test_subscribe_state_prints_live_state(tmp_path: Path) -> None:
    with FakeRig(tmp_path, setup={"recording": None}) as rig:
        rig.ready()
        arguments = ["--connect", rig.endpoint, "--rig", RIG, "--count", "40"]
        done = subprocess.run(
            [sys.executable, "subscribe_state.py", *arguments],
            cwd=EXAMPLES,
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        lines = [LINE.fullmatch(line) for line in done.stdout.splitlines()]
        assert len(lines) == 40 and all(lines)
        cycles = [int(line[1]) for line in lines if line]
        assert cycles == list(range(cycles[0], cycles[0] + 40))
        wrong = subprocess.run(
            [sys.executable, "subscribe_state.py", "--connect", rig.endpoint, "--rig", "nobody"],
            cwd=EXAMPLES,
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
        assert wrong.returncode == 1 and wrong.stderr == f"no rig 'nobody' at {rig.endpoint}\n"
