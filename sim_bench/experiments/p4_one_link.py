"""P4 section 4.1: the one-link arm is held still and its friction and mass change meanwhile (figures 3 and 4)."""

from collections.abc import Callable
from functools import cache
from math import atan, cos, pi, sin
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from servohil.estimators import JointSRUKF, Model, SensitivitySRUKF
from servohil.estimators.filter import Filter
from servohil.sim_bench.experiments.experiment import Data, Experiment, Metric, PaperClaim, Results
from servohil.sim_bench.plants import one_link_arm
from servohil.sim_bench.plants.one_link_arm import (
    COULOMB,
    GRAVITY,
    INVERSE_INERTIA,
    MASS_LENGTH,
    SLOPE,
    VISCOUS,
    OneLinkArmParameters,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DT_S: Final = one_link_arm.SAMPLE_TIME_S
STEPS: Final = 60_000
HOLD_FROM, HOLD_UNTIL = 20_000, 35_000
EVERY: Final = 50
ESTIMATED: Final = (INVERSE_INERTIA, VISCOUS, COULOMB, MASS_LENGTH)
STATES: Final = ("1/J", "mu_v", "mu_d", "m l")
TRUE: Final = OneLinkArmParameters().vector()
AFTER: Final = TRUE * [1.0, 4.0, 4.0, 4.0, 1.0, 1.0]  # P4: quadrupled when the arm is held
WRONG: Final = TRUE * [1.5, 3.0, 8.0, 0.25, 1.0, 1.0]  # P4's start
Q_STD: Final = np.sqrt([1e-11, 5e-5])
R_STD: Final = np.sqrt([5e-7, 5.0])
SENSITIVE, FREE, JOINT = "SB-aSRUKF", "aSRUKF without the gate", "joint SR-UKF"


@njit(cache=True, nogil=True)
def _drive(before: Vector, after: Vector, noise: Matrix, inputs: Matrix, samples: Matrix) -> None:
    """-pi/2 .. pi/2 and back in 2 s under a loop around the true angle; held at pi/2 in between."""
    angle, speed, clock = pi / 2, 0.0, 0.0
    for k in range(inputs.shape[0]):
        p = after if k >= HOLD_FROM else before
        moving = k < HOLD_FROM or k >= HOLD_UNTIL
        if moving:
            clock += DT_S
        wanted = pi / 2 * cos(pi * clock)
        rate = -pi * pi / 2 * sin(pi * clock) if moving else 0.0
        torque = 6.0 * (rate + 20.0 * (wanted - angle) - speed) + 0.5 * p[MASS_LENGTH] * p[GRAVITY] * sin(angle)
        friction = p[VISCOUS] * speed + p[COULOMB] * atan(p[SLOPE] * speed)
        slope = p[INVERSE_INERTIA] * (torque - friction - 0.5 * p[MASS_LENGTH] * p[GRAVITY] * sin(angle))
        angle, speed = angle + DT_S * speed + noise[k, 0], speed + DT_S * slope + noise[k, 1]
        friction = p[VISCOUS] * speed + p[COULOMB] * atan(p[SLOPE] * speed)
        slope = p[INVERSE_INERTIA] * (torque - friction - 0.5 * p[MASS_LENGTH] * p[GRAVITY] * sin(angle))
        inputs[k, 0] = torque
        samples[k, 0] = angle + noise[k, 2]
        samples[k, 1] = slope + noise[k, 3]


def data(rng: np.random.Generator) -> Data:
    """4 s of motion, held for 3 s with everything but 1/J four times as large from then on, 5 s of motion."""
    noise = rng.standard_normal((STEPS, 4)) * np.concatenate([Q_STD, R_STD])
    inputs, samples = np.empty((STEPS, 1)), np.empty((STEPS, 2))
    _drive(TRUE, AFTER, noise, inputs, samples)
    parameters = np.where(np.arange(STEPS)[:, None] < HOLD_FROM, TRUE[list(ESTIMATED)], AFTER[list(ESTIMATED)])
    return Data(inputs, samples, parameters, np.zeros((STEPS, 1)), np.zeros((STEPS, 1)))


@cache
def model() -> Model:
    """The arm with the wrong parameters that all filters start from, by Euler's rule as in P4."""
    return Model(one_link_arm.f, one_link_arm.h, 2, 2, WRONG, DT_S, integrator="euler")


X0: Final = np.array([pi / 2, 0.0])
P0: Final = 0.01 * np.eye(2)
Q0, R0 = np.diag([2e-8, 5e-5]), np.diag([5e-7, 20.0])
VARIANCES: Final = [2.0, 1.0]  # standard deviations of the logarithms of Q[0, 0] and R[1, 1]
# 1/J is excited by the noise that the controller follows, also while the arm is held; friction must be free before it.
THRESHOLD: Final = (0.5, 0.1, 0.25, 0.2, 0.0, 0.0)
LOWER, UPPER = [1.0, 0.0, 0.0, 0.0], [100.0, 5.0, 5.0, 5.0]


def sensitive(threshold: ArrayLike = THRESHOLD, least_excitation: float = 1.0) -> SensitivitySRUKF:
    """SB-aSRUKF: four parameters, one entry of Q and one of R."""
    return SensitivitySRUKF(
        model(), X0, P0, Q0, R0, parameters=ESTIMATED, Q_entries=(0,), R_entries=(1,), forgetting=0.9995,
        P0_parameters=np.concatenate([WRONG[list(ESTIMATED)], VARIANCES]), lower=[*LOWER, -40.0, -5.0],
        upper=[*UPPER, 0.0, 10.0], threshold=threshold, least_excitation=least_excitation,
    )  # fmt: skip


def joint() -> JointSRUKF:
    """The parameters as states that walk; Q and R as the other starts with."""
    start = WRONG[list(ESTIMATED)]
    return JointSRUKF(
        model(), X0, P0, Q0, R0, parameters=ESTIMATED, P0_parameters=np.diag(np.square(start)),
        Q_parameters=np.diag(np.square(1e-4 * start)), lower=LOWER, upper=UPPER,
    )  # fmt: skip


def parameters(one: Filter, record: Data) -> Matrix:
    """(N, 4) estimated parameters at every `EVERY`th step, and until the next one."""
    found = np.empty((STEPS, len(ESTIMATED)))
    for start in range(0, STEPS, EVERY):  # by `run`, which leaves the interpreter to others
        part = slice(start, start + EVERY)
        one.run(record.inputs[part], record.samples[part])
        found[part] = one.parameters[: len(ESTIMATED)]  # type: ignore[attr-defined]
    return found


def final_error(truth: Matrix, found: Matrix) -> Matrix:
    """(4,) error at the end in % of the truth."""
    return np.asarray(100.0 * np.abs(found[-1] - truth[-1]) / truth[-1])


def drift(truth: Matrix, found: Matrix) -> Matrix:
    """(4,) largest change while the arm is held, after its first half second, in % of the truth."""
    held = found[HOLD_FROM + 2500 : HOLD_UNTIL]
    return np.asarray(100.0 * np.abs(held - held[0]).max(axis=0) / truth[-1])


def below(limit: float, name: str, columns: slice) -> Callable[[Results], bool]:
    """Median figures of these parameters below the limit."""
    return lambda results: bool((results[name].medians[columns] < limit).all())


def drifts_more(results: Results) -> bool:
    """Both friction coefficients move more without the gate, and in the state."""
    gated = results[SENSITIVE].medians[1:3]
    return all(bool((results[name].medians[1:3] > gated).all()) for name in (FREE, JOINT))


FILTERS: Final = {
    SENSITIVE: sensitive,
    FREE: lambda: sensitive(threshold=0.0, least_excitation=0.0),
    JOINT: joint,
}
NOTES: Final = (
    "Shorter than in P4: 4 s of motion, 3 s held, 5 s of motion. Ours: the loop that moves the arm, g = 9.81, the "
    "start of the angle, P0, the initial covariance of the parameters (their start, as a standard deviation), bounds, "
    "thresholds of the gate, what the joint filter's parameters walk (1e-4 of their start per step).",
    "While the arm is held, the noise that its controller follows excites 1/J and Coulomb friction a little; P4 says "
    "so of the latter.",
)
EXPERIMENTS: Final = (
    Experiment(
        "p4-one-link", "one-link arm, friction and mass change while it is held: error at the end", "P4 figure 4",
        STATES, data, FILTERS, {},
        (PaperClaim(
            "SB-aSRUKF's parameters are within 5 % of the truth at the end", below(5.0, SENSITIVE, slice(0, 4))
        ),),
        NOTES, Metric("% error at the end", final_error), 0, parameters, DT_S,
    ),
    Experiment(
        "p4-one-link-held", "one-link arm, held: drift of the parameters", "P4 figures 3 and 4",
        STATES, data, FILTERS, {},
        (
            PaperClaim(
                "SB-aSRUKF's inertia and viscous friction do not move while the arm is held",
                below(1e-9, SENSITIVE, slice(0, 2)),
            ),
            PaperClaim("nor does its Coulomb friction", below(1e-9, SENSITIVE, slice(2, 3))),
            PaperClaim("without the gate, and in the joint filter, friction drifts more", drifts_more),
        ),
        NOTES, Metric("% drift", drift), 0, parameters, DT_S,
    ),
)  # fmt: skip
