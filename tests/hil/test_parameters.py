"""Tunable parameters: taken within bounds, refused whole otherwise."""

from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from servohil.control.references import SineProfile
from servohil.hil import parameters
from servohil.hil.commands import Result
from servohil.hil.config import Rig, load_rig
from servohil.hil.parameters import change, parameter_table, put_into_profile

RIG_PATH = Path(__file__).parents[2] / "rigs" / "bench.toml"


@pytest.fixture
def rig() -> Rig:
    return load_rig(RIG_PATH)


def values_of(rig: Rig) -> np.ndarray:
    return np.array([entry.value for entry in parameter_table(rig)])


def test_names_are_the_keys_of_the_rig_file_with_its_values(rig: Rig) -> None:
    for entry in parameter_table(rig):
        section, key = entry.name.split(".")
        assert getattr(getattr(rig, section), key) == entry.value
        assert entry.minimum <= entry.value <= entry.maximum


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_what_is_not_finite_is_refused_and_changes_nothing(rig: Rig, value: float) -> None:
    table = parameter_table(rig)
    for index in range(len(table)):
        values = values_of(rig)
        assert change(values, index, value, table, rig) == Result.OUT_OF_RANGE
        assert (values == values_of(rig)).all()


def test_each_bound_is_allowed_and_just_beyond_is_refused(rig: Rig) -> None:
    table = parameter_table(rig)
    for index in range(parameters.OFFSET):  # the reference's bounds depend on each other, see below
        entry = table[index]
        for value, step in ((entry.minimum, -1), (entry.maximum, 1)):
            assert change(values_of(rig), index, value, table, rig) == Result.ACCEPTED
            beyond = np.nextafter(value, step * inf)
            assert change(values_of(rig), index, beyond, table, rig) == Result.OUT_OF_RANGE


@pytest.mark.parametrize("index", [-1, 99])
def test_unknown_index(rig: Rig, index: int) -> None:
    assert change(values_of(rig), index, 1.0, parameter_table(rig), rig) == Result.UNKNOWN


def test_a_reference_beyond_the_stroke_or_the_speed_limit_is_refused_whole(rig: Rig) -> None:
    table = parameter_table(rig)
    values = values_of(rig)  # 0.3 +- 0.15 m at 2 rad/s; limits 0.02 to 0.58 m and 1 m/s
    assert change(values, parameters.OFFSET, 0.5, table, rig) == Result.OUT_OF_RANGE  # 0.65 m
    assert change(values, parameters.OMEGA, 7.0, table, rig) == Result.OUT_OF_RANGE  # 1.05 m/s
    assert (values == values_of(rig)).all()
    assert change(values, parameters.AMPLITUDE, 0.05, table, rig) == Result.ACCEPTED
    assert change(values, parameters.OFFSET, 0.5, table, rig) == Result.ACCEPTED


def test_the_profile_gets_the_values(rig: Rig) -> None:
    values = values_of(rig)
    values[parameters.OFFSET : parameters.OMEGA + 1] = 0.25, 0.1, 3.0
    profile = SineProfile(0.3, 0.15, 2.0, 2.0).vector()
    put_into_profile(values, parameter_table(rig), profile)
    assert (profile == SineProfile(0.25, 0.1, 3.0, 2.0).vector()).all()


def test_a_reference_beyond_the_acceleration_limit_is_refused_where_there_is_one(rig: Rig) -> None:
    limits = rig.limits.model_copy(update={"acceleration_max_mps2": 2.0})
    table, values = parameter_table(rig), values_of(rig)  # 0.15 m
    strict = rig.model_copy(update={"limits": limits})
    assert change(values, parameters.OMEGA, 4.0, table, strict) == Result.OUT_OF_RANGE  # 2.4 m/s2
    assert change(values, parameters.OMEGA, 3.6, table, strict) == Result.ACCEPTED
    assert change(values, parameters.OMEGA, 4.0, table, rig) == Result.ACCEPTED
