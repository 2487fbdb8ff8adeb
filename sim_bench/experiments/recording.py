"""A recording of an actuator from a CSV file: valve opening u, pressure p and position x, a row per sample."""

import csv
from dataclasses import dataclass
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

COLUMNS: Final = ("u", "p", "x")
FILE: Final = "actuator.csv"


class RecordingError(ValueError):
    """A recording was refused; the message names the file, the row, the column, the value and what is allowed."""


@dataclass(frozen=True)
class Recording:
    """What was measured, as it stands in the file: nothing is scaled.

    Attributes:
        u: (N,) valve opening.
        p: (N,) pressure.
        x: (N,) position.
    """

    u: Vector
    p: Vector
    x: Vector

    @property
    def digest(self) -> str:
        """Of the numbers: other numbers, another digest."""
        return sha256(np.stack([self.u, self.p, self.x]).astype("<f8").tobytes()).hexdigest()[:16]


def read_recording(path: Path, least: int) -> Recording:
    """Read a CSV file, or `actuator.csv` of a folder; line 1 names the columns, e.g. "u,p,x" or "u_valve,p_oil,x_arm".

    Args:
        path: of the file or folder.
        least: rows that are needed.

    Raises:
        RecordingError: see there.
    """
    file = path / FILE if path.is_dir() else path
    try:
        with file.open(newline="", encoding="utf-8", errors="replace") as stream:
            lines = [(reader.line_num, row) for reader in [csv.reader(stream)] for row in reader if row]
    except OSError as error:
        wanted = f"must be a CSV file with columns {', '.join(COLUMNS)}, or a folder with {FILE}"
        raise RecordingError(f"{file}: {error.strerror}; {wanted}") from None
    except csv.Error as error:
        raise RecordingError(f"{file}: no CSV file: {error}") from None
    header = [name.strip() for name in lines[0][1]] if lines else []
    places = [_place(file, name, header) for name in COLUMNS]
    rows = lines[1:]
    if len(rows) < least:
        raise RecordingError(f"{file}: {len(rows)} rows below the names of the columns: must be at least {least}")
    for line, row in rows:
        if len(row) != len(header):
            raise RecordingError(f"{file}: row {line} has {len(row)} values: must be {len(header)}, as line 1")
    u, p, x = (np.array([_number(file, line, header[i], row[i]) for line, row in rows]) for i in places)
    return Recording(u, p, x)


def _place(file: Path, name: str, header: list[str]) -> int:
    """Of the column `name`, or `name_` and what it is."""
    found = [i for i, given in enumerate(header) if given == name or given.startswith(f"{name}_")]
    if len(found) != 1:
        raise RecordingError(
            f"{file}: line 1 names the columns {', '.join(header) or 'not at all'}: "
            f"exactly one must be {name!r} or begin with '{name}_'"
        )
    return found[0]


def _number(file: Path, line: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise RecordingError(f"{file}: row {line}, column {column} = {text!r}: must be a finite number")
    return value
