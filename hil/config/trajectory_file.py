"""Samples of a trajectory from a CSV file with the columns t_s and position_m; other columns are left alone."""

import csv
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import Final, NamedTuple

from servohil.hil.small_file import FileTooLargeError, read_small

TRAJECTORY_BYTES: Final = 16 << 20  # some 800 000 samples: a quarter of an hour at 1 kHz
COLUMNS: Final = ("t_s", "position_m")


class TrajectoryFileError(ValueError):
    """A trajectory file that cannot be read; the text names line, column, value and what is allowed."""


class Row(NamedTuple):
    """One sample and the line of the file where it stands."""

    line: int
    t_s: float
    position_m: float


def read_trajectory(path: Path) -> list[Row]:
    """The samples in `path` as they stand there, all of them finite numbers.

    Raises:
        TrajectoryFileError: no such file, too large, not UTF-8, a missing column, or a value that is no finite number.
    """
    try:
        text = read_small(path, TRAJECTORY_BYTES).decode("utf-8-sig")
    except FileNotFoundError:
        raise TrajectoryFileError(f"no such file: {path}; allowed: a CSV file, relative to the TOML file") from None
    except FileTooLargeError as error:
        raise TrajectoryFileError(str(error)) from None
    except OSError as error:
        raise TrajectoryFileError(f"{path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise TrajectoryFileError(f"byte {error.start} is not UTF-8 text; allowed: a CSV file in UTF-8") from None
    return list(_rows(text))


def _rows(text: str) -> Iterator[Row]:
    reader = csv.reader(text.splitlines())
    header = [name.strip() for name in next(reader, [])]
    for name in COLUMNS:
        if header.count(name) != 1:
            raise TrajectoryFileError(f"line 1: {header.count(name)} columns {name}; allowed: one")
    places = [header.index(name) for name in COLUMNS]
    for cells in reader:
        if any(cell.strip() for cell in cells):
            numbers = (
                _number(reader.line_num, name, cells, place) for name, place in zip(COLUMNS, places, strict=True)
            )
            yield Row(reader.line_num, *numbers)


def _number(line: int, name: str, cells: list[str], place: int) -> float:
    cell = cells[place].strip() if place < len(cells) else ""
    try:
        number = float(cell)
    except ValueError:
        number = float("nan")
    if not isfinite(number):
        raise TrajectoryFileError(f'line {line}, column {name} = "{cell}": must be a finite number')
    return number
