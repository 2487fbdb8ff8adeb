"""P1 section 3.1: the arm of three links, all six states measured, noise known, unknown, and changing (tables 1-5)."""

from collections.abc import Callable
from functools import cache, partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import AEKF, ASRUKF, AUKF, EKF, SRUKF, UKF, Model
from servohil.estimators.filter import Filter
from servohil.sim_bench.experiments.experiment import (
    KNOWS,
    Data,
    Experiment,
    Figure,
    PaperClaim,
    better,
    near,
    settled,
    within,
)
from servohil.sim_bench.experiments.figures import draw
from servohil.sim_bench.noise import Change, gaussian, scheduled
from servohil.sim_bench.plants import three_link_arm
from servohil.sim_bench.plants.simulate import simulate

Vector = NDArray[np.float64]
Build = Callable[[], Filter]

DT_S: Final = 1e-3
STEPS: Final = 20_000
X_START: Final = np.array([1.0, 0.5, 1.0, 2.0, -1.0, -2.0])
TORQUE_NM: Final = np.array([2.0, 3.0, 2.0])
OMEGA_RAD_PER_S: Final = np.array([1.0, 1.5, 2.0])
STATES: Final = ("th1", "th2", "th3", "th1'", "th2'", "th3'")
TINY: Final = 1e-20
P0: Final = np.eye(6)
FAR: Final = (4.3, 2.62, 7.0, 6.65, 3.5, 8.75)
ZERO: Final = (0.0,) * 6
NOTES: Final = (
    "A filter's gain depends on the ratio of Q to R alone: Q = R = 1e-20 I (tables 2 to 5) is a filter that trusts "
    "both equally, not one that trusts nothing. So the filters that do not adapt are off by the ratio, and do not "
    "diverge.",
    "Not given: input, sample time, run length, initial covariance, alpha. Chosen: torques 2, 3, 2 Nm times sines of "
    "1, 1.5, 2 rad/s; 1 ms; 20 s; P0 = I; alpha = 1, beta = 2, kappa = 0.",
    "Noise is added to all six states once per sample, and to all six outputs.",
)


@cache
def model() -> Model:
    """The arm, as plant and in all filters."""
    p = three_link_arm.ThreeLinkArmParameters().vector()
    return Model(three_link_arm.f, three_link_arm.h, 6, 6, p, DT_S, n_u=3)


def record(q: float, r: float, changes: tuple[tuple[float, float, float, float], ...] = ()) -> Callable[..., Data]:
    """Data with variances q, r per sample, and others in times (from, to, q, r)."""

    def variances(base: float, which: int) -> NDArray[np.float64]:
        spans: list[Change] = [(begin, end, np.full(6, (a, b)[which])) for begin, end, a, b in changes]
        return scheduled(STEPS, DT_S, np.full(6, base), spans)

    def data(rng: np.random.Generator) -> Data:
        time = DT_S * np.arange(STEPS)[:, None]
        inputs = TORQUE_NM * np.sin(OMEGA_RAD_PER_S * time)
        process, measurement = variances(q, 0), variances(r, 1)
        truth = simulate(model(), X_START, inputs, np.sqrt(process), int(rng.integers(2**31)))
        return Data(inputs, truth.Y + gaussian(rng, measurement), truth.X, process, measurement)

    return data


def competitors(x0: tuple[float, ...], q: float, r: float) -> dict[str, Build]:
    """The filters of tables 1, 2 and 4, from x0 with Q = q I, R = r I."""
    start, q0, r0 = np.array(x0), q * np.eye(6), r * np.eye(6)
    return {
        "ASr-UKF": lambda: ASRUKF(model(), start, P0, q0, r0, adaptation="sage-husa"),
        "ASr-UKF, likelihood": lambda: ASRUKF(model(), start, P0, q0, r0),
        "Sr-UKF": lambda: SRUKF(model(), start, P0, q0, r0),
        "UKF": lambda: UKF(model(), start, P0, q0, r0),
        "AUKF": lambda: AUKF(model(), start, P0, q0, r0),
        "EKF": lambda: EKF(model(), start, P0, q0, r0),
        "AEKF": lambda: AEKF(model(), start, P0, q0, r0),
        KNOWS: lambda: SRUKF(model(), start, P0, np.eye(6), np.eye(6)),
    }


def starts(*x0: tuple[float, ...]) -> dict[str, Build]:
    """ASr-UKF in the papers' form from several initial estimates (tables 3 and 5)."""

    def build(start: tuple[float, ...]) -> Build:
        tiny = TINY * np.eye(6)
        return lambda: ASRUKF(model(), np.array(start), P0, tiny, tiny, adaptation="sage-husa")

    return {name_of(start): build(start) for start in x0}


def name_of(start: tuple[float, ...]) -> str:
    """As the page shows it."""
    return f"from {', '.join(f'{value:g}' for value in start)}"


CONSTANT: Final = record(1e-6, 1e-4)
VARYING: Final = record(1e-5, 1e-5, ((5.0, 15.0, 1e-4, 1e-7),))
POSITIONS: Final = partial(draw, states=STATES[:3])
VELOCITIES: Final = partial(draw, states=STATES[3:])
OURS: Final = PaperClaim(
    "ours: the likelihood form is within 1.10 times of the filter that knows Q and R, from 3 s on",
    near(1.10, "ASr-UKF, likelihood", KNOWS),
)
UNKNOWN_CLAIMS: Final = (
    PaperClaim("ASr-UKF is better than Sr-UKF, UKF and EKF on every state", better("ASr-UKF", "Sr-UKF", "UKF", "EKF")),
    PaperClaim("AUKF and AEKF are close to ASr-UKF (within 1.5 times)", within(1.5, "ASr-UKF", "AUKF", "AEKF")),
    OURS,
)
TABLE_3: Final = (ZERO, (1.0, 0.0, 1.0, 2.0, -1.0, -2.0), (1.0, 1.0, 1.0, 3.0, -1.0, -3.0), FAR)
TABLE_5: Final = (ZERO, (2.0, 1.0, 3.0, 3.0, 2.0, 4.0), (2.0, 1.0, 4.0, 4.0, 2.0, 5.0), (1.0, 1.0, 2.0, 2.0, 1.0, 2.0))

EXPERIMENTS: Final = (
    Experiment(
        "p1-table1", "3-link arm, noise known and constant", "P1 table 1, figure 1", STATES, record(1e-5, 1e-3),
        competitors(FAR, 1e-5, 1e-3),
        {
            "ASr-UKF": (2.91, 0.58, 0.41, 2.32, 1.96, 5.16), "Sr-UKF": (2.37, 0.47, 0.41, 2.55, 1.69, 4.19),
            "AUKF": (2.98, 0.69, 0.41, 2.46, 2.42, 5.97), "UKF": (2.38, 0.46, 0.41, 2.38, 1.71, 4.98),
            "AEKF": (3.15, 0.67, 0.54, 2.41, 2.58, 5.89), "EKF": (4.63, 0.81, 0.47, 2.66, 2.58, 6.16),
        },
        (PaperClaim(
            "all filters have almost the same results (within 2 times)",
            within(2.0, "Sr-UKF", "ASr-UKF", "AUKF", "UKF", "AEKF", "EKF"),
        ), OURS),
        (*NOTES, "The start of the estimate is not given for this table; that of table 2 was taken."),
        figures={"p1-figure1": Figure("Figure 1: positions, noise known and constant", POSITIONS)},
    ),
    Experiment(
        "p1-table2", "3-link arm, noise unknown and constant", "P1 table 2, figures 2 and 3", STATES, CONSTANT,
        competitors(FAR, TINY, TINY),
        {
            "ASr-UKF": (2.37, 0.48, 0.41, 2.48, 1.79, 4.80), "Sr-UKF": (88.5, 11.89, 20.86, 8.59, 12.67, 17.17),
            "UKF": (93.23, 33.17, 32.21, 7.76, 10.94, 16.45), "AUKF": (2.39, 0.48, 0.39, 2.47, 1.82, 4.96),
            "EKF": (78.12, 21.00, 11.49, 10.32, 16.95, 20.57), "AEKF": (2.57, 0.49, 0.41, 2.47, 1.80, 4.80),
        },
        UNKNOWN_CLAIMS, NOTES,
        figures={
            "p1-figure2": Figure("Figure 2: positions, noise unknown and constant", POSITIONS),
            "p1-figure3": Figure("Figure 3: velocities, noise unknown and constant", VELOCITIES),
        },
    ),
    Experiment(
        "p1-table3", "3-link arm, noise unknown and constant, several starts", "P1 table 3", STATES, CONSTANT,
        starts(*TABLE_3),
        dict(zip(map(name_of, TABLE_3), (
            (0.73, 0.13, 0.07, 0.82, 0.36, 0.63), (0.22, 0.13, 0.02, 0.12, 0.11, 0.09),
            (0.21, 0.13, 0.03, 0.42, 0.10, 0.32), (2.49, 0.49, 0.41, 2.49, 1.82, 4.81),
        ), strict=True)),
        (PaperClaim(
            "robust against the start: from 3 s on all starts are within 1.5 times of the best",
            settled(1.5, *map(name_of, TABLE_3)),
        ),),
        NOTES,
    ),
    Experiment(
        "p1-table4", "3-link arm, noise unknown and changing", "P1 table 4, figures 4 and 5", STATES, VARYING,
        competitors(ZERO, TINY, TINY),
        {
            "ASr-UKF": (0.47, 0.14, 0.14, 0.66, 0.32, 0.54), "Sr-UKF": (60.62, 57.00, 43.45, 4.70, 7.80, 8.90),
            "UKF": (9.50, 2.40, 0.70, 3.48, 3.75, 5.01), "AUKF": (0.65, 0.27, 0.21, 0.81, 0.51, 0.68),
            "EKF": (18.92, 3.94, 8.54, 4.71, 7.91, 9.53), "AEKF": (0.83, 0.29, 0.27, 1.02, 0.69, 0.70),
        },
        UNKNOWN_CLAIMS, NOTES,
        figures={
            "p1-figure4": Figure("Figure 4: positions, noise unknown and changing", POSITIONS),
            "p1-figure5": Figure("Figure 5: velocities, noise unknown and changing", VELOCITIES),
        },
    ),
    Experiment(
        "p1-table5", "3-link arm, noise unknown and changing, several starts", "P1 table 5", STATES, VARYING,
        starts(*TABLE_5),
        dict(zip(map(name_of, TABLE_5), (
            (0.47, 0.14, 0.14, 0.68, 0.36, 0.57), (0.51, 0.15, 0.24, 0.40, 0.90, 1.69),
            (0.50, 0.14, 0.34, 0.86, 1.14, 2.07), (0.29, 0.14, 0.13, 0.23, 0.60, 1.13),
        ), strict=True)),
        (PaperClaim(
            "robust against the start: from 3 s on all starts are within 1.5 times of the best",
            settled(1.5, *map(name_of, TABLE_5)),
        ),),
        NOTES,
    ),
)  # fmt: skip
