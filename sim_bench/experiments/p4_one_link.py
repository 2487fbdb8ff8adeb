"""P4 section 4.1: the one-link arm is held still and its friction and mass change meanwhile (figures 3 and 4)."""

from functools import cache
from math import atan, cos, pi, sin
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from servohil.estimators import JointSRUKF, Model, SensitivitySRUKF
from servohil.sim_bench.experiments.experiment import Data, Experiment, Figure, Metric, PaperClaim, Results
from servohil.sim_bench.experiments.p4_figures import Column, columns_drawn
from servohil.sim_bench.experiments.p4_paths import below, less, percent_off, settled_after, tracked
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
ESTIMATED: Final = (INVERSE_INERTIA, VISCOUS, COULOMB, MASS_LENGTH)
NAMES: Final = ("1/J", "mu_v", "mu_d", "m l")
TRUE: Final = OneLinkArmParameters().vector()
AFTER: Final = TRUE * [1.0, 4.0, 4.0, 4.0, 1.0, 1.0]  # P4: quadrupled when the arm is held
WRONG: Final = TRUE * [1.5, 3.0, 8.0, 0.25, 1.0, 1.0]  # P4's start
Q_STD: Final = np.sqrt([1e-11, 5e-5])
R_STD: Final = np.sqrt([5e-7, 5.0])
# Columns of what is tracked: angle, speed, then these.
PARAMETERS, VARIANCES, TRACKED = slice(2, 6), slice(6, 8), 8
SENSITIVE, FREE, JOINT = "SB-aSRUKF", "aSRUKF without the gate", "joint SR-UKF"


@njit(cache=True, nogil=True)
def _drive(before: Vector, after: Vector, noise: Matrix, inputs: Matrix, samples: Matrix, states: Matrix) -> None:
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
        states[k, 0] = angle
        states[k, 1] = speed
        samples[k, 0] = angle + noise[k, 2]
        samples[k, 1] = slope + noise[k, 3]


def data(rng: np.random.Generator) -> Data:
    """4 s of motion, held for 3 s with everything but 1/J four times as large from then on, 5 s of motion."""
    noise = rng.standard_normal((STEPS, 4)) * np.concatenate([Q_STD, R_STD])
    inputs, samples, states = np.empty((STEPS, 1)), np.empty((STEPS, 2)), np.empty((STEPS, TRACKED))
    _drive(TRUE, AFTER, noise, inputs, samples, states)
    states[:, PARAMETERS] = np.where(
        np.arange(STEPS)[:, None] < HOLD_FROM, TRUE[list(ESTIMATED)], AFTER[list(ESTIMATED)]
    )
    states[:, VARIANCES] = np.square([Q_STD[0], R_STD[1]])
    return Data(inputs, samples, states, np.zeros((STEPS, 1)), np.zeros((STEPS, 1)))


@cache
def model() -> Model:
    """The arm with the wrong parameters that all filters start from, by Euler's rule as in P4."""
    return Model(one_link_arm.f, one_link_arm.h, 2, 2, WRONG, DT_S, integrator="euler")


X0: Final = np.array([pi / 2, 0.0])
P0: Final = 0.01 * np.eye(2)
Q0, R0 = np.diag([2e-8, 5e-5]), np.diag([5e-7, 20.0])
LOG_STD: Final = [2.0, 1.0]  # standard deviations of the logarithms of Q[0, 0] and R[1, 1]
# 1/J is excited by the noise that the controller follows, also while the arm is held; friction must be free before it.
THRESHOLD: Final = (0.5, 0.1, 0.25, 0.2, 0.0, 0.0)
CONVERGED: Final = 0.1  # of the truth
LOWER, UPPER = [1.0, 0.0, 0.0, 0.0], [100.0, 5.0, 5.0, 5.0]


def sensitive(
    threshold: ArrayLike = THRESHOLD, least_excitation: float = 1.0, kind: type[SensitivitySRUKF] = SensitivitySRUKF
) -> SensitivitySRUKF:
    """SB-aSRUKF: four parameters, one entry of Q and one of R."""
    return kind(
        model(), X0, P0, Q0, R0, parameters=ESTIMATED, Q_entries=(0,), R_entries=(1,), forgetting=0.9995,
        P0_parameters=np.concatenate([WRONG[list(ESTIMATED)], LOG_STD]), lower=[*LOWER, -40.0, -5.0],
        upper=[*UPPER, 0.0, 10.0], threshold=threshold, least_excitation=least_excitation,
    )  # fmt: skip


def joint() -> JointSRUKF:
    """The parameters as states that walk; Q and R as the other starts with."""
    start = WRONG[list(ESTIMATED)]
    return JointSRUKF(
        model(), X0, P0, Q0, R0, parameters=ESTIMATED, P0_parameters=np.diag(np.square(start)),
        Q_parameters=np.diag(np.square(1e-4 * start)), lower=LOWER, upper=UPPER,
    )  # fmt: skip


def final_error(truth: Matrix, found: Matrix) -> Matrix:
    """(6,) error at the end: of the parameters in % of the truth, of the variances in decades."""
    variances = np.abs(np.log10(found[-1, VARIANCES] / truth[-1, VARIANCES]))
    return np.concatenate([percent_off(truth[-1, PARAMETERS], found[-1, PARAMETERS]), variances])


def held_figures(truth: Matrix, found: Matrix) -> Matrix:
    """(7,) largest change of each parameter while the arm is held, after its first half second, and the error of m l
    when it is released, all in % of the truth; time until all parameters are within `CONVERGED` for good, to the hold
    after the start, and to the end after the release, s."""
    right, estimate = truth[:, PARAMETERS], found[:, PARAMETERS]
    held = estimate[HOLD_FROM + 2500 : HOLD_UNTIL]
    drift = 100.0 * np.abs(held - held[0]).max(axis=0) / right[-1]
    mass = percent_off(right[HOLD_UNTIL - 1], estimate[HOLD_UNTIL - 1])[3]
    spans = slice(0, HOLD_FROM), slice(HOLD_UNTIL, STEPS)
    times = [DT_S * settled_after(right[span], estimate[span], CONVERGED * right[span][-1]) for span in spans]
    return np.array([*drift, mass, *times])


def drifts_more(results: Results) -> bool:
    """Both friction coefficients move more without the gate, and in the state."""
    return less(slice(1, 3), SENSITIVE, FREE, JOINT)(results)


def two_diverge(results: Results) -> bool:
    """Without the gate two parameters move by more than a quarter of the truth."""
    return int((results[FREE].medians[:4] > 25.0).sum()) >= 2


def alike(results: Results) -> bool:
    """Both forms need the same time at the start, within a fifth."""
    times = [results[name].medians[5] for name in (SENSITIVE, FREE)]
    return bool(max(times) <= 1.2 * min(times))


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
    "so of the latter. Here Coulomb friction is free during most of the hold: as long as the new m l is not found, the "
    "filter explains what is left of gravity by a speed that is not there, and at that speed friction is excited. No "
    "threshold tells this from motion. It moves towards the truth.",
    "Below about 1e-9 rad2 the data do not tell Q[0, 0], whose true value is 1e-11, and the gate holds it.",
)
ROWS: Final = (
    Column("angle, rad", 0),
    Column("1/J", 2, 0.0, 60.0),
    Column("mu_v", 3, 0.0, 0.6),
    Column("mu_d", 4, 0.0, 2.0),
    Column("m l", 5, 0.0, 0.7),
)
FIGURE_4: Final = Figure(
    "P4 figure 4: angle, parameters, variances; the arm is held from 4 to 7 s, friction and mass quadruple at 4 s",
    columns_drawn((*ROWS, Column("Q[0, 0], rad2", 6, log=True), Column("R[1, 1]", 7, log=True))),
)
FIGURE_4_HELD: Final = Figure(
    "P4 figure 4 from shortly before the hold until shortly after it",
    columns_drawn(ROWS[1:], since_s=3.5, until_s=8.0),
)
TRACK: Final = tracked(2, [Q0[0, 0], R0[1, 1]])
EXPERIMENTS: Final = (
    Experiment(
        "p4-one-link", "one-link arm, friction and mass change while it is held: error at the end", "P4 figure 4",
        (*NAMES, "Q[0, 0]", "R[1, 1]"), data, FILTERS, {},
        (
            PaperClaim(
                "SB-aSRUKF's parameters are within 5 % of the truth at the end", below(5.0, slice(0, 4), SENSITIVE)
            ),
            PaperClaim(
                "SB-aSRUKF's process covariance converges to the truth (here: within a factor of 2)",
                below(np.log10(2.0), slice(4, 5), SENSITIVE),
            ),
            PaperClaim(
                "our addition: and so does the variance of the acceleration, which P4 does not estimate",
                below(np.log10(2.0), slice(5, 6), SENSITIVE),
            ),
        ),
        NOTES, Metric("% error at the end, of variances in decades", final_error), 0, TRACK, DT_S,
        {"p4-figure4": FIGURE_4},
    ),
    Experiment(
        "p4-one-link-held", "one-link arm, held: drift of the parameters, convergence before and after", "P4 figure 4",
        (*(f"drift of {name}" for name in NAMES), "m l, error at release", "converged after, s", "again after, s"),
        data, FILTERS, {},
        (
            PaperClaim(
                "SB-aSRUKF's inertia and viscous friction do not move while the arm is held",
                below(1e-9, slice(0, 2), SENSITIVE),
            ),
            PaperClaim("nor does its Coulomb friction", below(1e-9, slice(2, 3), SENSITIVE)),
            PaperClaim("without the gate, and in the joint filter, friction drifts more", drifts_more),
            PaperClaim("without the gate two parameters diverge (here: move by more than a quarter)", two_diverge),
            PaperClaim(
                "with and without the gate the filter finds m l while the arm is held (here: within 10 %)",
                below(10.0, slice(4, 5), SENSITIVE, FREE),
            ),
            PaperClaim(
                "with and without the gate it needs almost the same time to converge at the start (here: to 10 %, "
                "within a fifth)", alike,
            ),
            PaperClaim("without the gate it needs more time after the hold", less(slice(6, 7), SENSITIVE, FREE)),
        ),
        NOTES, Metric("%, times in s", held_figures), 0, TRACK, DT_S, {"p4-figure4-held": FIGURE_4_HELD},
    ),
)  # fmt: skip
