"""cyclictest of the rt-tests, the measure that everybody quotes, as the peer of our own wake-ups."""

import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

LONGEST_US: Final = 50_000  # later than that is only counted
PACKAGE: Final = "rt-tests"  # Debian's


def cyclictest_us(cycles: int, period_us: int, priority: int, processor: int) -> dict[str, float] | None:
    """Percentiles of the wake-up behind an absolute deadline, us: p50, p99, p999; None where it is not installed, or
    may not take the priority.

    One thread, as our loop is one.
    """
    program = shutil.which("cyclictest")
    if program is None:
        return None
    with tempfile.TemporaryDirectory(prefix="servohil-cyclictest-") as folder:
        found = Path(folder) / "found.json"
        words = [
            *(program, "--threads=1", f"--priority={priority}", f"--interval={period_us}", f"--loops={cycles}"),
            *(f"--affinity={processor}", f"--histogram={LONGEST_US}", "--mlockall", "--quiet", f"--json={found}"),
        ]
        if subprocess.run(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False).returncode:
            return None
        thread = json.loads(found.read_text(encoding="utf-8"))["thread"]["0"]
    return percentiles({int(us): int(count) for us, count in thread["histogram"].items()}, cycles)


def percentiles(histogram: Mapping[int, int], cycles: int) -> dict[str, float]:
    """Of `cycles` wake-ups, those beyond the histogram among them, which are `LONGEST_US` late here."""
    figures = {}
    for name, share in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999)):
        seen, figures[name] = 0, float(LONGEST_US)
        for us in sorted(histogram):
            seen += histogram[us]
            if seen >= share * cycles:
                figures[name] = float(us)
                break
    return figures
