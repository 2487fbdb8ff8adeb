"""The seven-phase S-curve: its phases against integration of the jerk, its time against a numerical optimum."""

import numpy as np
import pytest
from reference_paths import at

from servohil.control.references import SCurveProfile
from servohil.control.references.s_curve import fastest_move

# distance, speed, acceleration, jerk, and the total time by hand.
CASES = [
    (1.0, 0.5, 1.0, 4.0, 2.0 + 0.5 + 0.25),  # all seven phases: h / v + v / a + a / j
    (0.4, 0.2, 2.0, 5.0, 2.0 + 2.0 * 0.2),  # acceleration not reached: h / v + 2 sqrt(v / j)
    (0.5, 2.0, 1.0, 4.0, 0.25 + np.sqrt(0.25**2 + 4.0 * 0.5)),  # speed not reached: a / j + sqrt((a / j)^2 + 4 h / a)
    (0.016, 2.0, 1.0, 1.0, 4.0 * 0.2),  # neither: 4 cbrt(h / 2 j)
]


def bang_bang_way(speed_mps: float, acceleration_mps2: float, jerk_mps3: float) -> tuple[float, float]:
    """Time and way from rest to a speed and back to rest, by the rectangles of the jerk."""
    if speed_mps * jerk_mps3 >= acceleration_mps2**2:
        up = speed_mps / acceleration_mps2 + acceleration_mps2 / jerk_mps3
    else:
        up = 2.0 * np.sqrt(speed_mps / jerk_mps3)
    return 2.0 * up, speed_mps * up


def optimum_s(h: float, v: float, a: float, j: float) -> float:
    """The shortest time by bisection over the peak speed: the way grows with it."""
    if bang_bang_way(v, a, j)[1] <= h:
        duration, way = bang_bang_way(v, a, j)
        return duration + (h - way) / v
    low, high = 0.0, v
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if bang_bang_way(middle, a, j)[1] < h else (low, middle)
    return bang_bang_way(high, a, j)[0]


@pytest.mark.parametrize(("h", "v", "a", "j", "total_s"), CASES)
def test_the_total_time_is_the_textbooks(h: float, v: float, a: float, j: float, total_s: float) -> None:
    assert fastest_move(h, v, a, j).total_s == pytest.approx(total_s, rel=1e-12)


def test_the_total_time_is_the_numerical_optimum() -> None:
    rng = np.random.default_rng(3)
    kinds = set()
    for _ in range(2000):
        h, v, a, j = 10.0 ** rng.uniform([-3, -2, -1, -1], [0, 0.5, 1, 3])
        move = fastest_move(h, v, a, j)
        kinds.add((move.steady_s > 0.0, move.cruise_s > 0.0))
        assert min(move) >= 0.0
        assert move.total_s == pytest.approx(optimum_s(h, v, a, j), rel=1e-9)
    assert len(kinds) == 4


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(("h", "v", "a", "j", "total_s"), CASES)
def test_the_way_is_the_integral_of_the_jerk(
    h: float, v: float, a: float, j: float, total_s: float, direction: float
) -> None:
    profile = SCurveProfile((0.0, direction * h), 4.0, v, a, j, blend_s=0.1)
    move = fastest_move(h, v, a, j)
    signs = [1, 0, -1, 0, -1, 0, 1]
    lengths = [
        move.jerking_s, move.steady_s, move.jerking_s, move.cruise_s, move.jerking_s, move.steady_s, move.jerking_s,
    ]  # fmt: skip
    state, t_s = np.zeros(3), 4.0
    for sign, length in zip(signs, lengths, strict=True):
        jerk = direction * sign * j
        for x in (0.5 * length, length):
            p = state[0] + x * (state[1] + x * (state[2] / 2.0 + x * jerk / 6.0))
            now = np.array([p, state[1] + x * (state[2] + x * jerk / 2.0), state[2] + x * jerk])
            np.testing.assert_allclose(at(profile, t_s + x)[:3], now, atol=1e-12)
            if x < length:
                assert at(profile, t_s + x)[3] == pytest.approx(jerk)
        state, t_s = now, t_s + length
    assert t_s - 4.0 == pytest.approx(total_s)
    np.testing.assert_allclose(state, [direction * h, 0.0, 0.0], atol=1e-12)
    assert at(profile, 7.9999) == pytest.approx([direction * h, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("h", "v", "a", "j", "total_s"), CASES)
def test_each_limit_is_reached_or_kept(h: float, v: float, a: float, j: float, total_s: float) -> None:
    profile = SCurveProfile((0.0, h), 4.0, v, a, j, blend_s=0.1)
    seen = np.array([at(profile, t_s) for t_s in np.linspace(4.0, 8.0, 8001)])
    speed, acceleration, jerk = np.abs(seen[:, 1:]).max(axis=0)
    move = fastest_move(h, v, a, j)
    assert jerk == pytest.approx(j, rel=1e-12)
    assert speed <= v * (1.0 + 1e-12) and acceleration <= a * (1.0 + 1e-12)
    assert (speed == pytest.approx(v, rel=1e-9)) == (move.cruise_s > 0.0)
    assert (acceleration == pytest.approx(a, rel=1e-9)) == (move.steady_s > 0.0)


def test_levels_follow_each_other_and_begin_again() -> None:
    profile = SCurveProfile((0.2, 0.5, 0.5, 0.3), 2.0, 0.4, 2.0, 25.0)
    for interval, level in enumerate((0.2, 0.5, 0.5, 0.3, 0.2, 0.5)):
        if interval > 0:
            assert at(profile, 2.0 * interval + 1.99) == pytest.approx([level, 0.0, 0.0, 0.0])
    assert at(profile, 5.0) == pytest.approx([0.5, 0.0, 0.0, 0.0])  # a level twice: it stands
