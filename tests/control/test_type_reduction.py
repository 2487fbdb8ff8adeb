"""Karnik-Mendel type reduction against every assignment of each firing strength to an end of its interval."""

from itertools import product

import numpy as np
import pytest

from servohil.control.fuzzy.type_reduction import ascending, centre_of_sets

Array = np.ndarray
Problem = tuple[Array, Array, Array, Array]  # y_low, y_high, f_low, f_high
ASSIGNMENTS = {m: np.array(list(product((0.0, 1.0), repeat=m))) for m in range(1, 10)}


def reduced(problem: Problem) -> tuple[float, float]:
    y_low, y_high, f_low, f_high = problem
    return centre_of_sets(y_low, y_high, ascending(y_low), ascending(y_high), f_low, f_high)


def exhaustive(problem: Problem) -> tuple[float, float]:
    """All 2^M corners of the box of strengths: a ratio of linear functions is extreme in one of them."""
    y_low, y_high, f_low, f_high = problem
    corners = np.where(ASSIGNMENTS[len(y_low)] == 1.0, f_high, f_low)
    corners = corners[corners.sum(axis=1) > 0.0]
    sums = corners.sum(axis=1)
    return float((corners @ y_low / sums).min()), float((corners @ y_high / sums).max())


def switch_points(problem: Problem) -> tuple[float, float]:
    """Eq. 19 read literally, for every L and R."""
    y_low, y_high, f_low, f_high = problem
    m, ends = len(y_low), (list[float](), list[float]())
    a, b = np.argsort(y_low), np.argsort(y_high)
    for k in range(m + 1):
        left = np.concatenate((f_high[a][:k], f_low[a][k:]))
        right = np.concatenate((f_low[b][:k], f_high[b][k:]))
        for end, y, f in ((ends[0], y_low[a], left), (ends[1], y_high[b], right)):
            if f.sum() > 0.0:
                end.append(float(np.sum(y * f) / f.sum()))
    return min(ends[0]), max(ends[1])


def drawn(rng: np.random.Generator, kind: str) -> Problem:
    m = int(rng.integers(1, 10))
    y_low = rng.uniform(-1.0, 1.0, m)
    y_high = y_low + rng.uniform(0.0, 1.0, m)
    f_high = rng.uniform(0.0, 1.0, m)
    f_low = f_high * rng.uniform(0.0, 1.0, m)
    if kind == "equal consequents":
        y_low, y_high = np.round(y_low), np.round(y_low) + np.round(y_high - y_low)
    elif kind == "zero strengths":
        f_low[rng.random(m) < 0.7] = 0.0
        f_high = np.where(rng.random(m) < 0.5, f_low, f_high)
    elif kind == "many magnitudes":
        f_high *= 10.0 ** rng.uniform(-14.0, 2.0, m)
        f_low = np.minimum(f_low, f_high)
    return y_low, y_high, f_low, f_high


@pytest.mark.parametrize(
    ("kind", "problems"), [("any", 1000), ("equal consequents", 300), ("zero strengths", 300), ("many magnitudes", 300)]
)
def test_equals_exhaustive_search(kind: str, problems: int) -> None:
    rng = np.random.default_rng(7)
    tried = 0
    while tried < problems:
        problem = drawn(rng, kind)
        if not problem[3].any():
            continue
        found = reduced(problem)
        np.testing.assert_allclose(found, exhaustive(problem), rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(found, switch_points(problem), rtol=0.0, atol=1e-12)
        tried += 1


def test_one_rule_is_its_consequent() -> None:
    one = np.array([0.3])
    assert reduced((one, one + 0.5, np.array([0.0]), np.array([0.7]))) == (0.3, 0.8)
    assert reduced((one, one + 0.5, np.array([0.2]), np.array([0.7]))) == (0.3, 0.8)


def test_without_any_firing_the_means_of_the_consequents() -> None:
    y_low = np.array([3.0, -1.0, 1.0])
    assert reduced((y_low, y_low + 2.0, np.zeros(3), np.zeros(3))) == pytest.approx((1.0, 3.0), rel=1e-15)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("end", [2, 3])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_strength_that_is_not_finite_gives_the_means_too(bad: float, end: int, place: int) -> None:
    y_low = np.array([3.0, -1.0, 1.0])
    problem = (y_low, y_low + 2.0, np.full(3, 0.2), np.full(3, 0.6))
    problem[end][place] = bad
    assert reduced(problem) == pytest.approx((1.0, 3.0), rel=1e-15)


def test_certain_strengths_give_the_weighted_means() -> None:
    y_low, f = np.array([0.4, 0.1, 0.9]), np.array([0.5, 0.2, 0.3])
    expected = float(y_low @ f / f.sum())
    assert reduced((y_low, y_low + 1.0, f, f)) == pytest.approx((expected, expected + 1.0), rel=1e-14)


def test_subnormal_strengths_stay_within_the_consequents() -> None:
    tiny = np.nextafter(0.0, 1.0)
    y = np.array([0.3, 0.4])
    for low, high in product((0.0, tiny, 2.0 * tiny), (tiny, 3.0 * tiny)):
        yl, yr = reduced((y, y + 0.1, np.full(2, min(low, high)), np.full(2, high)))
        assert 0.3 <= yl <= 0.4 <= yr <= 0.5


def test_the_order_of_the_rules_does_not_matter() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        problem = drawn(rng, "any")
        shuffle = rng.permutation(len(problem[0]))
        other = tuple(part[shuffle] for part in problem)
        assert reduced(other) == pytest.approx(reduced(problem), rel=1e-13, abs=1e-14)  # type: ignore[arg-type]


def test_compiled_equals_plain() -> None:
    rng = np.random.default_rng(4)
    plain = getattr(centre_of_sets, "py_func", centre_of_sets)
    for _ in range(50):
        y_low, y_high, f_low, f_high = problem = drawn(rng, "zero strengths")
        expected = plain(y_low, y_high, ascending(y_low), ascending(y_high), f_low, f_high)
        np.testing.assert_allclose(reduced(problem), expected, rtol=1e-13, atol=1e-15)
