"""The cylinder under INTSMC, simulated cycle by cycle with what a real loop adds: noise, quantisation, delay, stalls.

Node and controller work as on the bus: the node measures at kT, the command computed from that sample acts from (k+1)T to
(k+2)T (with jitter: from (k+1)T +- T/2). The controller estimates the state with an extended Kalman filter of its own
parameters, without leakage, at the noise figures of rigs/bench.toml.
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.intsmc import INTSMC_STATE_SIZE, SIGMA, IntsmcGains, intsmc_step
from servohil.control.reference import SineProfile, evaluate
from servohil.estimators.models import cylinder
from servohil.estimators.models.cylinder import CylinderParameters, acceleration, jerk_model
from servohil.sim_bench.plant import CylinderPlant
from servohil.sim_bench.sensors import Sensors, SensorStd

Array = NDArray[np.float64]

T = 1e-3
SUPPLY_PA, TANK_PA = 14e6, 0.9e6
START = np.array([0.18, 0.0, 26.7e5, 50.6e5])
SI = np.array([1.0, 1.0, 1e6, 1e6])
QUANTUM = np.array([1e-6, 1e-3, 1e-3])  # m, MPa, MPa
PROCESS_STD = np.array([1e-6, 1e-4, 0.02, 0.02])  # of the filter, per cycle; m, m/s, MPa, MPa
MEASUREMENT_STD = np.array([20e-6, 0.02, 0.02])
PLANT_PROCESS_STD = np.array([0.0, 1e-5, 500.0, 500.0])
BENCH_SINE = SineProfile(0.3, 0.15, 2.0, blend_s=2.0)
JITTER_PARTS = 10

_f = njit(cache=True)(cylinder.f)


@njit(cache=True)
def predict(x: Array, u: Array, p: Array, dt: float) -> Array:
    """One RK4 step of the model."""
    k1, k2, k3, k4 = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    _f(x, u, p, k1)
    _f(x + 0.5 * dt * k1, u, p, k2)
    _f(x + 0.5 * dt * k2, u, p, k3)
    _f(x + dt * k3, u, p, k4)
    return x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


@njit(cache=True)
def ekf_predict(x: Array, P: Array, u: Array, p: Array, Q: Array, dt: float) -> None:
    """Time update in place; the Jacobian by central differences."""
    step = np.array([1e-6, 1e-6, 1e-5, 1e-5])
    F = np.empty((4, 4))
    for i in range(4):
        moved = np.zeros(4)
        moved[i] = step[i]
        F[:, i] = (predict(x + moved, u, p, dt) - predict(x - moved, u, p, dt)) / (2.0 * step[i])
    x[:] = predict(x, u, p, dt)
    P[:] = F @ P @ F.T + Q


@njit(cache=True)
def ekf_correct(x: Array, P: Array, y: Array, R: Array) -> None:
    """Measurement update in place with position and both pressures."""
    rows = np.array([0, 2, 3])
    S = R.copy()
    for i in range(3):
        for j in range(3):
            S[i, j] += P[rows[i], rows[j]]
    C = np.empty((4, 3))
    for i in range(3):
        C[:, i] = P[:, rows[i]]
    K = C @ np.linalg.inv(S)
    x += K @ (y - x[rows])
    P -= K @ S @ K.T
    P[:] = 0.5 * (P + P.T)


@dataclass(frozen=True)
class Scenario:
    """What differs from the undisturbed bench."""

    duration_s: float = 8.0
    seed: int = 1
    truth: CylinderParameters = field(default_factory=CylinderParameters)
    leak_kind: str = "internal"
    leak: float = 0.0  # m3/(s Pa), from leak_at_s on
    leak_at_s: float = 12.0
    jitter: bool = False
    stall_every_s: float = 0.0  # 0: none
    stall_cycles: int = 5
    predict_ahead: bool = False
    late_cycles: int = 0  # more delay than the loop is built for
    noisy: bool = True
    process_std: tuple[float, ...] = tuple(PROCESS_STD)


@dataclass(frozen=True)
class Run:
    """Per cycle: time, reference (N, 4), true state (N, 4), estimate (N, 4), command, sigma."""

    t_s: Array
    reference: Array
    truth: Array
    estimate: Array
    command_v: Array
    sigma: Array

    def error_m(self, from_s: float = 3.0, to_s: float = 1e9) -> Array:
        """True position minus reference of the same moment."""
        part = (self.t_s >= from_s) & (self.t_s < to_s)
        return np.asarray(self.truth[part, 0] - self.reference[part, 0])

    def rmse_m(self, from_s: float = 3.0, to_s: float = 1e9) -> float:
        return float(np.sqrt(np.mean(self.error_m(from_s, to_s) ** 2)))

    def chatter_v(self, from_s: float = 3.0) -> float:
        """Mean change of the command per cycle."""
        return float(np.mean(np.abs(np.diff(self.command_v[self.t_s >= from_s]))))


def simulate(gains: IntsmcGains, scenario: Scenario, limit_v: float = 10.0) -> Run:
    """Run the loop from the bench's start position, entering the bench's sine."""
    rng = np.random.default_rng(scenario.seed)
    plant = CylinderPlant(scenario.truth, START, SUPPLY_PA, TANK_PA, PLANT_PROCESS_STD * scenario.noisy, 10)
    if scenario.jitter:
        plant = CylinderPlant(scenario.truth, START, SUPPLY_PA, TANK_PA, PLANT_PROCESS_STD * scenario.noisy, 1)
    std = SensorStd() if scenario.noisy else SensorStd(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    sensors = Sensors(std, rng)
    model = CylinderParameters().vector()
    x = START / SI
    P = np.diag([1e-3, 1e-2, 0.2, 0.2]) ** 2
    Q = np.diag(scenario.process_std) ** 2
    R = np.diag(MEASUREMENT_STD) ** 2
    profile, law, vector = BENCH_SINE.vector(), np.zeros(INTSMC_STATE_SIZE), gains.vector()
    ref, e, jerk = np.zeros(4), np.zeros(3), np.zeros(3)
    n = round(scenario.duration_s / T)
    stall_period = round(scenario.stall_every_s / T)
    t_s = np.arange(n) * T
    log_ref, log_x, log_est = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
    log_u, log_sigma = np.zeros(n), np.zeros(n)
    applied, waiting, missed, start_m = 0.0, 0.0, 0, START[0]
    under_way = [0.0] * scenario.late_cycles
    for k in range(n):
        if k == round(scenario.leak_at_s / T):
            plant.set_leak(scenario.leak_kind, scenario.leak)
        log_x[k] = plant.state
        reading = sensors.read(plant.state, SUPPLY_PA, TANK_PA, applied)
        y = np.round(reading[:3] / SI[[0, 2, 3]] / QUANTUM) * QUANTUM * 1.0
        computed = under_way[-1] if under_way else waiting
        stalled = stall_period > 0 and k >= stall_period and k % stall_period < scenario.stall_cycles
        evaluate(profile, t_s[k], start_m, ref)
        log_ref[k] = ref
        if stalled:
            missed += 1
        else:
            if k > 0:
                for _ in range(missed):
                    ekf_predict(x, P, np.array([waiting, SUPPLY_PA, TANK_PA]), model, Q, T)
                ekf_predict(x, P, np.array([applied, SUPPLY_PA, TANK_PA]), model, Q, T)
            ekf_correct(x, P, y, R)
            if k == 0:
                start_m = float(y[0])
                evaluate(profile, 0.0, start_m, ref)
            at, supplies = x, np.array([reading[3], reading[4]])
            if scenario.predict_ahead:
                at = predict(x, np.array([waiting, *supplies]), model, T)
                evaluate(profile, t_s[k] + T, start_m, ref)
            e[:] = at[0] - ref[0], at[1] - ref[1], acceleration(at, model) - ref[2]
            jerk_model(at, np.array([0.0, *supplies]), model, jerk)
            computed = intsmc_step(law, vector, e, ref[3], jerk[0], jerk[1], jerk[2], limit_v, T * (1 + missed))
            missed = 0
        log_est[k], log_u[k], log_sigma[k] = x * SI, computed, law[SIGMA]
        # over [kT, (k+1)T] acts what was computed one cycle ago
        if scenario.jitter:
            switch = int(rng.integers(-JITTER_PARTS // 2, JITTER_PARTS // 2 + 1))
            for part in range(JITTER_PARTS):
                early = switch < 0 and part >= JITTER_PARTS + switch
                late = switch > 0 and part < switch
                value = computed if early else applied if late else waiting
                plant.step(value, rng.standard_normal(4), T / JITTER_PARTS)
        else:
            plant.step(waiting, rng.standard_normal(4), T)
        under_way.append(computed)
        applied, waiting = waiting, under_way.pop(0)
    return Run(t_s, log_ref, log_x, log_est, log_u, log_sigma)
