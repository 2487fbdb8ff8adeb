"""Coming to rest: derivatives by finite differences, the ends, and the way."""

import numpy as np
import pytest

from servohil.control.stopping import come_to_rest

X0, V0, T = 0.31, -0.28, 0.4


def at(t_s: float) -> np.ndarray:
    out = np.empty(4)
    come_to_rest(t_s, X0, V0, T, out)
    return out


def test_starts_at_the_measured_position_and_velocity_without_acceleration() -> None:
    assert at(0.0) == pytest.approx([X0, V0, 0.0, 0.0], abs=1e-15)


def test_ends_at_rest_and_stays_after_half_the_way_of_constant_speed() -> None:
    for t_s in (T, T + 1e-9, 10 * T):
        assert at(t_s) == pytest.approx([X0 + V0 * T / 2, 0.0, 0.0, 0.0], abs=1e-14)


def test_each_row_is_the_derivative_of_the_one_before() -> None:
    h = 1e-5
    for t_s in np.linspace(0.02, T - 0.02, 37):
        numeric = (at(t_s + h) - at(t_s - h)) / (2 * h)
        exact = at(t_s)
        for order in range(3):
            assert numeric[order] == pytest.approx(exact[order + 1], rel=1e-6, abs=1e-6)
