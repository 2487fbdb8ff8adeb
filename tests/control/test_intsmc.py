"""The sliding mode law: sigma by its definition along exact motion, the singular crossing, limits and bad input."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from servohil.control.laws.intsmc import IntsmcGains, intsmc_step
from servohil.control.laws.law import (
    FLAGS,
    INTEGRAL,
    NO_AUTHORITY,
    NOT_FINITE,
    RUNNING,
    SATURATED,
    SIGMA,
    STATE_SIZE,
    UNLIMITED,
    GainError,
    reset,
)

GAINS = IntsmcGains(1.2, (3.0, 20.0, 30.0), 4.0, 50.0, 5.0, 0.2)
NO_LIMIT = 1e12


def sig(z: np.ndarray, power: float) -> np.ndarray:
    return np.sign(z) * np.abs(z) ** power


def step(
    state: np.ndarray, e: np.ndarray, limit_v: float = NO_LIMIT, dt: float = 1e-3, gains: IntsmcGains = GAINS
) -> float:
    """The law on a triple integrator: f = 0, b = 1, reference 0."""
    return intsmc_step(state, gains.vector(), e, np.zeros(4), 0.0, 1.0, 1.0, -limit_v, limit_v, dt)


def running(integral: float = 0.0) -> np.ndarray:
    state = np.zeros(STATE_SIZE)
    state[INTEGRAL], state[RUNNING] = integral, 1.0
    return state


def test_sigma_moves_as_the_reaching_law_says() -> None:
    """sigma from its definition (4.14, 4.16) along the exact motion; its slope is -a1 c1 |e''|^(a1-1) K tanh(.)."""
    dt, n = 2e-6, 40_000
    a1 = 1.2
    a2 = a1 / (2 - a1)
    a3 = a2 / (2 - a2)
    e, state = np.array([0.3, -0.8, 2.0]), running()
    path, told = np.empty((n, 3)), np.empty(n)
    for k in range(n):
        path[k] = e
        u = step(state, e, dt=dt)
        told[k] = state[SIGMA]
        e = np.array(
            [e[0] + dt * (e[1] + dt * (e[2] / 2 + dt * u / 6)), e[1] + dt * (e[2] + dt * u / 2), e[2] + dt * u]
        )
    rate = 3.0 * sig(path[:, 2], a1) + 20.0 * sig(path[:, 1], a2) + 30.0 * sig(path[:, 0], a3)
    integral = np.concatenate(([0.0], np.cumsum(0.5 * dt * (rate[1:] + rate[:-1]))))
    sigma = path[:, 1] + rate + 4.0 * (path[:, 0] + integral)
    np.testing.assert_allclose(told, sigma, atol=1e-4 * np.abs(sigma).max())
    slope = np.gradient(sigma, dt)[1:-1]
    expected = (-a1 * 3.0 * np.abs(path[:, 2]) ** (a1 - 1) * 50.0 * np.tanh(sigma / 5.0))[1:-1]
    regular = np.abs(path[1:-1, 2]) ** (a1 - 1) > 0.25
    assert regular.sum() > n // 2
    assert np.abs(expected[regular]).max() > 50.0  # something is being tested
    assert np.abs(slope - expected)[regular].max() < 2e-3 * np.abs(expected).max()


def test_the_error_of_a_triple_integrator_vanishes() -> None:
    gains = replace(GAINS, alpha1=1.05)  # the approach is a power of time (docs/errata.md): fast only near 1
    e, state, dt = np.array([0.05, 0.0, 0.0]), np.zeros(STATE_SIZE), 1e-3
    for _ in range(20_000):
        u = step(state, e, limit_v=20.0, dt=dt, gains=gains)
        e = np.array(
            [e[0] + dt * (e[1] + dt * (e[2] / 2 + dt * u / 6)), e[1] + dt * (e[2] + dt * u / 2), e[2] + dt * u]
        )
    assert np.all(np.abs(e) < 1e-5)


def test_crossing_zero_acceleration_error_is_bounded() -> None:
    """The printed factor |e''|^(1 - a1) makes the command unbounded at e'' = 0; the bounded divisor does not."""

    def highest(bound: float) -> float:
        gains = replace(GAINS, singularity_bound=bound)
        crossing = np.concatenate((-np.logspace(-1, -300, 200), [0.0], np.logspace(-300, -1, 200)))
        asked = [step(running(), np.array([0.05, 0.1, e2]), gains=gains) for e2 in crossing]
        assert np.isfinite(asked).all()
        return float(np.abs(asked).max())

    # |drift| <= |e''| + 4 |s'| + 1.5 * 20 |e'|^0.5 |e''| + 3 * 30 |e|^2 |e'| with |e''| <= 0.1
    s_dot = 0.1 + 3.0 * 0.1**1.2 + 20.0 * 0.1**1.5 + 30.0 * 0.05**3
    drift = 0.1 + 4.0 * s_dot + 30.0 * 0.1**1.5 + 90.0 * 0.05**2 * 0.1
    assert highest(0.2) <= drift / (1.2 * 3.0 * 0.2) + 50.0
    assert highest(1e-9) > 1e6


def test_saturation_is_at_the_limit_on_the_right_side() -> None:
    for sign in (1.0, -1.0):
        state = running()
        assert step(state, np.array([sign, sign, sign]), limit_v=10.0) == -sign * 10.0
        assert state[FLAGS] == SATURATED
        assert state[UNLIMITED] * -sign > 10.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_integral_waits_in_saturation_and_leaves_it(sign: float) -> None:
    state = running()
    for _ in range(1000):
        step(state, sign * np.array([1.0, 0.5, 0.5]), limit_v=10.0)
    assert state[INTEGRAL] == 0.0  # would go on growing with this sign
    state = running(sign * 100.0)  # wound up: the command is saturated although the error has the other sign
    assert step(state, sign * np.array([-0.1, 0.0, 0.0]), limit_v=10.0) == -sign * 10.0
    assert sign * state[INTEGRAL] < 100.0


def test_starts_on_the_surface_and_without_a_jump() -> None:
    rng = np.random.default_rng(3)
    for e in rng.normal(0.0, 0.3, (20, 3)):
        state = np.zeros(STATE_SIZE)
        u = step(state, e, dt=1e-9)
        assert abs(state[SIGMA]) < 1e-9
        other = replace(GAINS, switching_gain=1e-9)
        assert u == pytest.approx(step(np.zeros(STATE_SIZE), e, gains=other), abs=1e-6)
    state = np.zeros(STATE_SIZE)
    assert step(state, np.zeros(3)) == 0.0


def test_reset_forgets() -> None:
    state = running(7.0)
    step(state, np.array([0.1, 0.2, 0.3]))
    reset(state)
    assert not state.any()


def test_one_branch_meets_the_required_jerk() -> None:
    """Whatever the branch, f + b(sign u) u + feedforward is the jerk that the triple integrator gets."""
    rng = np.random.default_rng(5)
    signs = set()
    for _ in range(50):
        e, f, ref_jerk = rng.normal(0.0, 0.2, 3), rng.normal(0.0, 300.0), rng.normal(0.0, 3.0)
        required = step(running(0.01), e) + ref_jerk
        reference = np.array([0.0, 0.0, 0.0, ref_jerk])
        u = intsmc_step(running(0.01), GAINS.vector(), e, reference, f, 400.0, 150.0, -NO_LIMIT, NO_LIMIT, 1e-3)
        assert f + (400.0 if u > 0.0 else 150.0) * u == pytest.approx(required, rel=1e-12, abs=1e-9)
        signs.add(np.sign(u))
    assert signs == {1.0, -1.0}


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("place", range(11))
def test_a_bad_number_gives_zero_a_flag_and_changes_nothing(place: int, bad: float) -> None:
    state, gains, e = running(0.02), GAINS.vector(), np.array([0.01, 0.02, 0.03])
    reference, numbers = np.zeros(4), [0.0, 1.0, 1.0, -10.0, 10.0, 1e-3]  # f, b_extend, b_retract, low, high, dt
    if place < 3:
        e[place] = bad
    elif place < 9:
        numbers[place - 3] = bad
    elif place == 9:
        gains[2] = bad
    else:
        reference[3] = bad
    assert intsmc_step(state, gains, e, reference, *numbers) == 0.0
    assert state[FLAGS] == NOT_FINITE
    assert state[INTEGRAL] == 0.02
    fresh = np.zeros(STATE_SIZE)
    assert intsmc_step(fresh, gains, e, reference, *numbers) == 0.0
    assert fresh[RUNNING] == 0.0  # the start waits for good numbers
    assert np.isfinite(fresh).all()


def test_a_spoilt_state_or_gain_never_gets_out() -> None:
    state = running(np.nan)
    assert step(state, np.zeros(3)) == 0.0
    assert state[FLAGS] == NOT_FINITE
    for i in range(8):
        gains = GAINS.vector()
        gains[i] = np.nan
        assert intsmc_step(running(), gains, np.ones(3), np.zeros(4), 0.0, 1.0, 1.0, -10.0, 10.0, 1e-3) == 0.0
    zero = GAINS.vector()
    zero[[1, 3, 5]] = 0.0  # divisors
    assert np.isfinite(
        intsmc_step(np.zeros(STATE_SIZE), zero, np.ones(3), np.zeros(4), 0.0, 1.0, 1.0, -10.0, 10.0, 1e-3)
    )


def test_without_authority_the_valve_stays_shut() -> None:
    state, blocked = running(), (np.zeros(4), 0.0, -5.0, 100.0, -10.0, 10.0, 1e-3)
    assert intsmc_step(state, GAINS.vector(), np.array([-1.0, 0.0, 0.0]), *blocked) == 0.0
    assert state[FLAGS] == NO_AUTHORITY
    assert intsmc_step(state, GAINS.vector(), np.array([1.0, 0.0, 0.0]), *blocked) < 0.0


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"alpha1": 1.0}, r"alpha1 = 1.0: must satisfy 1 < alpha1 < 1.33333"),
        ({"alpha1": 1.34}, r"alpha1 = 1.34: must satisfy"),
        ({"alpha1": float("nan")}, "alpha1 = nan: must be finite"),
        ({"c": (0.0, 20.0, 30.0)}, r"c\[0\] = 0.0: must be > 0"),
        ({"c": (3.0, -1.0, 30.0)}, r"c\[1\] = -1.0: must be > 0"),
        ({"c": (3.0, 20.0, 60.0)}, r"r\^3 \+ c1 r\^2 \+ \.\.\. must be Hurwitz, c1 c2 > c3, here 60 and 60"),
        ({"c": (3.0,)}, "at least 2, one per derivative"),
        ({"decay_per_s": 0.0}, "decay_per_s = 0.0: must be > 0"),
        ({"switching_gain": -1.0}, "switching_gain = -1.0: must be > 0"),
        ({"boundary_layer": 0.0}, "boundary_layer = 0.0: must be > 0"),
        ({"singularity_bound": 0.0}, "singularity_bound = 0.0: must be > 0"),
        ({"singularity_bound": 1.5}, "singularity_bound = 1.5: must be <= 1"),
    ],
)
def test_gains_name_the_condition_they_break(change: dict[str, Any], text: str) -> None:
    with pytest.raises(GainError, match=text):
        replace(GAINS, **change)


def test_hurwitz_condition_is_that_of_the_roots() -> None:
    rng = np.random.default_rng(11)
    for c1, c2, c3 in rng.uniform(0.1, 5.0, (200, 3)):
        stable = bool(np.all(np.roots([1.0, c1, c2, c3]).real < 0.0))
        try:
            replace(GAINS, c=(c1, c2, c3))
        except GainError:
            assert not stable
        else:
            assert stable


def test_compiled_equals_plain() -> None:
    rng = np.random.default_rng(9)
    compiled, plain = np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)
    for _ in range(100):
        e, numbers = rng.normal(0.0, 0.1, 3), (np.full(4, 0.3), rng.normal(0.0, 50.0), 40.0, 25.0, -10.0, 10.0, 1e-3)
        a = intsmc_step(compiled, GAINS.vector(), e, *numbers)
        b = getattr(intsmc_step, "py_func", intsmc_step)(plain, GAINS.vector(), e, *numbers)
        assert a == pytest.approx(b, rel=1e-12)
    np.testing.assert_allclose(compiled, plain, rtol=1e-12)
