"""What the guest runs: smoke test, the contract tests of every port over real vcan0, the whole bench over real vcan0.

With --drivers it leaves the bench out. With --warm-up it runs on the host, where it does as much of the same as is
possible without SocketCAN, so that numba's cache holds what the guest needs. The emulated processor is slow: protocol,
states, the leak event and the exit code are judged here, accuracy and overruns are not.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

import pytest
import smoke

CHECKOUT: Final = Path(__file__).resolve().parents[2]
HIL: Final = str(Path(sys.executable).parent / "hil")
RIG: Final = str(CHECKOUT / "rigs" / "vcan-vm.toml")
LEAK_AT_S: Final = 5.0
BENCH: Final = [
    HIL, "bench", RIG, "--rate", "50", "--duration", "9", "--leak-at", f"{LEAK_AT_S:g}", "--protocol-only",
]  # fmt: skip


def faults_of(report: dict[str, Any]) -> list[str]:
    """What is wrong with a report of `hil bench` over SocketCAN, one line each; empty if nothing is."""
    leak = report["leak"]
    faults = []
    if report["bus"]["interface"] != "socketcan":
        faults.append(f"bus.interface is {report['bus']['interface']!r}, not 'socketcan'")
    if report["final_state"] != "DISABLED":
        faults.append(f"final_state is {report['final_state']!r}, not 'DISABLED'")
    if leak["injected_at_s"] is None or abs(leak["injected_at_s"] - LEAK_AT_S) > 1.0:
        faults.append(f"leak.injected_at_s is {leak['injected_at_s']}, not {LEAK_AT_S}")
    elif leak["detected_at_s"] is None or leak["detected_at_s"] <= leak["injected_at_s"]:
        faults.append(f"leak.detected_at_s is {leak['detected_at_s']}, injected at {leak['injected_at_s']}")
    if leak["false_alarms"] != 0:
        faults.append(f"leak.false_alarms is {leak['false_alarms']}, not 0")
    return faults


def pytest_arguments() -> list[str]:
    """For the files with tests that need vcan0; to collect the others takes the guest minutes."""
    files = [path for path in sorted(Path("tests/drivers").glob("test_*.py")) if "mark.socketcan" in path.read_text()]
    return [
        *map(str, files),
        "-m",
        "socketcan",
        "-q",
        "-p",
        "no:cacheprovider",
        "--disable-plugin-autoload",
        "-p",
        "pytest_timeout",
    ]


class Outcomes:
    """Counts what pytest did. A skip is no success here: the guest has all that these tests may miss elsewhere."""

    def __init__(self) -> None:
        self.passed = 0
        self.skipped = 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.passed += report.when == "call" and report.passed
        self.skipped += report.skipped


def contract_tests() -> bool:
    """The driver tests that need a kernel with vcan0, in this process: it has paid for the imports already."""
    outcomes = Outcomes()
    exit_code = pytest.main(pytest_arguments(), plugins=[outcomes])
    if outcomes.skipped or not outcomes.passed:
        print(f"{outcomes.passed} passed, {outcomes.skipped} skipped: all of them must run here", flush=True)
        return False
    return exit_code == pytest.ExitCode.OK


def bench() -> bool:
    """`hil bench` in real time at 50 Hz; its report is left for the host to look at."""
    path = Path(os.environ["SERVOHIL_GUEST_OUTPUT"]) / "report.json"
    outcome = subprocess.run([*BENCH, "--json", str(path)], check=False)
    if outcome.returncode != 0:
        print(f"hil bench: exit code {outcome.returncode}", flush=True)
        return False
    faults = faults_of(json.loads(path.read_text()))
    for fault in faults:
        print(f"hil bench: {fault}", flush=True)
    return not faults


def warm_up(with_bench: bool) -> bool:
    """On the host: the same functions, compiled for the guest's processor."""
    smoke.compiled_function()
    collected = pytest.main([*pytest_arguments(), "--collect-only", "-qq"])  # compiles the files of tests
    if not with_bench:
        return collected == pytest.ExitCode.OK
    with tempfile.TemporaryDirectory() as folder:
        command = [*BENCH, "--lockstep", "--json", str(Path(folder) / "report.json")]
        lockstep = subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, check=False)
    return collected == pytest.ExitCode.OK and lockstep.returncode == 0


def main() -> int:
    """0 if everything holds; the first step that does not ends it with 1."""
    os.chdir(CHECKOUT)
    with_bench = "--drivers" not in sys.argv
    if "--warm-up" in sys.argv:
        return 0 if warm_up(with_bench) else 1
    smoke.main()
    steps = {"contract tests over vcan0": contract_tests} | ({"hil bench over vcan0": bench} if with_bench else {})
    for name, step in steps.items():
        start = time.monotonic()
        good = step()
        print(f"{name}: {'passed' if good else 'FAILED'} after {time.monotonic() - start:.0f} s", flush=True)
        if not good:
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
