"""Closed loops of P3's controllers around its plants: a whole simulation in one compiled function per plant.

The laws are those of `control.laws`, one step per sample, and the plant moves by Runge-Kutta steps under the held
command. As in P3 the controller knows the whole state. The arm has computed torque: each joint's law says which
acceleration it wants (f = 0, b = 1), and the torques are those that the model D th'' + C + g needs for it.

Nothing here is cached on disk: numba would not notice an edit of a law, which is in another file.
"""

from math import cos, sin
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.fuzzy.adaptive_mu import mu_type1, mu_type2
from servohil.control.laws.fintsc import C1, fintsc_step, synergetic_step
from servohil.control.laws.integral_terminal import integral_terminal_step
from servohil.control.laws.intsmc import intsmc_step
from servohil.control.laws.law import SIGMA, STATE_SIZE
from servohil.control.laws.ntsmc import ntsmc_step
from servohil.estimators.models import cylinder
from servohil.estimators.models.cylinder import LOAD, MASS, acceleration, jerk_model
from servohil.sim_bench.plants.two_link_arm import GRAVITY, LENGTH_1, LENGTH_2, MASS_1, MASS_2, accelerations

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

INTSMC, NTSMC, INTEGRAL_TERMINAL, FINTSC, AFINTSC = range(5)
NO_LIMIT: Final = 1e6  # Nm: the papers' motors have none
VALVE_V: Final = 10.0
# Columns of what `run_arm` and `run_cylinder` fill.
ANGLES, TORQUES, SURFACES, ARM_COLUMNS = slice(0, 2), slice(2, 4), slice(4, 6), 6
POSITION, VELOCITY, ACCELERATION, VALVE, SURFACE, PRESSURE_A, PRESSURE_B, CYLINDER_COLUMNS = range(8)

_cylinder_f = njit(nogil=True, error_model="numpy")(cylinder.f)


class Controller(NamedTuple):
    """A law with its gains, and what it has to stand.

    Attributes:
        law: one of INTSMC .. AFINTSC.
        gains: `vector()` of its gains.
        disturbance: factor of the run's disturbance.
        noise: factor of the run's noise on the inputs of the fuzzy system, which the law itself never sees.
    """

    law: int
    gains: Vector
    disturbance: float = 1.0
    noise: float = 0.0


@njit(nogil=True, error_model="numpy")
def command(
    law: int, state: Vector, gains: Vector, e: Vector, reference: Vector, noise: Vector, plant: Vector, limit: float,
    dt: float,
) -> float:  # fmt: skip
    """One step of a law, see `control.laws.law`; `noise` (2,) is on the fuzzy inputs, `plant` is f and b on both
    sides."""
    f, extend, retract = plant[0], plant[1], plant[2]
    if law == INTSMC:
        return float(intsmc_step(state, gains, e, reference, f, extend, retract, -limit, limit, dt))
    if law == NTSMC:
        return float(ntsmc_step(state, gains, e, reference, f, extend, retract, -limit, limit, dt))
    if law == INTEGRAL_TERMINAL:
        return float(integral_terminal_step(state, gains, e, reference, f, extend, retract, -limit, limit, dt))
    if law == FINTSC:
        return float(fintsc_step(state, gains, e, reference, f, extend, retract, -limit, limit, dt))
    fuzzy, one, other = gains[C1 + e.size :], e[0] + noise[0], e[1] + noise[1]
    mu = mu_type1(fuzzy, one, other) if gains[gains.size - 1] == 1.0 else mu_type2(fuzzy, one, other)
    return float(synergetic_step(mu, state, gains, e, reference, f, extend, retract, -limit, limit, dt))


@njit(nogil=True, error_model="numpy")
def torques(x: Vector, wanted: Vector, p: Vector, out: Vector) -> None:
    """Fill out (2,) with the torques that give the arm the wanted accelerations: the inverse of `accelerations`."""
    m2, l1, l2 = p[MASS_2], p[LENGTH_1], p[LENGTH_2]
    both = p[MASS_1] + m2
    coupling = m2 * l1 * l2 * cos(x[1])
    swing = m2 * l1 * l2 * sin(x[1])
    d22 = m2 * l2 * l2
    d12 = d22 + coupling
    weight_2 = m2 * p[GRAVITY] * l2 * cos(x[0] + x[1])
    out[0] = (both * l1 * l1 + d22 + 2.0 * coupling) * wanted[0] + d12 * wanted[1]
    out[0] += both * p[GRAVITY] * l1 * cos(x[0]) + weight_2 - swing * (2.0 * x[2] * x[3] + x[3] * x[3])
    out[1] = d12 * wanted[0] + d22 * wanted[1] + swing * x[2] * x[2] + weight_2


@njit(nogil=True, error_model="numpy")
def arm_step(x: Vector, torque: Vector, p: Vector, disturbance: Vector, dt: float, work: Matrix) -> None:
    """Move x (4,) by a Runge-Kutta step under held torques (2,), with `disturbance` (2,) added to the accelerations;
    `work` is (5, 4)."""
    for stage in range(4):
        now = work[4]
        part = 0.0 if stage == 0 else (dt if stage == 3 else 0.5 * dt)
        for i in range(4):
            now[i] = x[i] + (part * work[stage - 1, i] if stage > 0 else 0.0)
        first, second = accelerations(now, torque, p)
        work[stage, 0], work[stage, 1] = now[2], now[3]
        work[stage, 2], work[stage, 3] = first + disturbance[0], second + disturbance[1]
    for i in range(4):
        x[i] += dt / 6.0 * (work[0, i] + 2.0 * work[1, i] + 2.0 * work[2, i] + work[3, i])


@njit(nogil=True, error_model="numpy")
def run_arm(
    law: int, gains: Vector, p: Vector, x0: Vector, reference: NDArray[np.float64], disturbance: Matrix, noise: Matrix,
    dt: float, out: Matrix,
) -> None:  # fmt: skip
    """The arm under one law with the same gains at both joints.

    Args:
        law, gains: see `Controller`.
        p: (5,) of plant and controller.
        x0: (4,) start.
        reference: (N, 2, 3) of each joint: angle, speed, acceleration.
        disturbance: (N, 2) added to the accelerations, rad/s2.
        noise: (N, 4) on the fuzzy inputs: error and its rate of joint 1, of joint 2.
        dt: s.
        out: (N, ARM_COLUMNS) filled with angles, torques and sliding variables at every sample.
    """
    x, work, torque, wanted = x0.copy(), np.zeros((5, 4)), np.zeros(2), np.zeros(2)
    states, e, plant = np.zeros((2, STATE_SIZE)), np.zeros(2), np.array([0.0, 1.0, 1.0])
    for k in range(out.shape[0]):
        for j in range(2):
            e[0], e[1] = x[j] - reference[k, j, 0], x[2 + j] - reference[k, j, 1]
            heard = noise[k, 2 * j : 2 * j + 2]
            wanted[j] = command(law, states[j], gains, e, reference[k, j], heard, plant, NO_LIMIT, dt)
            out[k, j] = x[j]
            out[k, 4 + j] = states[j, SIGMA]
        torques(x, wanted, p, torque)
        out[k, 2], out[k, 3] = torque[0], torque[1]
        arm_step(x, torque, p, disturbance[k], dt, work)


@njit(nogil=True, error_model="numpy")
def cylinder_step(x: Vector, u: Vector, p: Vector, dt: float, work: Matrix) -> None:
    """Move x (4,) by one Runge-Kutta step under a held command u (3,); `work` is (5, 4)."""
    for stage in range(4):
        now = work[4]
        part = 0.0 if stage == 0 else (dt if stage == 3 else 0.5 * dt)
        for i in range(4):
            now[i] = x[i] + (part * work[stage - 1, i] if stage > 0 else 0.0)
        _cylinder_f(now, u, p, work[stage])
    for i in range(4):
        x[i] += dt / 6.0 * (work[0, i] + 2.0 * work[1, i] + 2.0 * work[2, i] + work[3, i])


@njit(nogil=True, error_model="numpy")
def run_cylinder(
    law: int, gains: Vector, model: Vector, mass_kg: float, x0: Vector, supply: Vector, reference: Matrix,
    pushed: Vector, noise: Matrix, dt: float, out: Matrix,
) -> None:  # fmt: skip
    """The cylinder under one law, which has f and b from the true pressures and the model's mass.

    Args:
        law, gains: see `Controller`.
        model: (14,) the controller's `CylinderParameters.vector()`; the plant's too, but for the mass.
        mass_kg: of the plant.
        x0: (4,) start.
        supply: (2,) supply and tank pressure, Pa.
        reference: (N, 4) position and its derivatives.
        pushed: (N,) what the disturbance adds to the acceleration, m/s2: the integral of P3's d, added to x'''.
        noise: (N, 2) on the fuzzy inputs.
        dt: s.
        out: (N, CYLINDER_COLUMNS) filled with position, velocity, acceleration, command, sliding variable and both
            pressures in MPa at every sample.
    """
    x, u, p, work = x0.copy(), np.array([0.0, supply[0], supply[1]]), model.copy(), np.zeros((5, 4))
    p[MASS] = mass_kg
    state, e, plant = np.zeros(STATE_SIZE), np.zeros(3), np.zeros(3)
    for k in range(out.shape[0]):
        p[LOAD] = -mass_kg * pushed[k]
        true_acceleration = acceleration(x, p)
        e[0], e[1] = x[0] - reference[k, 0], x[1] - reference[k, 1]
        e[2] = true_acceleration - reference[k, 2]
        jerk_model(x, u, model, plant)
        u[0] = command(law, state, gains, e, reference[k], noise[k], plant, VALVE_V, dt)
        out[k, POSITION], out[k, VELOCITY], out[k, ACCELERATION] = x[0], x[1], true_acceleration
        out[k, VALVE], out[k, SURFACE] = u[0], state[SIGMA]
        out[k, PRESSURE_A], out[k, PRESSURE_B] = x[2], x[3]
        cylinder_step(x, u, p, dt, work)
