"""The laws on a chain of integrators with a bounded disturbance: the surface is reached and kept, the error vanishes,
in finite time where that is promised and as a power of time where it is not.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

from servohil.control.laws import afintsc, fintsc, integral_terminal, intsmc, ntsmc, pid, pole_placement, smc
from servohil.control.laws.law import FLAGS, NOT_FINITE, RUNNING, SIGMA, STATE_SIZE

Array = np.ndarray


@njit(nogil=True)
def simulate(step: Callable[..., float], gains: Array, e0: Array, disturbance: float, dt: float, steps: int,
             limit: float, running: bool = False) -> tuple[Array, Array, Array]:  # fmt: skip
    """Errors (steps, n), sigma and command: e^(n) = u + d sin 3t, u held, exact but for the disturbance."""
    n = e0.size
    e, state, reference = e0.copy(), np.zeros(STATE_SIZE), np.zeros(n + 1)
    state[RUNNING] = 1.0 if running else 0.0  # with nothing in its integral: off the surface
    path, sigma, command = np.empty((steps, n)), np.empty(steps), np.empty(steps)
    for k in range(steps):
        path[k] = e
        u = step(state, gains, e, reference, 0.0, 1.0, 1.0, -limit, limit, dt)
        sigma[k], command[k] = state[SIGMA], u
        top = u + disturbance * np.sin(3.0 * (k + 0.5) * dt)
        for i in range(n):
            power, moved = 1.0, 0.0
            for j in range(i, n):
                moved += power * e[j]
                power *= dt / (j - i + 1)
            e[i] = moved + power * top  # e[i + 1 ..] are still those of the step's beginning
    return path, sigma, command


LAYER, GAIN = 0.05, 30.0
SLIDING = {
    "intsmc 2": (intsmc.intsmc_step, intsmc.IntsmcGains(1.2, (2.0, 3.0), 4.0, GAIN, LAYER, 0.2), 2),
    "intsmc 3": (intsmc.intsmc_step, intsmc.IntsmcGains(1.1, (6.0, 12.0, 8.0), 4.0, GAIN, LAYER, 0.2), 3),
    "integral terminal 2": (
        integral_terminal.integral_terminal_step,
        integral_terminal.IntegralTerminalGains(0.6, (2.0, 3.0), GAIN, LAYER), 2,
    ),
    "integral terminal 3": (
        integral_terminal.integral_terminal_step,
        integral_terminal.IntegralTerminalGains(0.8, (6.0, 12.0, 8.0), GAIN, LAYER), 3,
    ),
    "smc 2": (smc.smc_step, smc.SmcGains(4.0, GAIN, LAYER), 2),
    "smc 3": (smc.smc_step, smc.SmcGains(4.0, GAIN, LAYER), 3),
    "ntsmc 2": (ntsmc.ntsmc_step, ntsmc.NtsmcGains((4.0,), (1.5,), GAIN, LAYER, 0.2), 2),
}  # fmt: skip
OTHERS = {
    "ntsmc 3": (ntsmc.ntsmc_step, ntsmc.NtsmcGains((2.0, 3.0), (1.2, 1.1), GAIN, LAYER, 0.5), 3),
    "fintsc 2": (fintsc.fintsc_step, fintsc.FintscGains(0.05, 1.1, 1.2, (2.0, 3.0), 8.0, 0.1, 0.02, 0.2), 2),
    "fintsc 3": (fintsc.fintsc_step, fintsc.FintscGains(0.05, 1.05, 1.2, (6.0, 12.0, 8.0), 8.0, 0.5, 0.1, 0.5), 3),
    "afintsc 2": (
        afintsc.afintsc_step,
        afintsc.AfintscGains(1.1, 1.2, (2.0, 3.0), 8.0, 0.1, 0.02, 0.2, 0.3, 1.0, 0.1, 0.1), 2,
    ),
    "pole placement 2": (
        pole_placement.pole_placement_step, pole_placement.PolePlacementGains(2, 8.0), 2
    ),
    "pole placement 3": (
        pole_placement.pole_placement_step, pole_placement.PolePlacementGains(3, 8.0), 3
    ),
}  # fmt: skip
START = np.array([0.5, -0.4, 0.6])


@pytest.mark.parametrize("name", SLIDING)
def test_the_lyapunov_function_falls_until_the_boundary_layer_and_stays_there(name: str) -> None:
    """V = sigma^2 / 2 with |d| = 10 < K = 30; inside the layer |sigma| stays where K tanh outweighs d."""
    step, gains, n = SLIDING[name]
    path, sigma, _ = simulate(step, gains.vector(), START[:n], 10.0, 1e-4, 60_000, 1e9, True)
    outside = np.abs(sigma) > LAYER
    assert outside[:100].all()
    falls = np.diff(0.5 * sigma**2)[outside[:-1]]
    assert (falls < 0.0).all()
    inside = int(np.flatnonzero(~outside)[0])
    assert not outside[inside + 1 :].any()
    assert np.abs(path[-10_000:, 0]).max() < 0.1 * START[0]


@pytest.mark.parametrize("name", [*SLIDING, *OTHERS])
def test_every_law_takes_the_error_near_zero_against_a_disturbance(name: str) -> None:
    step, gains, n = {**SLIDING, **OTHERS}[name]
    path, _, command = simulate(step, gains.vector(), START[:n], 2.0, 1e-3, 15_000, 100.0)
    assert np.isfinite(command).all() and np.abs(command).max() <= 100.0
    assert np.abs(path[-3000:, 0]).max() < 0.05 * START[0]


def settling(alpha: float, e0: Array, tolerance: float) -> float:
    gains = integral_terminal.IntegralTerminalGains(alpha, (2.0, 3.0), GAIN, LAYER).vector()
    path, _, _ = simulate(integral_terminal.integral_terminal_step, gains, e0, 0.0, 1e-4, 200_000, 1e9)
    return 1e-4 * float(np.flatnonzero(np.abs(path[:, 0]) > tolerance)[-1])


def test_the_corrected_law_is_there_in_finite_time_and_that_time_scales_as_it_must() -> None:
    """For n = 2 the motion on s = 0 is homogeneous: T(k^(2-a) e, k e') = k^(1-a) T(e, e')."""
    alpha, e0 = 0.6, np.array([0.5, -0.4])
    times = [settling(alpha, e0, tolerance) for tolerance in (1e-4, 1e-6, 1e-8)]
    assert times[0] < 5.0 and times[2] - times[0] < 0.35 * times[0]  # an exponential would take as long again for each
    k = 4.0
    scaled = settling(alpha, e0 * [k ** (2.0 - alpha), k], 1e-7 * k ** (2.0 - alpha))
    assert scaled == pytest.approx(k ** (1.0 - alpha) * settling(alpha, e0, 1e-7), rel=0.02)


def test_the_printed_law_is_not() -> None:
    """With exponents above 1 the error on s = const falls as t^(-1 / (a2 - 1)): the slope in log-log."""
    alpha = 1.5
    a2 = alpha / (2.0 - alpha)
    gains = intsmc.IntsmcGains(alpha, (2.0, 3.0), 4.0, GAIN, LAYER, 0.2).vector()
    path, _, _ = simulate(intsmc.intsmc_step, gains, np.array([0.05, 0.0]), 0.0, 1e-3, 4_000_000, 1e9)
    late = np.abs(path[[400_000, 3_999_999], 0])
    slope = np.log(late[1] / late[0]) / np.log(10.0)
    assert slope == pytest.approx(-1.0 / (a2 - 1.0), rel=0.1)


ALL = {**SLIDING, **OTHERS, "pid 3": (pid.pid_step, pid.PidGains(10.0, 1.0, 1.0, 2.0), 3)}


@pytest.mark.parametrize("name", ALL)
def test_bad_numbers_end_in_zero_and_a_flag_and_the_state_stays(name: str) -> None:
    step, gains, n = ALL[name]
    vector = gains.vector()
    good = (START[:n].copy(), np.zeros(n + 1), 0.0, 1.0, 1.0, -10.0, 10.0, 1e-3)
    state = np.zeros(STATE_SIZE)
    step(state, vector, *good)
    before = state.copy()
    for place in range(len(good)):
        for bad in (np.nan, np.inf):
            spoilt = [part.copy() if isinstance(part, np.ndarray) else part for part in good]
            if place < 2:
                spoilt[place][-1 if place == 0 else 1 if name.startswith("pid") else n] = bad
            else:
                spoilt[place] = bad
            if name.startswith("pid") and (place in (2, 3, 4) or place == 0):
                continue  # it uses neither the plant nor the highest derivative
            assert step(state, vector, *spoilt) == 0.0, (place, bad)
            assert state[FLAGS] == NOT_FINITE
            np.testing.assert_array_equal(
                np.delete(state, [FLAGS, RUNNING + 2]), np.delete(before, [FLAGS, RUNNING + 2])
            )


@pytest.mark.parametrize("name", ALL)
def test_the_first_step_with_no_error_asks_for_what_the_plant_needs_and_no_more(name: str) -> None:
    step, gains, n = ALL[name]
    reference = np.zeros(n + 1)
    command = step(np.zeros(STATE_SIZE), gains.vector(), np.zeros(n), reference, -6.0, 2.0, 1.0, -10.0, 10.0, 1e-3)
    assert command == pytest.approx(0.0 if name.startswith("pid") else 3.0, abs=1e-12)
