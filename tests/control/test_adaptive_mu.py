"""The fuzzy gain against nine rules worked out one by one, against the table, and against what the table promises."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from servohil.control.fuzzy.adaptive_mu import FuzzyMu, mu_interval, mu_type1, mu_type2
from servohil.control.laws.law import GainError

Array = np.ndarray
RULES = ("BBM", "BMS", "MSS")  # table 1: rows |e| = S, M, B; columns |e'| = S, M, B
CONSEQUENTS = {"S": (0.05, 0.15), "M": (0.45, 0.55), "B": (0.85, 0.95)}  # eq. 21, gamma = 1
MIDDLES = np.array([[np.mean(CONSEQUENTS[word]) for word in row] for row in RULES])
TOPS = (0.0, 0.5, 1.0)
CORNERS = np.array(list(product((False, True), repeat=9)))
SETTINGS = FuzzyMu(error_scale=1.0, rate_scale=1.0, footprint=0.1, gamma=1.0)
GRID = np.linspace(0.0, 1.3, 131)


def with_footprint(footprint: float) -> Array:
    return replace(SETTINGS, footprint=footprint).vector()


def surface(function: Any, vector: Array) -> Array:
    return np.array([[function(vector, e, rate) for rate in GRID] for e in GRID])


def band(z: float, footprint: float) -> tuple[Array, Array]:
    """Least and greatest S, M, B anywhere within z +- footprint: at the ends, at a top or at the foot of a slope."""
    inside = [x for x in (0.0, 0.5, 1.0) if abs(x - z) <= footprint]
    at = np.array([z - footprint, z + footprint, *inside])
    sets = np.array([np.interp(at, TOPS, top) for top in np.eye(3)])
    return sets.min(axis=1), sets.max(axis=1)


def nine_rules(e: float, rate: float, footprint: float) -> tuple[float, float]:
    """All nine rules with products (eq. 18), all corners of their strengths (what eq. 19 finds)."""
    error, change = band(e, footprint), band(rate, footprint)
    low, high = (np.outer(error[k], change[k]).ravel() for k in (0, 1))
    strengths = np.where(CORNERS, high, low)
    left, right = (np.array([CONSEQUENTS[word][k] for row in RULES for word in row]) for k in (0, 1))
    sums = strengths.sum(axis=1)
    return float((strengths @ left / sums).min()), float((strengths @ right / sums).max())


def test_type_2_is_the_nine_rules_by_exhaustive_search() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        e, rate, footprint = *rng.uniform(0.0, 1.4, 2), rng.uniform(0.0, 0.15)
        expected = nine_rules(e, rate, footprint)
        vector = with_footprint(footprint)
        np.testing.assert_allclose(mu_interval(vector, e, rate), expected, rtol=0.0, atol=1e-12)
        assert mu_type2(vector, e, rate) == pytest.approx(np.mean(expected), abs=1e-12)


def test_type_1_interpolates_the_table() -> None:
    table = RegularGridInterpolator((TOPS, TOPS), MIDDLES)
    for e, rate in np.random.default_rng(2).uniform(0.0, 1.4, (500, 2)):
        expected = table((min(e, 1.0), min(rate, 1.0)))
        assert mu_type1(SETTINGS.vector(), e, rate) == pytest.approx(float(expected), abs=1e-12)


def test_without_a_footprint_both_types_are_the_same() -> None:
    vector = with_footprint(0.0)
    np.testing.assert_allclose(surface(mu_type2, vector), surface(mu_type1, vector), rtol=0.0, atol=1e-12)


def test_the_footprint_matters_and_only_to_type_2() -> None:
    wide = with_footprint(0.15)
    assert np.abs(surface(mu_type2, wide) - surface(mu_type1, wide)).max() > 0.05
    np.testing.assert_array_equal(surface(mu_type1, wide), surface(mu_type1, with_footprint(0.0)))
    yl, yr = mu_interval(wide, 0.3, 0.2)
    assert yr - yl > 0.15
    yl, yr = mu_interval(with_footprint(0.0), 0.3, 0.2)
    assert yr - yl == pytest.approx(0.1)  # of the consequents


@pytest.mark.parametrize("footprint", [0.0, 0.03, 0.1, 0.15])
@pytest.mark.parametrize("function", [mu_type1, mu_type2])
def test_falls_with_both_inputs_within_the_consequents_without_jumps(function: Any, footprint: float) -> None:
    mu = surface(function, with_footprint(footprint))
    assert mu.min() >= 0.05 and mu.max() <= 0.95
    assert mu[-1, -1] == pytest.approx(0.1) and mu[0, 0] > 0.85
    for axis in (0, 1):
        steps = np.diff(mu, axis=axis)
        assert steps.max() <= 1e-15
        assert steps.min() < -0.005
        assert np.abs(steps).max() <= 0.01 * 4.0  # 0.8 per unit of z without a footprint


def test_is_continuous_where_a_membership_begins() -> None:
    vector = with_footprint(0.1)
    for corner in (0.1, 0.4, 0.5, 0.6, 0.9, 1.0, 1.1):
        for rate in GRID[::10]:
            around = [mu_type2(vector, corner + d, rate) for d in (-1e-9, 0.0, 1e-9)]
            assert np.ptp(around) < 1e-8


def test_scales_signs_and_gamma() -> None:
    other = FuzzyMu(error_scale=0.02, rate_scale=3.0, footprint=0.1, gamma=2.5).vector()
    for e, rate in np.random.default_rng(3).uniform(0.0, 1.4, (50, 2)):
        for function in (mu_type1, mu_type2):
            expected = 2.5 * function(SETTINGS.vector(), e, rate)
            for a, b in product((-0.02, 0.02), (-3.0, 3.0)):
                assert function(other, a * e, b * rate) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
def test_mu_stays_usable_whatever_comes_in(bad: float) -> None:
    for function in (mu_type1, mu_type2):
        for e, rate in ((bad, 0.1), (0.1, bad), (bad, bad)):
            assert 0.05 <= function(SETTINGS.vector(), e, rate) <= 0.95
        for place in range(3):
            vector = SETTINGS.vector()
            vector[place] = bad
            assert 0.05 <= function(vector, 0.2, 0.2) <= 0.95
            vector[place] = 0.0
            assert 0.05 <= function(vector, 0.0, 0.0) <= 0.95


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"error_scale": 0.0}, "error_scale = 0.0: must be > 0"),
        ({"rate_scale": -1.0}, "rate_scale = -1.0: must be > 0"),
        ({"gamma": 0.0}, "gamma = 0.0: must be > 0"),
        ({"gamma": float("inf")}, "gamma = inf: must be finite"),
        ({"footprint": -0.01}, "footprint = -0.01: must be >= 0"),
        ({"footprint": 0.16}, "footprint = 0.16: must satisfy 0 <= footprint <= 0.15"),
        ({"footprint": float("nan")}, "footprint = nan: must be finite"),
    ],
)
def test_settings_name_the_condition_they_break(change: dict[str, Any], text: str) -> None:
    with pytest.raises(GainError, match=text):
        replace(SETTINGS, **change)


def test_compiled_equals_plain() -> None:
    for function in (mu_type1, mu_type2):
        plain = getattr(function, "py_func", function)
        for e, rate in np.random.default_rng(5).uniform(0.0, 1.4, (50, 2)):
            assert plain(SETTINGS.vector(), e, rate) == pytest.approx(function(SETTINGS.vector(), e, rate), rel=1e-13)
