"""A cylinder under control, leaking and drifting, with the diagnosis beside it: one compiled loop, hours in minutes.

The same pieces as the bench: the plant's equations, its noise, sensors quantised as the DBC says, the control law on
the estimate of a filter that knows the configuration, and the diagnosis. Only frames, gate and operator are left out.
"""

from typing import Any, Final

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from servohil.control.laws.intsmc import intsmc_step
from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.diagnosis_step import STEP_TYPE as DIAGNOSIS_STEP
from servohil.estimators.models import cylinder
from servohil.estimators.models.cylinder import BULK, CS, FRICTION
from servohil.estimators.trajectory import STEP_TYPE as FILTER_STEP
from servohil.sim_bench.plants import cylinder as truth

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_f = njit(nogil=True, cache=True, error_model="numpy")(truth.f)
GAIN, BULK_DRIFT, FRICTION_DRIFT, SUPPLY_DRIFT, NULL_DRIFT, N_DRIFTS = range(6)
POSITION_STEP_M, PRESSURE_STEP_PA, VOLTAGE_STEP_V = 1e-6, 1e3, 1e-3  # what a bit of the DBC is worth
N_TRUTH: Final = 25
# What a fault moves: a parameter of the plant (its index), or one of these.
NULL_V, SUPPLY_PA, SENSOR_A_PA, SENSOR_B_PA = range(100, 104)
# Columns of the log: ratio, mode, verdict, amounts in the model, then these.
ERROR_M, PRESSURE_A, PRESSURE_B, MEASURED_U = range(3 + at.C, 7 + at.C)
MEASURED_Y: Final = MEASURED_U + 3
LOG_COLUMNS: Final = MEASURED_Y + 3
_VECTOR: Final = types.float64[::1]
_ROWS: Final = types.float64[:, ::1]
# Spelt out, so that what is compiled is found on disk again: the type of a filter's step would be a new one each time.
SIGNATURE: Final = types.void(
    types.int64, *[_VECTOR] * 7, _ROWS, *[_VECTOR] * 3, types.npy_rng, FILTER_STEP, *[_VECTOR] * 2, DIAGNOSIS_STEP,
    *[_VECTOR] * 5, *[_ROWS] * 2,
)  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy")
def _quantised(value: float, step_size: float) -> float:
    return float(np.rint(value / step_size) * step_size)


@njit(nogil=True, cache=True, error_model="numpy")
def _advance(x: Vector, u: Vector, p: Vector, dt: float, k: Matrix) -> None:
    for stage in range(4):
        reach = 0.0 if stage == 0 else (dt if stage == 3 else 0.5 * dt)
        for i in range(4):
            k[4, i] = x[i] + (reach * k[stage - 1, i] if stage > 0 else 0.0)
        _f(k[4], u, p, k[stage])
    for i in range(4):
        x[i] += dt / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@njit(SIGNATURE, nogil=True, cache=True, error_model="numpy")
def run(
    steps: int, clock: Vector, x: Vector, command: Vector, law_state: Vector, gains: Vector, configured: Vector,
    plant: Vector, drifts: Matrix, fault: Vector, motion: Vector, noise: Vector, rng: Any, filter_step: Any,
    filter_arena: Vector, filter_work: Vector, diagnosis_step: Any, arena: Vector, work: Vector, settings: Vector,
    twin: Vector, twin_work: Vector, table: Matrix, log: Matrix,
) -> None:  # fmt: skip
    """Go on for so many steps of 1 ms.

    Args:
        steps: how many.
        clock: (1,) cycles so far.
        x: (4,) true state.
        command: (1,) V.
        law_state, gains: of INTSMC.
        configured: (14,) what controller and diagnosis believe.
        plant: (25,) truth before drift and fault; `noise[9]` is its null, V.
        drifts: (N_DRIFTS, 3) amplitude (share, or Pa, V), rate rad/s, phase.
        fault: what it moves, by how much, from which cycle on, over how many cycles it grows, period of going and
            coming in cycles (0: it stays).
        motion: centre m, amplitude m, rad/s.
        noise: std of velocity m/s, pressure Pa per step; of the sensors: position, A, B, supply, tank, spool; supply Pa
            at [8], null V at [9], tank Pa at [10].
        rng: np.random.Generator.
        filter_step, filter_arena, filter_work: of the control filter.
        diagnosis_step .. table: of the diagnosis.
        log: (rows, LOG_COLUMNS) filled every steps // rows; pressures are the true ones, MPa; the last six are what
            filter and diagnosis are given.
    """
    dt = 1e-3
    p = np.empty(N_TRUTH)
    u = np.empty(3)
    y = np.empty(3)
    measured_u = np.empty(3)
    stages = np.empty((5, 4))
    reference = np.empty(4)
    error = np.empty(3)
    jerk = np.empty(3)
    every = max(1, steps // log.shape[0]) if log.shape[0] > 0 else steps + 1
    for k in range(steps):
        now = clock[0]
        clock[0] += 1.0
        for i in range(N_TRUTH):
            p[i] = plant[i]
        supply = noise[8]
        null = noise[9]
        bias_a = bias_b = 0.0
        for i in range(N_DRIFTS):
            amount = drifts[i, 0] * np.sin(drifts[i, 1] * now * dt + drifts[i, 2])
            if i == GAIN:
                p[CS] *= 1.0 + amount
            elif i == BULK_DRIFT:
                p[BULK] *= 1.0 + amount
            elif i == FRICTION_DRIFT:
                p[FRICTION] *= 1.0 + amount
            elif i == SUPPLY_DRIFT:
                supply *= 1.0 + amount
            else:
                null += amount
        if fault[2] >= 0.0 and now >= fault[2]:
            grown = 1.0 if fault[3] <= 0.0 else min(1.0, (now - fault[2]) / fault[3])
            if fault[4] > 0.0 and ((now - fault[2]) % fault[4]) > 0.5 * fault[4]:
                grown = 0.0
            amount = fault[1] * grown
            what = int(fault[0])
            if what < N_TRUTH:
                p[what] += amount
            elif what == NULL_V:
                null += amount
            elif what == SUPPLY_PA:
                supply += amount
            elif what == SENSOR_A_PA:
                bias_a = amount
            else:
                bias_b = amount
        spool = command[0]
        u[0] = spool + null
        u[1] = supply
        u[2] = noise[10]
        _advance(x, u, p, 0.5 * dt, stages)
        _advance(x, u, p, 0.5 * dt, stages)
        x[1] += noise[0] * rng.standard_normal()
        x[2] += noise[1] * 1e-6 * rng.standard_normal()
        x[3] += noise[1] * 1e-6 * rng.standard_normal()
        y[0] = _quantised(x[0] + noise[2] * rng.standard_normal(), POSITION_STEP_M)
        y[1] = 1e-6 * _quantised(x[2] * 1e6 + bias_a + noise[3] * rng.standard_normal(), PRESSURE_STEP_PA)
        y[2] = 1e-6 * _quantised(x[3] * 1e6 + bias_b + noise[4] * rng.standard_normal(), PRESSURE_STEP_PA)
        measured_u[0] = _quantised(spool + noise[7] * rng.standard_normal(), VOLTAGE_STEP_V)
        measured_u[1] = _quantised(supply + noise[5] * rng.standard_normal(), PRESSURE_STEP_PA)
        measured_u[2] = _quantised(noise[10] + noise[6] * rng.standard_normal(), PRESSURE_STEP_PA)
        filter_step(filter_arena, filter_work, configured, measured_u, y)
        diagnosis_step(arena, work, settings, twin, twin_work, configured, measured_u, y, table, True)
        t = now * dt
        angle = motion[2] * t
        blend = min(1.0, t / 2.0)
        a = motion[1] * blend
        reference[0] = motion[0] + a * np.sin(angle)
        reference[1] = a * motion[2] * np.cos(angle)
        reference[2] = -a * motion[2] ** 2 * np.sin(angle)
        reference[3] = -a * motion[2] ** 3 * np.cos(angle)
        estimate = filter_arena[:4]
        cylinder.jerk_model(estimate, measured_u, configured, jerk)
        error[0] = estimate[0] - reference[0]
        error[1] = estimate[1] - reference[1]
        error[2] = cylinder.acceleration(estimate, configured) - reference[2]
        command[0] = _quantised(
            intsmc_step(
                law_state, gains, error, reference, jerk[0], jerk[1], jerk[2], max(-10.0, command[0] - 2.0),
                min(10.0, command[0] + 2.0), dt,
            ),
            VOLTAGE_STEP_V,
        )  # fmt: skip
        if log.shape[0] > 0 and (k + 1) % every == 0:
            row = (k + 1) // every - 1
            if row < log.shape[0]:
                log[row, 0] = arena[at.RATIO]
                log[row, 1] = arena[at.MODE]
                log[row, 2] = arena[at.VERDICT]
                for i in range(at.C):
                    log[row, 3 + i] = arena[at.KNOWN + i] + arena[at.THETA + i]
                log[row, ERROR_M] = x[0] - reference[0]
                log[row, PRESSURE_A] = x[2]
                log[row, PRESSURE_B] = x[3]
                for i in range(3):
                    log[row, MEASURED_U + i] = measured_u[i]
                    log[row, MEASURED_Y + i] = y[i]
