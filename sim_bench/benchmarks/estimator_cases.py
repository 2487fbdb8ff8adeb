"""What `hil benchmark estimators` runs: the cylinder with its four states, and with seven parameters beside them."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import SRUKF, Model
from servohil.estimators.models import cylinder
from servohil.estimators.models.cylinder import signed_sqrt
from servohil.estimators.sigma_point.sigma_points import Weights, scaled_weights
from servohil.sim_bench.noise_scenarios import (
    DT_S,
    P0,
    PARAMETERS,
    SCENARIOS,
    SUPPLY_PA,
    TANK_PA,
    X0,
    X_START,
    filter_model,
    simulate,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

PA_PER_MPA: Final = 1e6
MPA_PER_PA: Final = 1e-6
LOAD_N: Final = 1e3  # per unit of the state, so that all of them are of order one
LEAK: Final = 1e-5  # m3/(s MPa) per unit
PARAMETER_STD: Final = 0.1
PARAMETER_WALK: Final = 1e-5  # per step


@dataclass(frozen=True)
class Case:
    """One filter problem: the model with its noise, and data."""

    model: Model
    x0: Vector  # (n,)
    p0: Matrix  # (n, n)
    q: Matrix  # (n, n) per step
    r: Matrix  # (m, m)
    inputs: Matrix  # (N, n_u)
    samples: Matrix  # (N, m)

    @property
    def weights(self) -> Weights:
        """Of alpha = 1, beta = 2, kappa = 0."""
        return scaled_weights(self.model.n, 1.0, 2.0, 0.0)

    def filter(self) -> SRUKF:
        """Ours, at its start."""
        return SRUKF(self.model, self.x0, self.p0, self.q, self.r)


SCENARIO: Final = next(scenario for scenario in SCENARIOS if scenario.name == "physical-constant")


def four_states(steps: int) -> Case:
    """x, v, p1, p2 from x, p1, p2 (n = 4, m = 3)."""
    inputs, samples, _ = simulate(SCENARIO, steps, seed=0)
    return Case(filter_model(SCENARIO), X0, P0, np.diag(SCENARIO.q), np.diag(SCENARIO.r), inputs, samples)


def one_step() -> Case:
    """`four_states` for a single step, without the simulation, which would have to be compiled as well."""
    inputs, samples = np.array([[0.0, SUPPLY_PA, TANK_PA]]), X_START[None, [0, 2, 3]]
    return Case(filter_model(SCENARIO), X0, P0, np.diag(SCENARIO.q), np.diag(SCENARIO.r), inputs, samples)


def eleven_states(steps: int) -> Case:
    """The same with gain, friction, stiffness, load and three leaks as random walks (n = 11, m = 3)."""
    four = four_states(steps)
    model = Model(f_with_parameters, cylinder.h, 11, 3, PARAMETERS.vector(), DT_S, n_u=cylinder.N_INPUTS)
    x0 = np.concatenate([four.x0, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
    p0, q = (np.diag(np.full(11, std**2)) for std in (PARAMETER_STD, PARAMETER_WALK))
    p0[:4, :4], q[:4, :4] = four.p0, four.q
    return Case(model, x0, p0, q, four.r, four.inputs, four.samples)


def f_with_parameters(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """`cylinder.f` with x[4:7] as factors of valve gain, friction and bulk modulus, x[7] adding to the load force, and
    x[8:] to the leak coefficients; what f of `srukf_peer.c` computes."""
    position = min(max(x[0], 0.0), p[cylinder.STROKE])
    supply, tank, ambient = u[1] * MPA_PER_PA, u[2] * MPA_PER_PA, p[cylinder.AMBIENT] * MPA_PER_PA
    gain = p[cylinder.CS] * 1e3 * x[4]
    friction = p[cylinder.FRICTION] * x[5]
    bulk = p[cylinder.BULK] * MPA_PER_PA * x[6]
    load = p[cylinder.LOAD] + LOAD_N * x[7]
    internal = (p[cylinder.K_I] * PA_PER_MPA + LEAK * x[8]) * (x[2] - x[3])
    external_a = (p[cylinder.K_EA] * PA_PER_MPA + LEAK * x[9]) * (x[2] - ambient)
    external_b = (p[cylinder.K_EB] * PA_PER_MPA + LEAK * x[10]) * (x[3] - ambient)
    if u[0] >= 0.0:
        flow_a = gain * u[0] * signed_sqrt(supply - x[2])
        flow_b = gain * u[0] * signed_sqrt(x[3] - tank)
    else:
        flow_a = gain * u[0] * signed_sqrt(x[2] - tank)
        flow_b = gain * u[0] * signed_sqrt(supply - x[3])
    volume_a = p[cylinder.AREA_A] * position + p[cylinder.V0_A]
    volume_b = p[cylinder.AREA_B] * (p[cylinder.STROKE] - position) + p[cylinder.V0_B]
    force = (p[cylinder.AREA_A] * x[2] - p[cylinder.AREA_B] * x[3]) * PA_PER_MPA
    dx[0] = x[1]
    dx[1] = (force - friction * x[1] - load) / p[cylinder.MASS]
    dx[2] = bulk / volume_a * (flow_a - p[cylinder.AREA_A] * x[1] - internal - external_a)
    dx[3] = bulk / volume_b * (-flow_b + p[cylinder.AREA_B] * x[1] + internal - external_b)
    for i in range(4, 11):
        dx[i] = 0.0
