"""The table of control/README.md, how AFINTSC depends on the choices in its fuzzy gain: every number computed again."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from servohil.control.fuzzy.adaptive_mu import FuzzyMu, mu_type1, mu_type2
from servohil.control.laws.fintsc import FintscGains, synergetic_step
from servohil.control.laws.law import STATE_SIZE

Array = np.ndarray
Mu = Callable[[float, float], float]
README = Path(__file__).parents[2] / "control" / "README.md"
# c, alpha1 and power as the paper prints them for its arm.
LAW = FintscGains(1.0, 1.1064, 1.2, (1.0, 10.1), 0.0, 1.0, 1e-3, 1.0).vector()
DT, STEPS = 1e-3, 10_000
FAR, NEAR, NOISE = 0.6, 0.03, 0.05
LATE = slice(STEPS // 2, None)


class Row(NamedTuple):
    settling_s: float
    disturbed_rms: float
    mu_std: float


def fuzzy(mu: Callable[..., float], footprint: float, scale: float = 1.0) -> Mu:
    return partial(mu, FuzzyMu(0.6 * scale, 1.2 * scale, footprint, 1.0).vector())


def constant(value: float) -> Mu:
    return lambda e, rate: value


ROWS: dict[str, Mu] = {
    "constant mu = 0.1": constant(0.1),
    "constant mu = 0.5": constant(0.5),
    "constant mu = 0.9": constant(0.9),
    "type 1": fuzzy(mu_type1, 0.0),
    "type 2, footprint 0.05": fuzzy(mu_type2, 0.05),
    "type 2, footprint 0.1": fuzzy(mu_type2, 0.1),
    "type 2, footprint 0.15": fuzzy(mu_type2, 0.15),
    "type 2, footprint 0.1, scales / 4": fuzzy(mu_type2, 0.1, 0.25),
    "type 2, footprint 0.1, scales x 4": fuzzy(mu_type2, 0.1, 4.0),
}


def simulate(mu_of: Mu, e0: float, noise: float = 0.0, disturbance: float = 0.0) -> tuple[Array, Array]:
    """Error and mu of e'' = u + disturbance sin 3t; the noise reaches the fuzzy inputs only."""
    state, e, reference = np.zeros(STATE_SIZE), np.array([e0, 0.0]), np.zeros(3)
    added = noise * np.random.default_rng(0).standard_normal((STEPS, 2))
    errors, mus = np.empty(STEPS), np.empty(STEPS)
    for k in range(STEPS):
        mu = mu_of(e[0] + added[k, 0], e[1] + added[k, 1])
        errors[k], mus[k] = e[0], mu
        u = synergetic_step(mu, state, LAW, e, reference, 0.0, 1.0, 1.0, -100.0, 100.0, DT)
        rate = u + disturbance * np.sin(3.0 * k * DT)
        e = np.array([e[0] + DT * (e[1] + 0.5 * DT * rate), e[1] + DT * rate])
    return errors, mus


def row(mu_of: Mu) -> Row:
    errors, _ = simulate(mu_of, FAR)
    disturbed, _ = simulate(mu_of, 0.0, disturbance=1.0)
    _, mus = simulate(mu_of, FAR, noise=NOISE)
    settled = DT * (1 + np.nonzero(np.abs(errors) > NEAR)[0][-1])
    return Row(float(settled), float(np.sqrt(np.mean(disturbed[LATE] ** 2))), float(np.std(mus[LATE])))


def printed() -> dict[str, tuple[float, ...]]:
    cells = r"\| ([\d.]+) "
    found = re.findall(rf"^\| ([^|]+?) {cells * 3}\|$", README.read_text(), re.MULTILINE)
    return {name: tuple(float(number) for number in numbers) for name, *numbers in found}


def test_the_table_has_these_rows() -> None:
    assert list(printed()) == list(ROWS)


@pytest.mark.parametrize("name", ROWS)
def test_a_row_of_the_table(name: str) -> None:
    settling_s, disturbed_rms, mu_std = row(ROWS[name])
    assert printed()[name] == pytest.approx((settling_s, disturbed_rms, mu_std), rel=0.02, abs=6e-4)
