"""The cylinder under INTSMC, simulated cycle by cycle with what a real loop adds: noise, quantisation, delay, stalls.

Node and controller work as on the bus: the node measures at kT, the command computed from that sample acts from (k+1)T
to (k+2)T (with jitter: from (k+1)T +- T/2). The controller estimates the state with a square-root UKF on nominal
parameters without leakage, at the noise figures that the gains were tuned with.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from servohil.control.laws.intsmc import IntsmcGains, intsmc_step
from servohil.control.laws.law import SIGMA, STATE_SIZE, reset
from servohil.control.references import SineProfile, evaluate
from servohil.estimators import SRUKF, Model
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
SLEW_V = 2.0  # per cycle, where the gate cuts
# Poles near 80 rad/s: lambda = 80, c1 K / layer = 80, c1 r^2 + (1 + c2) r + c3 with damping 0.7.
BENCH_GAINS = IntsmcGains(
    alpha1=1.01,
    c=(120.0, 13440.0, 768000.0),
    decay_per_s=80.0,
    switching_gain=800.0,
    boundary_layer=1200.0,
    singularity_bound=0.97,
)


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
    hold_at_s: float = 1e9  # from here on the reference stands where the piston was, and the law starts afresh
    late_cycles: int = 0  # more delay than the loop is built for
    noisy: bool = True


@dataclass(frozen=True)
class Run:
    """Per cycle: time, reference (N, 4), true state (N, 4), estimate (N, 4), command, sigma, innovation in sigmas."""

    t_s: Array
    reference: Array
    truth: Array
    estimate: Array
    command_v: Array
    sigma: Array
    innovation: Array

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
    filter_ = SRUKF(
        Model(cylinder.f, cylinder.h, 4, 3, model, T, n_u=3),
        START / SI,
        np.diag([1e-3, 1e-2, 0.2, 0.2]) ** 2,
        np.diag(PROCESS_STD) ** 2,
        np.diag(MEASUREMENT_STD) ** 2,
    )
    unmeasured = np.full(3, np.nan)
    profile, law, vector = BENCH_SINE.vector(), np.zeros(STATE_SIZE), gains.vector()
    ref, e, jerk = np.zeros(4), np.zeros(3), np.zeros(3)
    n = round(scenario.duration_s / T)
    hold_at, hold_m = round(scenario.hold_at_s / T), 0.0
    stall_period = round(scenario.stall_every_s / T)
    t_s, x = np.arange(n) * T, START / SI
    log_ref, log_x, log_est = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
    log_u, log_sigma, log_innovation = np.zeros(n), np.zeros(n), np.zeros((n, 3))
    applied, waiting, missed, start_m = 0.0, 0.0, 0, START[0]
    under_way = [0.0] * scenario.late_cycles
    for k in range(n):
        if k == round(scenario.leak_at_s / T):
            plant.set_leak(scenario.leak_kind, scenario.leak)
        log_x[k] = plant.state
        reading = sensors.read(plant.state, SUPPLY_PA, TANK_PA, applied)
        y = np.round(reading[:3] / SI[[0, 2, 3]] / QUANTUM) * QUANTUM
        computed = under_way[-1] if under_way else waiting
        stalled = stall_period > 0 and k >= stall_period and k % stall_period < scenario.stall_cycles
        evaluate(profile, t_s[k], start_m, ref)
        if k == hold_at:
            hold_m = float(x[0])
            reset(law)
        if k >= hold_at:
            ref[:] = hold_m, 0.0, 0.0, 0.0
        log_ref[k] = ref
        if stalled:
            missed += 1
        else:
            for _ in range(missed):
                filter_.step(np.array([waiting, SUPPLY_PA, TANK_PA]), unmeasured)
            filter_.step(np.array([applied, reading[3], reading[4]]), y)
            x = filter_.x
            if k == 0:
                start_m = float(y[0])
                evaluate(profile, 0.0, start_m, ref)
            e[:] = x[0] - ref[0], x[1] - ref[1], acceleration(x, model) - ref[2]
            jerk_model(x, np.array([0.0, reading[3], reading[4]]), model, jerk)
            asked = intsmc_step(law, vector, e, ref, *jerk, -limit_v, limit_v, T * (1 + missed))
            computed = min(max(asked, computed - SLEW_V), computed + SLEW_V)
            missed = 0
        log_est[k], log_u[k], log_sigma[k] = x * SI, computed, law[SIGMA]
        log_innovation[k] = filter_.innovation / np.sqrt(np.diag(filter_.S))
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
    return Run(t_s, log_ref, log_x, log_est, log_u, log_sigma, log_innovation)
