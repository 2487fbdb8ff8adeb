"""Cylinder motions under process and sensor noise of known, also changing, covariance: what adaptation is judged on.

The piston follows 0.3 + 0.15 sin(2t) m in closed loop on its true position, so that it stays within its stroke whatever
the noise. Noise is added once per step of 1 ms to the state in (m, m/s, MPa, MPa), as the papers do.
"""

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators import Model
from servohil.estimators.models import cylinder

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DT_S: Final = 1e-3
SUPPLY_PA, TANK_PA = 14e6, 0.9e6
X_START: Final = np.array([0.3, 0.3, 3.6, 5.75])  # of the plant
X0: Final = np.array([0.2, 0.0, 3.0, 5.0])  # of the filters: wrong
P0: Final = np.diag(np.square([0.1, 0.3, 1.0, 1.0]))
CHANGED_S: Final = (4.0, 16.0)  # noise is `factor` times larger in between
PARAMETERS: Final = cylinder.CylinderParameters()

_f = njit(cylinder.f, error_model="numpy")


@dataclass(frozen=True)
class NoiseScenario:
    """Variances per step outside and inside the middle of the run."""

    name: str
    title: str
    q: tuple[float, float, float, float]  # m2, (m/s)2, MPa2, MPa2
    r: tuple[float, float, float]  # m2, MPa2, MPa2
    factor: float
    position_only: bool

    def variances(self, steps: int) -> tuple[Matrix, Matrix]:
        """Diagonals of Q (steps, 4) and R (steps, 3) in every step."""
        time = np.arange(steps) * DT_S
        scale = np.where((time >= CHANGED_S[0]) & (time <= CHANGED_S[1]), self.factor, 1.0)[:, None]
        return scale * np.array(self.q), scale * np.array(self.r)


class Fault(NamedTuple):
    """Parameters of the plant from a step on, which no filter is told."""

    parameters: cylinder.CylinderParameters
    onset: int


P1_Q, P1_R = (1e-7,) * 4, (1e-5,) * 3
PHYSICAL_Q, PHYSICAL_R = (1e-12, 1e-8, 1e-6, 1e-6), (1e-8, 1e-4, 1e-4)
SCENARIOS: Final = (
    NoiseScenario("p1", "P1's schedule, x100 from 4 to 16 s; x, p1, p2", P1_Q, P1_R, 100.0, False),
    NoiseScenario("physical", "physically scaled, x10 from 4 to 16 s; x, p1, p2", PHYSICAL_Q, PHYSICAL_R, 10.0, False),
    NoiseScenario("p1-constant-x", "P1's scale, constant; x alone", P1_Q, P1_R, 1.0, True),
    NoiseScenario("physical-constant", "physically scaled, constant; x, p1, p2", PHYSICAL_Q, PHYSICAL_R, 1.0, False),
    NoiseScenario("p1-x", "P1's schedule, x100 from 4 to 16 s; x alone", P1_Q, P1_R, 100.0, True),
)


def position(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    """Output function of a cylinder with nothing but a position sensor."""
    y[0] = x[0]


def filter_model(scenario: NoiseScenario) -> Model:
    """The model that the filters get: the plant's own."""
    h, m = (position, 1) if scenario.position_only else (cylinder.h, cylinder.N_OUTPUTS)
    return Model(cylinder.f, h, cylinder.N_STATES, m, PARAMETERS.vector(), DT_S, n_u=cylinder.N_INPUTS)


@njit(cache=True, nogil=True)
def _advance(x: Vector, u: Vector, p: Vector, dt: float) -> Vector:
    k1, k2, k3, k4 = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    _f(x, u, p, k1)
    _f(x + dt / 2 * k1, u, p, k2)
    _f(x + dt / 2 * k2, u, p, k3)
    _f(x + dt * k3, u, p, k4)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@njit(cache=True, nogil=True)
def _simulate(seed: int, q: Matrix, r: Matrix, before: Vector, after: Vector, onset: int, start: Vector) -> Any:
    np.random.seed(seed)
    steps = q.shape[0]
    inputs, samples, states = np.empty((steps, 3)), np.empty((steps, 3)), np.empty((steps, 4))
    x = start.copy()
    u = np.array([0.0, SUPPLY_PA, TANK_PA])
    supply = SUPPLY_PA / 1e6
    for k in range(steps):
        t = k * DT_S
        p = before if k < onset else after
        speed = 0.3 * np.cos(2 * t) + 4.0 * (0.3 + 0.15 * np.sin(2 * t) - x[0])
        drop, area = (supply - x[2], p[2]) if speed >= 0 else (supply - x[3], p[3])
        u[0] = min(max(speed * area / (2.36e-5 * np.sqrt(max(drop, 0.5))), -10.0), 10.0)
        x = _advance(x, u, p, DT_S)
        for i in range(4):
            x[i] += np.sqrt(q[k, i]) * np.random.normal()
        inputs[k] = u
        states[k] = x
        samples[k, 0] = x[0] + np.sqrt(r[k, 0]) * np.random.normal()
        samples[k, 1] = x[2] + np.sqrt(r[k, 1]) * np.random.normal()
        samples[k, 2] = x[3] + np.sqrt(r[k, 2]) * np.random.normal()
    return inputs, samples, states


def simulate(
    scenario: NoiseScenario, steps: int, seed: int, loss: float = 0.0, fault: Fault | None = None
) -> tuple[Matrix, Matrix, Matrix]:
    """Inputs (steps, 3), samples (steps, 1 or 3) with NaN where lost, true states (steps, 4).

    Args:
        loss: share of the samples lost at random, all channels of a step at once, as with one lost packet.
        fault: what the plant becomes; the noise of a seed is the same with and without.
    """
    q, r = scenario.variances(steps)
    after, onset = (PARAMETERS, steps) if fault is None else fault
    inputs, samples, states = _simulate(seed, q, r, PARAMETERS.vector(), after.vector(), onset, X_START)
    if scenario.position_only:
        samples = samples[:, :1].copy()
    if loss > 0.0:
        samples[np.random.default_rng(seed).random(steps) < loss] = np.nan
    return inputs, samples, states
