"""Every law against its own surface, derived by sympy from the definition: the demand it makes is the one that gives
the surface the motion that the law promises.
"""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
import sympy as sp

from servohil.control.laws import fintsc, integral_terminal, intsmc, ntsmc, pole_placement, smc
from servohil.control.laws.law import INTEGRAL, RUNNING, SIGMA, STATE_SIZE

Array = np.ndarray
ORDERS = (2, 3, 4)
STATES = 200
T = sp.Symbol("t", real=True)
E = sp.Function("e", real=True)(T)


def sig(z: sp.Expr, power: sp.Expr) -> sp.Expr:
    return sp.sign(z) * sp.Abs(z) ** power


def derivative(i: int) -> sp.Expr:
    return E.diff(T, i) if i else E


class Surface:
    """A surface s(e, ..., integral) whose integral grows at `rate`: its value and slope as numbers."""

    def __init__(self, n: int, s: Callable[[sp.Expr], sp.Expr], rate: sp.Expr) -> None:
        held = sp.Symbol("integral", real=True)
        moving = sp.Function("moving", real=True)(T)
        slope = s(moving).diff(T).subs(moving.diff(T), rate).subs(moving, held)
        self._names = sp.symbols(f"e0:{n + 1}", real=True)
        plain = {derivative(i): self._names[i] for i in range(n, -1, -1)}
        arguments = (*self._names, held)
        self._value = sp.lambdify(arguments, _numbers(s(held).subs(plain)), "numpy")
        self._slope = sp.lambdify(arguments, _numbers(slope.subs(plain)), "numpy")
        self._rate = sp.lambdify(arguments, _numbers(rate.subs(plain)), "numpy")

    def value(self, e: Sequence[float], integral: float) -> float:
        return float(self._value(*e, 0.0, integral))

    def rate(self, e: Sequence[float], integral: float) -> float:
        return float(self._rate(*e, 0.0, integral))

    def slope(self, e: Sequence[float], top: float, integral: float) -> float:
        return float(self._slope(*e, top, integral))


def _numbers(expression: sp.Expr) -> sp.Expr:
    """Away from z = 0 the derivative of sign(z) is nothing."""
    return expression.replace(sp.DiracDelta, lambda *_: sp.Integer(0)).doit()


def terminal_rate(n: int, c: Sequence[float], alpha1: float) -> sp.Expr:
    rate, a = sp.Integer(0), sp.Float(alpha1)
    for i in range(1, n + 1):
        rate += c[i - 1] * sig(derivative(n - i), a)
        a = a / (2 - a)
    return rate


def states(n: int, seed: int) -> list[tuple[Array, float]]:
    """Errors away from e^(n-1) = 0, where the regularised laws depart from their surface on purpose."""
    rng = np.random.default_rng(seed)
    e = rng.uniform(0.2, 2.0, (STATES, n)) * rng.choice([-1.0, 1.0], (STATES, n))
    return [(row, float(integral)) for row, integral in zip(e, rng.normal(0.0, 2.0, STATES), strict=True)]


def demand(step: Callable[..., float], gains: Array, e: Array, integral: float) -> tuple[float, Array]:
    """e^(n) that the law asks for: the plant is a chain of integrators, the reference stands."""
    state = np.zeros(STATE_SIZE)
    state[INTEGRAL], state[RUNNING] = integral, 1.0
    return step(state, gains, e, np.zeros(len(e) + 1), 0.0, 1.0, 1.0, -1e12, 1e12, 1e-3), state


C = {2: (2.0, 3.0), 3: (3.0, 20.0, 30.0), 4: (6.0, 20.0, 40.0, 15.0)}
ALPHA = {2: 1.3, 3: 1.2, 4: 1.1}


@pytest.mark.parametrize("n", ORDERS)
def test_intsmc_makes_sigma_fall_as_the_reaching_law_says(n: int) -> None:
    decay, gain, layer = 4.0, 50.0, 5.0
    gains = intsmc.IntsmcGains(ALPHA[n], C[n], decay, gain, layer, 1e-9).vector()
    rate = terminal_rate(n, C[n], ALPHA[n])
    s = Surface(n, lambda integral: E.diff(T) + rate + decay * (E + integral), rate)
    for e, integral in states(n, 1):
        top, state = demand(intsmc.intsmc_step, gains, e, integral)
        sigma = s.value(e, integral)
        assert state[SIGMA] == pytest.approx(sigma, rel=1e-12)
        assert state[INTEGRAL] - integral == pytest.approx(1e-3 * s.rate(e, integral), rel=1e-9)
        factor = ALPHA[n] * C[n][0] * abs(e[-1]) ** (ALPHA[n] - 1.0) + (n == 2)
        expected = -factor * gain * np.tanh(sigma / layer)  # P3 eq. 4.9: V' = -factor K |sigma|
        assert s.slope(e, top, integral) == pytest.approx(expected, rel=1e-10, abs=1e-9)


@pytest.mark.parametrize("n", ORDERS)
def test_the_synergetic_law_meets_its_manifold(n: int) -> None:
    mu, power = 0.5, 1.2
    gains = fintsc.FintscGains(mu, ALPHA[n], power, C[n], 0.0, 1.0, 1e-12, 1e-9).vector()
    rate = terminal_rate(n, C[n], ALPHA[n])
    psi = Surface(n, lambda integral: (E + integral) * (E.diff(T) + rate), rate)
    for e, integral in states(n, 2):
        top, state = demand(fintsc.fintsc_step, gains, e, integral)
        assert state[SIGMA] == pytest.approx(e[0] + integral, rel=1e-12)
        value, slope = psi.value(e, integral), psi.slope(e, top, integral)
        size = abs(value) + abs(slope)
        assert mu * np.sign(slope) * abs(slope) ** power + value == pytest.approx(0.0, abs=1e-9 * size**power + 1e-9)


@pytest.mark.parametrize("n", ORDERS)
def test_the_corrected_law_slides_on_s_itself(n: int) -> None:
    alpha, gain, layer = 0.8, 50.0, 5.0
    gains = integral_terminal.IntegralTerminalGains(alpha, C[n], gain, layer).vector()
    rate = sum(
        (C[n][i - 1] * sig(derivative(n - i), alpha / (i - (i - 1) * alpha)) for i in range(1, n + 1)), sp.Integer(0)
    )
    s = Surface(n, lambda integral: derivative(n - 1) + integral, rate)
    for e, integral in states(n, 3):
        top, state = demand(integral_terminal.integral_terminal_step, gains, e, integral)
        value = s.value(e, integral)
        assert state[SIGMA] == pytest.approx(value, rel=1e-12)
        assert s.slope(e, top, integral) == pytest.approx(-gain * np.tanh(value / layer), rel=1e-10, abs=1e-9)


@pytest.mark.parametrize("n", ORDERS)
def test_conventional_sliding_mode(n: int) -> None:
    decay, gain, layer = 4.0, 50.0, 5.0
    gains = smc.SmcGains(decay, gain, layer).vector()
    lam = sp.Symbol("lam")
    coefficients = sp.Poly((lam + sp.Float(decay)) ** (n - 1), lam).all_coeffs()
    surface = sum((c * derivative(n - 1 - k) for k, c in enumerate(coefficients)), sp.Integer(0))
    s = Surface(n, lambda _: surface, sp.Integer(0))
    for e, _ in states(n, 4):
        top, state = demand(smc.smc_step, gains, e, 0.0)
        assert state[SIGMA] == pytest.approx(s.value(e, 0.0), rel=1e-12)
        assert s.slope(e, top, 0.0) == pytest.approx(-gain * np.tanh(s.value(e, 0.0) / layer), rel=1e-10, abs=1e-9)


@pytest.mark.parametrize("n", [2, 3])
def test_the_papers_baseline(n: int) -> None:
    beta, power, gain, layer = (4.0, 3.0)[: n - 1], (1.5, 1.25)[: n - 1], 50.0, 5.0
    gains = ntsmc.NtsmcGains(beta, power, gain, layer, 1e-9).vector()
    surface = E + sum((sig(derivative(i + 1), power[i]) / beta[i] for i in range(n - 1)), sp.Integer(0))
    s = Surface(n, lambda _: surface, sp.Integer(0))
    for e, _ in states(n, 5):
        top, state = demand(ntsmc.ntsmc_step, gains, e, 0.0)
        assert state[SIGMA] == pytest.approx(s.value(e, 0.0), rel=1e-12)
        factor = power[-1] / beta[-1] * abs(e[-1]) ** (power[-1] - 1.0)
        expected = -factor * gain * np.tanh(s.value(e, 0.0) / layer)
        assert s.slope(e, top, 0.0) == pytest.approx(expected, rel=1e-10, abs=1e-9)


@pytest.mark.parametrize("integral", [True, False])
@pytest.mark.parametrize("n", [1, *ORDERS])
def test_poles_lie_where_they_were_placed(n: int, integral: bool) -> None:
    gains = pole_placement.PolePlacementGains(n, 7.0, integral).vector()
    size = n + integral
    matrix = np.zeros((size, size))  # of the integral, then e and its derivatives
    for column in range(size):
        unit = np.eye(size)[column]
        e, held = (unit[1:], unit[0]) if integral else (unit, 0.0)
        top, _ = demand(pole_placement.pole_placement_step, gains, e.copy(), float(held))
        matrix[:-1, column] = (np.eye(size, k=1) @ unit)[:-1]
        matrix[-1, column] = top
    coefficients = np.poly(matrix)
    np.testing.assert_allclose(coefficients, np.poly(np.full(size, -7.0)), rtol=1e-9)
