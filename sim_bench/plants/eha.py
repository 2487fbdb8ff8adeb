"""Electro-hydrostatic actuator as truth (P2 eq. 71-76): nonlinear, linear, and the scenario of the two faults.

State x = [position m, velocity m/s, acceleration m/s2]; input u = [pump flow m3/s], or [pump speed rad/s] for `f_pump`;
output y = [position m]. The equations are those of `estimators/models/eha.py`.

P2 steps them by Euler's rule at 1 ms. Friction that grows with the square of the velocity adds 2 a1 |v| / M to the
damping, and Euler's rule diverges where the velocity stays above about 0.1 m/s. The truth takes Runge-Kutta steps of a
tenth of the sample time; `paper_model` and `linear_model` are the printed discretisations.

What the equations cannot say, in P2's print or corrected: dry friction a3 changes its sign with the velocity at once,
and the acceleration jumps by 2 a3 / M there. A model whose state is the acceleration has no place for that; it keeps
a3 where it multiplies the leakage, which is next to nothing.

P2 gives no number for either fault, only that throttles were set: the severities here are ours.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.model import Model, ModelFunction
from servohil.estimators.models import eha
from servohil.estimators.models.eha import (
    A1,
    A2,
    A3,
    AREA,
    BULK,
    DISPLACEMENT,
    LEAKAGE,
    MASS,
    N_INPUTS,
    N_OUTPUTS,
    N_STATES,
    OFFSET,
    SAMPLE_TIME_S,
    STATE_NAMES,
    STATE_UNITS,
    VOLUME,
    EhaParameters,
    smooth_sign,
)
from servohil.sim_bench.plants.simulate import Truth, simulate

Vector = NDArray[np.float64]

NORMAL: Final = EhaParameters()  # P2 table 1
# The throttle loads the second piston: all of its friction, three times. Ours.
FRICTION_FAULT: Final = replace(NORMAL, friction_quadratic=1.9767e5, friction_viscous=6.432e3, friction_dry_n=1308.0)
# The throttle joins both chambers: ten times the leakage, and of the offset that it drives. Ours.
LEAKAGE_FAULT: Final = replace(NORMAL, leakage=4.78e-11, flow_offset_m3_per_s=2.41e-5)
FAULTS: Final = {"normal": NORMAL, "friction": FRICTION_FAULT, "leakage": LEAKAGE_FAULT}
# Name and end of each phase, s (P2 section 6).
SCENARIO: Final = (("normal", 3.0), ("friction", 7.0), ("leakage", 11.0))

SUBSTEPS: Final = 10
SMOOTH_PRESSURE_PA: Final = 1e4  # the offset of eq. 74 changes its sign over this width; ours

f = eha.f
h = eha.h
linear_f = eha.linear_f

# Not cached on disk: numba would not notice an edit of the model, which is in another file.
_flow_f = njit(nogil=True, error_model="numpy")(eha.f)


@njit(nogil=True, error_model="numpy")
def friction_force(velocity: float, p: Vector) -> float:
    """(a1 v^2 + a3) sgn(v) + a2 v, N; the sign rounded off as in the model."""
    return (p[A1] * velocity * velocity + p[A3]) * smooth_sign(velocity) + p[A2] * velocity


@njit(nogil=True, error_model="numpy")
def pressure_difference(x: Vector, p: Vector) -> float:
    """Pressure across the piston, Pa, from the force balance: (M a + friction) / A."""
    return (p[MASS] * x[2] + friction_force(x[1], p)) / p[AREA]


@njit(nogil=True, error_model="numpy")
def pump_flow(speed_rad_per_s: float, pressure_pa: float, p: Vector) -> float:
    """u of eq. 74, m3/s: the flow of the pump less the offset that the pressure difference drives."""
    sign = pressure_pa / np.sqrt(pressure_pa * pressure_pa + SMOOTH_PRESSURE_PA * SMOOTH_PRESSURE_PA)
    return p[DISPLACEMENT] * speed_rad_per_s - p[OFFSET] * sign


def f_pump(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """`f` with eq. 74 in it: u (1,) is the speed of the pump in rad/s."""
    _flow_f(x, (pump_flow(u[0], pressure_difference(x, p), p),), p, dx)


@njit(nogil=True, error_model="numpy")
def energy(x: Vector, p: Vector) -> float:
    """Energy of the moving mass and of the compressed oil, J.

    Its rate is pressure x pump flow - leakage x pressure^2 - friction x velocity, except where the velocity changes
    its sign: see above.
    """
    pressure = pressure_difference(x, p)
    return 0.5 * (p[MASS] * x[1] * x[1] + p[VOLUME] / p[BULK] * pressure * pressure)


@njit(nogil=True, error_model="numpy")
def power(x: Vector, flow_m3_per_s: float, p: Vector) -> float:
    """Power put in by the pump less what leakage and friction take, W."""
    pressure = pressure_difference(x, p)
    return pressure * (flow_m3_per_s - p[LEAKAGE] * pressure) - friction_force(x[1], p) * x[1]


def nonlinear_model(parameters: EhaParameters = NORMAL, *, pump: bool = False) -> Model:
    """The truth of eq. 71-73 at P2's sample time, by Runge-Kutta; with `pump` its input is the speed of eq. 74."""
    return _model(f_pump if pump else f, parameters, "rk4", SUBSTEPS)


def paper_model(parameters: EhaParameters = NORMAL) -> Model:
    """Eq. 71-73 as P2 steps them, by Euler's rule."""
    return _model(f, parameters, "euler", 1)


def linear_model(parameters: EhaParameters = NORMAL) -> Model:
    """Eq. 75 and 76; `estimators.models.eha.linear_matrices` gives the matrices."""
    return _model(linear_f, parameters, "euler", 1)


def _model(function: ModelFunction, parameters: EhaParameters, integrator: str, substeps: int) -> Model:
    return Model(
        function, h, N_STATES, N_OUTPUTS, parameters.vector(), SAMPLE_TIME_S, integrator, substeps, N_INPUTS,
        STATE_NAMES, STATE_UNITS,
    )  # fmt: skip


def simulate_scenario(
    U: ArrayLike,
    noise_std: ArrayLike,
    seed: int,
    *,
    pump: bool = False,
    faults: Mapping[str, EhaParameters] = FAULTS,
) -> Truth:
    """The truth from rest through the phases of `SCENARIO`; a shorter input ends earlier.

    The state goes on from phase to phase, so that the pressure steps with the friction.

    Args:
        U: (N, 1) pump flow m3/s, or with `pump` its speed rad/s, at P2's sample time; N <= 11000.
        noise_std: of what is added to the state per sample: a number or (3,).
        seed: of the noise; every phase has its own stream.
        faults: the parameters of every phase of `SCENARIO`.

    Raises:
        ValueError: the input is longer than the scenario, or `simulate` refuses it.
    """
    inputs = np.asarray(U, dtype=np.float64)
    ends = [round(end_s / SAMPLE_TIME_S) for _, end_s in SCENARIO]
    if inputs.ndim != 2 or not 1 <= len(inputs) <= ends[-1]:
        raise ValueError(f"U has shape {inputs.shape}: must be (N, 1), N from 1 to {ends[-1]}")
    streams = np.random.SeedSequence(seed).generate_state(len(SCENARIO))
    parts: list[Truth] = []
    x, start = np.zeros(N_STATES), 0
    for (fault, _), end, stream in zip(SCENARIO, ends, streams, strict=True):
        part = inputs[start:end]
        if len(part):
            parts.append(simulate(nonlinear_model(faults[fault], pump=pump), x, part, noise_std, int(stream)))
            x, start = parts[-1].X[-1], end
    return Truth(np.concatenate([part.X for part in parts]), np.concatenate([part.Y for part in parts]))
