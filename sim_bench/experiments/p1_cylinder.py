"""P1 section 3.2: the servo-hydraulic cylinder, noise known, unknown, and changing (tables 6-8)."""

from collections.abc import Callable
from functools import cache
from typing import Final

import numpy as np

from servohil.estimators import AEKF, ASRUKF, AUKF, EKF, SRUKF, UKF, Model
from servohil.estimators.filter import Filter
from servohil.sim_bench import noise_scenarios
from servohil.sim_bench.experiments.experiment import (
    KNOWS,
    Data,
    Experiment,
    Figure,
    PaperClaim,
    better,
    lost,
    near,
    within,
)
from servohil.sim_bench.experiments.figures import draw
from servohil.sim_bench.noise_scenarios import NoiseScenario

STEPS: Final = 20_000
STATES: Final = ("x", "v", "p1", "p2")
TINY: Final = 1e-20
P0: Final = np.diag([1.0, 1.0, 10.0, 10.0])
X0: Final = np.array([0.0, 0.0, 0.0, 0.0])
NOTES: Final = (
    "A filter's gain depends on the ratio of Q to R alone: Q = R = 1e-20 I (tables 7, 8) is a filter that trusts "
    "both equally, not one that trusts nothing. So the filters that do not adapt are off by the ratio, and do not "
    "diverge.",
    "As printed the noise covariances are the same number for m, m/s and pressure; the state is in (m, m/s, MPa, MPa) "
    "here (errata). With a position variance of 1e-3 m2 per sample the piston does not stay within any stroke.",
    "Not given: input, sample time, initial covariance, alpha, which outputs are measured. Chosen: a loop around the "
    "true position following 0.3 + 0.15 sin 2t m; 1 ms; 20 s; P0 = diag(1, 1, 10, 10); alpha = 1; position and both "
    "pressures.",
    "P1 starts the pressures at 2 and 2.5 MPa; here the plant starts in the middle of the motion.",
)


@cache
def model() -> Model:
    """The cylinder, as plant and in all filters."""
    return noise_scenarios.filter_model(noise_scenarios.SCENARIOS[0])


def record(q: float, r: float, factor: float = 1.0) -> Callable[[np.random.Generator], Data]:
    """Data with variances q, r per sample, `factor` times as large from 4 to 16 s."""
    scenario = NoiseScenario("p1", "P1", (q,) * 4, (r,) * 3, factor, False)

    def data(rng: np.random.Generator) -> Data:
        inputs, samples, states = noise_scenarios.simulate(scenario, STEPS, int(rng.integers(2**31)))
        return Data(inputs, samples, states, *scenario.variances(STEPS))

    return data


def competitors(q: float, r: float) -> dict[str, Callable[[], Filter]]:
    """The filters of tables 6 to 8, from zero with Q = q I, R = r I."""
    q0, r0 = q * np.eye(4), r * np.eye(3)
    return {
        "ASr-UKF": lambda: ASRUKF(model(), X0, P0, q0, r0, adaptation="sage-husa"),
        "ASr-UKF, likelihood": lambda: ASRUKF(model(), X0, P0, q0, r0),
        "Sr-UKF": lambda: SRUKF(model(), X0, P0, q0, r0),
        "UKF": lambda: UKF(model(), X0, P0, q0, r0),
        "AUKF": lambda: AUKF(model(), X0, P0, q0, r0),
        "EKF": lambda: EKF(model(), X0, P0, q0, r0),
        "AEKF": lambda: AEKF(model(), X0, P0, q0, r0),
        KNOWS: lambda: SRUKF(model(), X0, P0, np.eye(4), np.eye(3)),
    }


OURS: Final = PaperClaim(
    "ours: the likelihood form is within 1.10 times of the filter that knows Q and R, from 3 s on",
    near(1.10, "ASr-UKF, likelihood", KNOWS),
)
EXPERIMENTS: Final = (
    Experiment(
        "p1-table6", "cylinder, noise known and constant", "P1 table 6, figure 7", STATES, record(1e-6, 1e-4),
        competitors(1e-6, 1e-4),
        {
            "ASr-UKF": (0.496, 0.616, 2.518, 1.271), "Sr-UKF": (0.493, 0.616, 2.511, 1.271),
            "UKF": (0.475, 0.617, 2.518, 1.371), "AUKF": (0.489, 0.616, 2.510, 1.281),
            "EKF": (2.269, 1.501, 2.621, 1.518), "AEKF": (0.782, 0.947, 2.593, 1.372),
        },
        (PaperClaim(
            "the other filters have almost the same results as ASr-UKF (within 2 times)",
            within(2.0, "ASr-UKF", "Sr-UKF", "UKF", "AUKF", "EKF", "AEKF"),
        ), OURS),
        NOTES,
        figures={"p1-figure7": Figure("Figure 7: cylinder, noise known and constant", draw)},
    ),
    Experiment(
        "p1-table7", "cylinder, noise unknown and constant", "P1 table 7, figure 8", STATES, record(1e-3, 1e-3),
        competitors(TINY, TINY),
        {
            "ASr-UKF": (1.80, 0.78, 2.49, 2.52), "Sr-UKF": (9.11, 6.72, 15.01, 16.70),
            "UKF": (23.94, 14.55, 24.47, 28.07), "AUKF": (1.71, 0.78, 2.54, 2.52),
            "EKF": (29.43, 21.11, 31.96, 37.24), "AEKF": (2.12, 0.76, 2.61, 2.51),
        },
        (PaperClaim(
            "ASr-UKF is better than Sr-UKF, UKF and EKF on every state", better("ASr-UKF", "Sr-UKF", "UKF", "EKF")
        ), OURS),
        NOTES,
        figures={"p1-figure8": Figure("Figure 8: cylinder, noise unknown and constant", draw)},
    ),
    Experiment(
        "p1-table8", "cylinder, noise unknown and changing", "P1 table 8, figure 9", STATES, record(1e-7, 1e-5, 100.0),
        competitors(TINY, TINY),
        {
            "ASr-UKF": (0.80, 1.29, 1.00, 0.17), "Sr-UKF": (46.10, 42.77, 26.79, 11.14),
            "UKF": (46.12, 19.17, 12.81, 14.07), "AUKF": (0.82, 1.38, 1.14, 0.16), "EKF": (None,) * 4,
            "AEKF": (0.91, 1.34, 1.13, 0.17),
        },
        (
            PaperClaim(
                "ASr-UKF is better than Sr-UKF, UKF and EKF on every state", better("ASr-UKF", "Sr-UKF", "UKF", "EKF")
            ),
            PaperClaim("the EKF cannot estimate the states (here: worse than the mean of the path)", lost("EKF")),
            OURS,
        ),
        NOTES,
        figures={"p1-figure9": Figure("Figure 9: cylinder, noise unknown and changing", draw)},
    ),
    Experiment(
        "p1-table9", "cylinder in the laboratory", "P1 table 9", STATES, record(1e-7, 1e-5), {}, {},
        (PaperClaim("ASr-UKF is the best on the recorded data", None, "the recordings are not to be had"),),
        ("The laboratory's recordings are not published.",),
    ),
)  # fmt: skip
