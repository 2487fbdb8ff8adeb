"""Whether a reference stays inside [limits], as far as its keys show it; one rule per kind.

The way into the profile, and what a spline does between its samples, is checked when the profile is built.
"""

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from math import pi
from pathlib import Path
from typing import Any, Final

from servohil.hil.config.controller import Limits
from servohil.hil.config.problems import Problem
from servohil.hil.config.reference import (
    AnyReference,
    ChirpReference,
    PrbsReference,
    RampReference,
    SCurveReference,
    SineReference,
    StepReference,
    TrajectoryReference,
)
from servohil.hil.config.trajectory_file import COLUMNS, Row, TrajectoryFileError, read_trajectory

# Peak over mean speed of the ramp between levels, a polynomial of degree 7, and peak acceleration in units of
# rise / time^2 (control.references.blend).
RAMP_PEAK: Final = 35.0 / 16.0
RAMP_BEND: Final = 16.8 / 5.0**0.5
FEWEST_ROWS: Final = 4
MOST_ROWS: Final = 20_000  # they become part of the configuration that is written beside the results


def reference_inside_limits(folder: Path, reference: AnyReference, limits: Limits) -> Iterator[Problem]:
    """Problems of `reference` with `limits`; `folder` holds the TOML file."""
    if isinstance(reference, TrajectoryReference):
        yield from _trajectory(folder, reference, limits)
    else:
        rule: Callable[[Any, Limits], Iterator[Problem]] = RULES[reference.kind]
        yield from rule(reference, limits)


def _at(*key: str | int) -> tuple[str | int, ...]:
    return ("reference", *key)


def _position(value_m: float, limits: Limits, *key: str | int) -> Iterator[Problem]:
    if not limits.position_min_m <= value_m <= limits.position_max_m:
        yield Problem(_at(*key), f"limits are {limits.position_min_m}..{limits.position_max_m} m")


def _peaks(speed: float, acceleration: float, limits: Limits, speed_key: str, key: str) -> Iterator[Problem]:
    if speed > limits.speed_max_mps:
        text = f"peak speed {speed:g} m/s; limits.speed_max_mps is {limits.speed_max_mps}"
        yield Problem(_at(speed_key), text)
    most = limits.acceleration_max_mps2
    if most is not None and acceleration > most:
        text = f"peak acceleration {acceleration:g} m/s2; limits.acceleration_max_mps2 is {most}"
        yield Problem(_at(key), text)


def _swing(reference: SineReference | ChirpReference, omega: float, limits: Limits, key: str) -> Iterator[Problem]:
    low, high = limits.position_min_m, limits.position_max_m
    reach = (reference.offset_m - reference.amplitude_m, reference.offset_m + reference.amplitude_m)
    if reach[0] < low or reach[1] > high:
        text = f"offset_m = {reference.offset_m} makes it {reach[0]:g}..{reach[1]:g} m; limits are {low}..{high} m"
        yield Problem(_at("amplitude_m"), text)
    yield from _peaks(reference.amplitude_m * omega, reference.amplitude_m * omega**2, limits, key, key)


def _sine(reference: SineReference, limits: Limits) -> Iterator[Problem]:
    yield from _swing(reference, reference.omega_rad_per_s, limits, "omega_rad_per_s")


def _chirp(reference: ChirpReference, limits: Limits) -> Iterator[Problem]:
    key = "first_hz" if reference.first_hz > reference.last_hz else "last_hz"
    yield from _swing(reference, 2.0 * pi * getattr(reference, key), limits, key)


def _change(rise_m: float, ramp_s: float, limits: Limits) -> Iterator[Problem]:
    yield from _peaks(RAMP_PEAK * rise_m / ramp_s, RAMP_BEND * rise_m / ramp_s**2, limits, "ramp_s", "ramp_s")


def _step(reference: StepReference, limits: Limits) -> Iterator[Problem]:
    levels = reference.levels_m
    for index, level in enumerate(levels):
        yield from _position(level, limits, "levels_m", index)
    if reference.ramp_s > reference.dwell_s:
        yield Problem(_at("ramp_s"), f"must be at most dwell_s = {reference.dwell_s}, which contains it")
    steps = [abs(after - before) for before, after in pairwise((*levels, levels[0]))]
    yield from _change(max(steps), reference.ramp_s, limits)


def _ramp(reference: RampReference, limits: Limits) -> Iterator[Problem]:
    for key in ("from_m", "to_m"):
        yield from _position(getattr(reference, key), limits, key)
    yield from _peaks(reference.speed_mps, reference.acceleration_mps2, limits, "speed_mps", "acceleration_mps2")


def _s_curve(reference: SCurveReference, limits: Limits) -> Iterator[Problem]:
    for index, level in enumerate(reference.levels_m):
        yield from _position(level, limits, "levels_m", index)
    yield from _peaks(reference.speed_mps, reference.acceleration_mps2, limits, "speed_mps", "acceleration_mps2")


def _prbs(reference: PrbsReference, limits: Limits) -> Iterator[Problem]:
    for key in ("low_m", "high_m"):
        yield from _position(getattr(reference, key), limits, key)
    if reference.low_m >= reference.high_m:
        yield Problem(_at("high_m"), f"must be above low_m = {reference.low_m}")
    if reference.ramp_s > reference.bit_s:
        yield Problem(_at("ramp_s"), f"must be at most bit_s = {reference.bit_s}, which contains it")
    if reference.seed >= 2**reference.order:
        yield Problem(_at("seed"), f"must be below 2^order = {2**reference.order}")
    yield from _change(abs(reference.high_m - reference.low_m), reference.ramp_s, limits)


RULES: Final[Mapping[str, Callable[..., Iterator[Problem]]]] = {
    "sine": _sine,
    "step": _step,
    "ramp": _ramp,
    "s_curve": _s_curve,
    "chirp": _chirp,
    "prbs": _prbs,
}


def _trajectory(folder: Path, reference: TrajectoryReference, limits: Limits) -> Iterator[Problem]:
    if (reference.file is None) == (not reference.t_s and not reference.position_m):
        yield Problem(_at("file"), "give either a file or t_s and position_m")
        return
    if reference.file is None:
        if len(reference.t_s) != len(reference.position_m):
            yield Problem(_at("position_m"), f"{len(reference.position_m)} values; t_s has {len(reference.t_s)}")
            return
        rows = [Row(0, *sample) for sample in zip(reference.t_s, reference.position_m, strict=True)]
    else:
        try:
            rows = read_trajectory(folder / reference.file)
        except TrajectoryFileError as error:
            yield Problem(_at("file"), str(error))
            return
    if not FEWEST_ROWS <= len(rows) <= MOST_ROWS:
        key = "file" if reference.file else "t_s"
        yield Problem(_at(key), f"{len(rows)} samples; allowed: {FEWEST_ROWS} to {MOST_ROWS}")
        return
    for index, column, text in _samples(rows, limits):
        if reference.file is None:
            yield Problem(_at(column, index), text)
        else:
            value = getattr(rows[index], column)
            yield Problem(_at("file"), f"line {rows[index].line}, column {column} = {value}: {text}")
    if reference.repeat and rows[0].position_m != rows[-1].position_m:
        text = f"the last position, {rows[-1].position_m} m, must be the first, {rows[0].position_m} m"
        yield Problem(_at("repeat"), text)


def _samples(rows: list[Row], limits: Limits) -> Iterator[tuple[int, str, str]]:
    """Index, column and text of the first time out of order, and of the first position beyond the limits."""
    time, position = COLUMNS
    for index, (before, row) in enumerate(pairwise(rows), start=1):
        if row.t_s <= before.t_s:
            yield index, time, f"must be above the time before it, {before.t_s}"
            break
    low, high = limits.position_min_m, limits.position_max_m
    for index, row in enumerate(rows):
        if not low <= row.position_m <= high:
            yield index, position, f"limits are {low}..{high} m"
            break
