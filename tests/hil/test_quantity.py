"""Quantities: units by key suffix, exact decimal factors, and refusals that say what is allowed."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servohil.hil.quantity import DIMENSIONS, QuantityError, dimension_of, to_si


@pytest.mark.parametrize(
    ("key", "value", "si"),
    [
        ("stroke_m", "63 mm", 0.063),
        ("stroke_m", "20um", 20e-6),
        ("stroke_m", "20 \u00b5m", 20e-6),  # micro sign
        ("stroke_m", "20 \u03bcm", 20e-6),  # Greek mu
        ("stroke_m", 0.6, 0.6),
        ("stroke_m", 1, 1.0),
        ("area_a_m2", "8.04 cm2", 8.04e-4),
        ("dead_volume_a_m3", "0.213 l", 2.13e-4),
        ("supply_pa", "210 bar", 21e6),
        ("pressure_min_pa", "-1 bar", -1e5),
        ("tank_pa", "+.5e1 kPa", 5000.0),
        ("supply_pa", "14 MPa", 14e6),
        ("batch_s", "10 ms", 0.01),
        ("batch_s", "2 min", 120.0),
        ("rate_hz", "1 kHz", 1000.0),
        ("mass_kg", "0.27 t", 270.0),
        ("load_force_n", "-2 kN", -2000.0),
        ("spool_v", "5 mV", 0.005),
        ("speed_max_mps", "250 mm/s", 0.25),
        ("command_slew_v_per_s", "2 V/ms", 2000.0),
        ("decay_per_s", "3 1/s", 3.0),
        ("omega_rad_per_s", "2 rad/s", 2.0),
        ("friction_ns_per_m", "418.33 N s/m", 418.33),
        ("rotate_bytes", "256 MB", 256e6),
    ],
)
def test_texts_and_numbers_become_si(key: str, value: object, si: float) -> None:
    dimension = dimension_of(key)
    assert dimension is not None
    assert to_si(value, dimension) == si  # exactly: factors are decimal


@pytest.mark.parametrize(
    "key", ["valve_gain", "threshold_sigma", "status_word", "data_ids", "m", "pa", "sensor_age_periods"]
)
def test_keys_without_a_unit_have_no_dimension(key: str) -> None:
    assert dimension_of(key) is None


@pytest.mark.parametrize(
    ("suffix", "name"),
    [("per_s", "a rate"), ("v_per_s", "a voltage rate"), ("rad_per_s", "an angular frequency"), ("s", "a time"),
     ("ns_per_m", "a viscous friction"), ("m", "a length"), ("mps", "a speed"), ("mps2", "an acceleration")],
)  # fmt: skip
def test_the_longest_suffix_decides(suffix: str, name: str) -> None:
    dimension = dimension_of(f"anything_{suffix}")
    assert dimension is not None
    assert dimension.name == name


LENGTH = 'allowed: a number in m, or a text such as "1 mm" in m, um, cm, mm'


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("210 bar", f"bar is a pressure, not a length; {LENGTH}"),
        ("3 parsec", f"unknown unit parsec; {LENGTH}"),
        ("3 MM", f"unknown unit MM; {LENGTH}"),
        ("3", f"a text needs a unit; {LENGTH}"),
        ("mm", f"not a length; {LENGTH}"),
        ("", f"not a length; {LENGTH}"),
        ("1 2 mm", f"unknown unit 2 mm; {LENGTH}"),
        ("1,5 mm", f"unknown unit ,5 mm; {LENGTH}"),
        (True, f"not a length; {LENGTH}"),
        ({"a": 1}, f"not a length; {LENGTH}"),
        (math.nan, f"not finite; {LENGTH}"),
        (-math.inf, f"not finite; {LENGTH}"),
        ("1e999 m", f"not finite; {LENGTH}"),
        ("nan m", f"not a length; {LENGTH}"),
    ],
)
def test_what_is_no_length_is_refused_with_the_units_allowed(value: object, message: str) -> None:
    with pytest.raises(QuantityError, match=f"^{re.escape(message)}$"):
        to_si(value, DIMENSIONS["m"])


def test_the_first_unit_of_every_dimension_is_its_si_unit() -> None:
    for dimension in DIMENSIONS.values():
        assert next(iter(dimension.units.values())) == 1


@given(st.floats(allow_nan=False, allow_infinity=False, width=32), st.sampled_from(sorted(DIMENSIONS)))
def test_the_number_with_its_si_unit_is_the_number(number: float, suffix: str) -> None:
    dimension = DIMENSIONS[suffix]
    unit = next(iter(dimension.units))
    assert to_si(f"{number!r} {unit}", dimension) == number == to_si(number, dimension)
