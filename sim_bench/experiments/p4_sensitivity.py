"""P4 figure 3: what the one-link arm's speed owes to each parameter, in the filter and in its model alone (eq. 10)."""

from math import atan, cos, sin
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators import SensitivitySRUKF
from servohil.estimators.filter import Filter
from servohil.sim_bench.experiments import p4_one_link
from servohil.sim_bench.experiments.experiment import Data, Experiment, Figure, Metric, PaperClaim, Results
from servohil.sim_bench.experiments.p4_figures import sensitivities_drawn
from servohil.sim_bench.experiments.p4_one_link import (
    DT_S,
    ESTIMATED,
    HOLD_FROM,
    HOLD_UNTIL,
    NAMES,
    THRESHOLD,
    WRONG,
    sensitive,
)
from servohil.sim_bench.experiments.p4_paths import above, below, less
from servohil.sim_bench.plants.one_link_arm import COULOMB, GRAVITY, INVERSE_INERTIA, MASS_LENGTH, SLOPE, VISCOUS

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STEPS: Final = p4_one_link.HOLD_UNTIL
DRAWN: Final = 45_000  # steps
SAMPLED: Final = 10  # steps from one look at the sensitivities to the next
SETTLED: Final = 5_000  # the first second's sensitivities are those of wrong parameters
SMOOTH: Final = 25  # looks, 50 ms: what changes faster is noise
FILTER, MODEL = "a posteriori, SB-aSRUKF", "eq. 10"


@njit(cache=True, nogil=True, error_model="numpy")
def advance(sensitivity: Matrix, states: Matrix, inputs: Matrix, p: Vector) -> None:
    """P4 eq. 10 along given states: S <- (I + dt df/dx) S + dt df/dtheta, by Euler's rule as the model.

    Args:
        sensitivity: (2, 4) of angle and speed with respect to 1/J, mu_v, mu_d and m l; updated.
        states: (N, 2) angle and speed before each step.
        inputs: (N, 1) torque in each step.
        p: (6,) parameters, `OneLinkArmParameters.vector()`.
    """
    for k in range(states.shape[0]):
        angle, speed = states[k, 0], states[k, 1]
        friction = p[VISCOUS] * speed + p[COULOMB] * atan(p[SLOPE] * speed)
        weight = 0.5 * p[GRAVITY] * sin(angle)
        by_angle = -p[INVERSE_INERTIA] * 0.5 * p[MASS_LENGTH] * p[GRAVITY] * cos(angle)
        by_speed = -p[INVERSE_INERTIA] * (p[VISCOUS] + p[COULOMB] * p[SLOPE] / (1.0 + (p[SLOPE] * speed) ** 2))
        for j in range(4):
            if j == 0:
                own = inputs[k, 0] - friction - p[MASS_LENGTH] * weight
            elif j == 1:
                own = -p[INVERSE_INERTIA] * speed
            elif j == 2:
                own = -p[INVERSE_INERTIA] * atan(p[SLOPE] * speed)
            else:
                own = -p[INVERSE_INERTIA] * weight
            of_angle, of_speed = sensitivity[0, j], sensitivity[1, j]
            sensitivity[0, j] = of_angle + DT_S * of_speed
            sensitivity[1, j] = of_speed + DT_S * (by_angle * of_angle + by_speed * of_speed + own)


class Sensitivities(NamedTuple):
    """At every `SAMPLED`th step: estimated states (N, 2), sensitivities of the speed, of the filter and of eq. 10
    (N, 4), and the excitation that the gate compares (N, 4)."""

    states: Matrix
    of_filter: Matrix
    of_model: Matrix
    excitation: Matrix


def sensitivities(one: SensitivitySRUKF, record: Data) -> Sensitivities:
    """Run the filter, and eq. 10 along its estimates of states and parameters."""
    count = len(record.inputs) // SAMPLED
    states, *rest = np.empty((count, 2)), *(np.empty((count, 4)) for _ in range(3))
    of_filter, of_model, excitation = rest
    p, of_states = WRONG.copy(), np.zeros((2, 4))
    for i in range(count):
        part = slice(SAMPLED * i, SAMPLED * (i + 1))
        p[list(ESTIMATED)] = one.parameters[:4]
        before = one.x
        after = one.run(record.inputs[part], record.samples[part]).x
        advance(of_states, np.vstack([before, after[:-1]]), record.inputs[part], p)
        states[i], of_model[i] = one.x, of_states[1]
        of_filter[i], excitation[i] = one.sensitivity_x[1, :4], one.excitation[:4]
    return Sensitivities(states, of_filter, of_model, excitation)


class AlongEstimates(SensitivitySRUKF):
    """The same filter, of which eq. 10 takes the estimates."""


def along_estimates() -> SensitivitySRUKF:
    """See there."""
    return sensitive(kind=AlongEstimates)


def track(one: Filter, record: Data) -> Matrix:
    """(N, 4) sensitivity of the speed to each parameter, from look to look."""
    assert isinstance(one, SensitivitySRUKF)
    found = sensitivities(one, record)
    return np.repeat(found.of_model if isinstance(one, AlongEstimates) else found.of_filter, SAMPLED, axis=0)


def data(rng: np.random.Generator, steps: int = STEPS) -> Data:
    """The first steps of `p4_one_link`, until the arm is released."""
    inputs, samples, states, q, r, _ = p4_one_link.data(rng)
    return Data(inputs[:steps], samples[:steps], states[:steps], q[:steps], r[:steps])


def smooth(path: Matrix) -> Matrix:
    """(N - SMOOTH + 1, columns) mean over SMOOTH looks."""
    sums = np.cumsum(np.vstack([np.zeros(path.shape[1]), path]), axis=0)
    return np.asarray((sums[SMOOTH:] - sums[:-SMOOTH]) / SMOOTH)


def noise(path: Matrix) -> Matrix:
    """(columns,) RMS of what changes faster than SMOOTH looks, in % of the RMS of the path."""
    middle = path[SMOOTH // 2 : len(path) - SMOOTH + SMOOTH // 2 + 1]
    return np.asarray(100.0 * np.sqrt(np.square(middle - smooth(path)).mean(axis=0) / np.square(path).mean(axis=0)))


def follows(first: Vector, second: Vector) -> float:
    """Correlation of the magnitudes in %."""
    return float(100.0 * np.corrcoef(np.abs(first), np.abs(second))[0, 1])


def figures(truth: Matrix, found: Matrix) -> Matrix:
    """(11,) noise of each sensitivity in the motion before the hold; the largest of each while held, after its first
    half second, in % of the largest in that motion; correlation of 1/J's with the acceleration, mu_v's with the speed
    and m l's with sin(angle) in that motion, all as magnitudes and in %."""
    moving = slice(SETTLED // SAMPLED, HOLD_FROM // SAMPLED)
    path, motion = found[SAMPLED - 1 :: SAMPLED], truth[SAMPLED - 1 :: SAMPLED]
    moved = path[moving]
    held = path[(HOLD_FROM + 2500) // SAMPLED :]
    slow, true = smooth(moved), smooth(motion[moving, :2])
    acceleration = np.gradient(true[:, 1])
    return np.concatenate([
        noise(moved),
        100.0 * np.abs(held).max(axis=0) / np.abs(moved).max(axis=0),
        [follows(slow[:, 0], acceleration), follows(slow[:, 1], true[:, 1]), follows(slow[:, 3], np.sin(true[:, 0]))],
    ])  # fmt: skip


def friction_is_noisiest(results: Results) -> bool:
    """Of both computations mu_d's sensitivity has the largest share of noise."""
    return all(int(np.argmax(results[name].medians[:4])) == ESTIMATED.index(COULOMB) for name in (FILTER, MODEL))


def under_threshold(results: Results) -> bool:
    """While held, the filter's sensitivities to 1/J, mu_v and mu_d stay below the gate's thresholds."""
    return bool((results[FILTER].medians[4:7] < 100.0 * np.array(THRESHOLD[:3])).all())


def draw(experiment: Experiment, path: Path) -> None:
    """P4 figure 3 of one run with seed 0, until 2 s after the hold."""
    record = data(np.random.default_rng(0), DRAWN)
    one = sensitive()
    found = sensitivities(one, record)
    moving = slice(SETTLED // SAMPLED, HOLD_FROM // SAMPLED)
    curves = {
        name: np.abs(each) / np.abs(each[moving]).max(axis=0)
        for name, each in (
            (MODEL, found.of_model), (FILTER, found.of_filter),
            ("excitation, which our gate compares", found.excitation),
        )
    }  # fmt: skip
    looks = record.states[SAMPLED - 1 :: SAMPLED]
    time = DT_S * SAMPLED * np.arange(1.0, len(looks) + 1.0)
    angle = np.column_stack([looks[:, 0], found.states[:, 0]])
    sensitivities_drawn(path, time, angle, (DT_S * HOLD_FROM, DT_S * HOLD_UNTIL), NAMES, curves, THRESHOLD[:4])


NOTES: Final = (
    "Sensitivity of the speed, in parts of its largest magnitude from 1 to 4 s. Eq. 10 is the derivative of the "
    "model's recursion along the filter's estimates, without gain and covariance. Noise: what changes within 50 ms, in "
    "the motion before the hold. Held: the largest after half a second of hold.",
    "Our gate compares the excitation of one step, not the sensitivity of the estimate, which depends on the filter's "
    "tuning: the picture has both, with the line of the gate.",
    "Eq. 10 adds up over time what a parameter does: it lags behind the motion, and what the torque's noise leaves in "
    "it is small. The a posteriori sensitivity is corrected by every sample and follows the motion at once, and the "
    "noise with it. Early in the hold it belongs to a model whose m l and friction have just become wrong.",
)
EXPERIMENTS: Final = (
    Experiment(
        "p4-sensitivity", "one-link arm: sensitivity of the speed to the parameters", "P4 figure 3",
        (
            *(f"noise, {name}" for name in NAMES), *(f"held, {name}" for name in NAMES),
            "1/J with acceleration", "mu_v with speed", "m l with sin(angle)",
        ),
        data, {FILTER: sensitive, MODEL: along_estimates}, {},
        (
            PaperClaim(
                "eq. 10's sensitivities have more noise than the a posteriori ones", less(slice(0, 4), FILTER, MODEL)
            ),
            PaperClaim(
                "the a posteriori sensitivities are almost free of noise (here: less than 10 %)",
                below(10.0, slice(0, 4), FILTER),
            ),
            PaperClaim("Coulomb friction's is the noisiest", friction_is_noisiest),
            PaperClaim(
                "1/J's is largest where the arm accelerates (here: correlation of the magnitudes above 70 %)",
                above(70.0, slice(8, 9), FILTER),
            ),
            PaperClaim("mu_v's is largest at maximal speed (the same)", above(70.0, slice(9, 10), FILTER)),
            PaperClaim("m l's vanishes only where the arm crosses 0 rad (the same, with sin(angle))",
                       above(70.0, slice(10, 11), FILTER)),
            PaperClaim("while the arm is held 1/J's, mu_v's and mu_d's stay below the threshold", under_threshold),
            PaperClaim("and m l's does not", above(100.0 * THRESHOLD[3], slice(7, 8), FILTER)),
        ),
        NOTES, Metric("%", figures), 0, track, DT_S,
        {"p4-figure3": Figure("P4 figure 3: sensitivities in parts of their largest; held from 4 to 7 s", draw)},
    ),
)  # fmt: skip
