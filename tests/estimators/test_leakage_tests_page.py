"""The table of docs/leakage_tests.md is what the functions give."""

from pathlib import Path

import pytest

from servohil.estimators.leakage.sequential.cusum import Cusum
from servohil.estimators.leakage.sequential.fixed_threshold import FixedThreshold
from servohil.estimators.leakage.sequential.glr import Glr
from servohil.estimators.leakage.sequential.sprt import Sprt

PAGE = Path(__file__).parents[2] / "docs" / "leakage_tests.md"
SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
ROWS = {
    "plain threshold": lambda hours: FixedThreshold.for_rate(hours, 1000.0),
    "plain threshold, 3 in a row": lambda hours: FixedThreshold.for_rate(hours, 1000.0, 3),
    "CUSUM for 0.25": lambda hours: Cusum.for_rate(hours, 1000.0, 0.25),
    "CUSUM for 1": lambda hours: Cusum.for_rate(hours, 1000.0),
    "SPRT for 0.25": lambda hours: Sprt.for_rate(hours, 1000.0, 0.25),
    "SPRT for 1": lambda hours: Sprt.for_rate(hours, 1000.0),
    "GLR, 2000 samples": lambda hours: Glr.for_rate(hours, 1000.0, 2000),
}


@pytest.mark.parametrize("name", ROWS)
def test_row_is_current(name):
    (line,) = (text for text in PAGE.read_text().splitlines() if text.startswith(f"| {name} |"))
    cells = [cell.strip() for cell in line.strip("|").split("|")][1:]
    for cell, hours in zip(cells[:3], (1.0, 24.0, 8766.0), strict=True):
        assert float(cell) == pytest.approx(ROWS[name](hours).threshold, abs=0.0051)
    test = ROWS[name](24.0)
    for cell, shift in zip(cells[3:], (0.25, 0.5, 1.0, 2.0), strict=True):
        number, unit = cell.split()
        last_digit = 0.1 if "." in number else 1.0
        assert float(number) == pytest.approx(test.delay_s(shift) / SECONDS[unit], abs=0.51 * last_digit)
