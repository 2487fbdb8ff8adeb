"""P3's servo-hydraulic cylinder in closed loop, and the INTSMC paper's experiments on it."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.control.laws.integral_terminal import IntegralTerminalGains
from servohil.control.laws.intsmc import IntsmcGains
from servohil.control.laws.ntsmc import NtsmcGains
from servohil.estimators.models.cylinder import CylinderParameters
from servohil.sim_bench.experiments.experiment import (
    Data,
    Experiment,
    Figure,
    Metric,
    PaperClaim,
    Results,
    percent_nmse,
    rms_error,
)
from servohil.sim_bench.experiments.p3_figures import Row, rows_drawn
from servohil.sim_bench.experiments.p3_loops import (
    CYLINDER_COLUMNS,
    INTEGRAL_TERMINAL,
    INTSMC,
    NTSMC,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VALVE,
    Controller,
    run_cylinder,
)
from servohil.sim_bench.experiments.p3_measures import RUN_S, chatter, effort, reached, smaller, times
from servohil.sim_bench.experiments.p4_paths import below, less
from servohil.sim_bench.plants.cylinder import SUPPLY_PA, TANK_PA

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

DT_S: Final = 1e-4
STROKE_M: Final = 1.0  # L of the synergetic paper's table 6
CYLINDER: Final = CylinderParameters(stroke_m=STROKE_M)
PRESSURE_B_MPA: Final = 6.0  # at the start
SUPPLY: Final = np.array([SUPPLY_PA, TANK_PA])
MASS_ERROR_KG: Final = 60.0
TOLERANCE_M: Final = 5e-3
ORIGIN_S: Final = 10.0
STATES: Final = slice(POSITION, POSITION + 3)


def sine() -> Matrix:
    """(N, 4) 0.15 sin 2t + 0.3 and its derivatives (INTSMC paper, eq. 30, corrected)."""
    t = times(RUN_S, DT_S)
    return np.column_stack(
        [0.15 * np.sin(2 * t) + 0.3, 0.3 * np.cos(2 * t), -0.6 * np.sin(2 * t), -1.2 * np.cos(2 * t)]
    )


SINE: Final = sine()
ORIGIN: Final = np.zeros((len(times(ORIGIN_S, DT_S)), 4))


def at_rest_in_acceleration(position: float, velocity: float) -> Vector:
    """(4,) start with as much pressure in A as makes the acceleration 0, as in both papers' X0."""
    force = CYLINDER.friction_ns_per_m * velocity * 1e-6 + CYLINDER.area_b_m2 * PRESSURE_B_MPA
    return np.array([position, velocity, force / CYLINDER.area_a_m2, PRESSURE_B_MPA])


def loaded(reference: Matrix) -> Callable[[np.random.Generator], Data]:
    """A run from the INTSMC paper's start, with up to 60 kg that the controller does not know of."""

    def data(rng: np.random.Generator) -> Data:
        mass = CYLINDER.mass_kg + rng.uniform(0.0, MASS_ERROR_KG)
        return as_data(reference, at_rest_in_acceleration(0.4, 0.005), mass)

    return data


def as_data(
    reference: Matrix, x0: Vector, mass_kg: float, pushed: Vector | None = None, noise: Matrix | None = None
) -> Data:
    """A run: what the disturbance adds to the acceleration (N,), noise on the fuzzy inputs (N, 2); none: zeros."""
    count = len(reference)
    states, none = np.zeros((count, CYLINDER_COLUMNS)), np.zeros((count, 1))
    states[:, STATES] = reference[:, :3]
    return Data(
        none if pushed is None else pushed[:, None], np.zeros((count, 2)) if noise is None else noise, states,
        none, none, np.concatenate([x0, [mass_kg]]),
    )  # fmt: skip


def along(reference: Matrix) -> Callable[[Controller, Data], Matrix]:
    """Track of an experiment: (N, CYLINDER_COLUMNS) the closed loop, which needs the reference's third derivative."""

    def track(one: Controller, data: Data) -> Matrix:
        assert data.start is not None
        out = np.empty((len(reference), CYLINDER_COLUMNS))
        run_cylinder(
            one.law, one.gains, CYLINDER.vector(), float(data.start[4]), data.start[:4].copy(), SUPPLY, reference,
            one.disturbance * data.inputs[:, 0], one.noise * data.samples, DT_S, out,
        )  # fmt: skip
        return out

    return track


def states_and_effort(states: Matrix, found: Matrix) -> Matrix:
    """(6,) RMSE of position, velocity and acceleration; time; chatter and effort of the command."""
    position, valve = slice(POSITION, POSITION + 1), found[:, [VALVE]]
    time = reached(states[:, position], found[:, position], TOLERANCE_M, DT_S)
    return np.concatenate([rms_error(states[:, STATES], found[:, STATES]), time, 1e3 * chatter(valve), [effort(valve)]])


def with_pressures(states: Matrix, found: Matrix) -> Matrix:
    """(8,) as `states_and_effort`, then least and largest chamber pressure."""
    pressures = found[:, [PRESSURE_A, PRESSURE_B]]
    return np.concatenate([states_and_effort(states, found), [pressures.min(), pressures.max()]])


def and_later(states: Matrix, found: Matrix) -> Matrix:
    """(9,) as `with_pressures`, then RMSE of the position after 5 s."""
    later = slice(round(5.0 / DT_S), None)
    return np.concatenate([with_pressures(states, found), rms_error(states[later, :1], found[later, :1])])


def with_stroke(states: Matrix, found: Matrix) -> Matrix:
    """(7,) as `states_and_effort`, then the largest position."""
    return np.concatenate([states_and_effort(states, found), [found[:, POSITION].max()]])


def position_in_percent(states: Matrix, found: Matrix) -> Matrix:
    """(3,) % NMSE of the position, chatter of the command, largest position."""
    figures = percent_nmse(states[:, [POSITION]], found[:, [POSITION]])
    return np.concatenate([figures, 1e3 * chatter(found[:, [VALVE]]), [found[:, POSITION].max()]])


COLUMNS: Final = (
    "x, m", "v, m/s", "a, m/s2", "x within 5 mm after, s", "mean change of u, mV per 0.1 ms", "mean u^2, V2"
)  # fmt: skip
TIME, CHATTER, LARGEST_X, LATER = 3, 4, 6, 8
AFTER: Final = slice(TIME, TIME + 1)
C: Final = (5.0, 26.0, 45.0)


def intsmc() -> Controller:
    """All ours: on sigma = 0 two poles at 3 1/s (damping 0.9) and one at 10 1/s."""
    return Controller(INTSMC, IntsmcGains(1.02, C, 10.0, 10.0, 5.0, 0.9).vector())


def ntsmc_twin() -> Controller:
    """All ours: on s = 0 the same two poles, the same K and rate inside the layer."""
    return Controller(NTSMC, NtsmcGains((5.0 / 3.0, 9.0), (1.05, 1.05), 10.0, 0.11, 0.9).vector())


def corrected() -> Controller:
    """The integral terminal law with exponents below 1; all ours: three poles at 3 1/s if they were 1."""
    return Controller(INTEGRAL_TERMINAL, IntegralTerminalGains(0.9, (9.0, 27.0, 27.0), 10.0, 1.0).vector())


OURS, TWIN, BEST = "INTSMC", "NTSMC", "integral terminal law (ours)"
PLANT: Final = (
    "Plant: the corrected model of four states with the papers' parameters (docs/errata.md), M = 270 kg, L = 1 m, no "
    "leaks and no end stops, valve within 10 V, supply 14 MPa, tank 0.9 MPa; the start in B at 6 MPa and in A so that "
    "the acceleration is 0. Control from the true state, f and b of x''' = f + b u from both pressures, at 10 kHz: a "
    "command held for a whole ms is a disturbance of 1 m/s3, more than table 8's smaller ones."
)
NOTES: Final = (
    "Gains (table 4), plant (table 5) and the RMSE of tracking (table 6) are missing from the text that we have. Ours: "
    "two poles at 3 1/s for both laws, lambda = 10 1/s, exponents near 1 (with 1.1 the end of the way takes 4 s "
    "longer, as exponents above 1 make it), K = 10 m/s3, layers of 5 in sigma and 0.11 in s, bound 0.9 at the "
    "singularity. Each run has its own unknown mass, uniform from 0 to 60 kg.",
    "What INTSMC gains over NTSMC by its integral depends on what disturbs: at 1 kHz, where the held command does, it "
    "is within 5 mm sooner in both experiments (2.2 s against 2.7 s to the origin) and all its errors on the path are "
    "smaller (RMSE of x 8.5 against 12.6 mm).",
    PLANT,
)
PRESSURES: Final = ("lowest pressure, MPa", "highest pressure, MPa")
CONTROLLERS: Final = {OURS: intsmc, TWIN: ntsmc_twin, BEST: corrected}
STATE_ROWS: Final = (
    Row("x, m", 0, reference=True), Row("v, m/s", 1, reference=True), Row("a, m/s2", 2, reference=True)
)  # fmt: skip
ERROR_ROWS: Final = tuple(
    row._replace(label=f"error of {row.label}", reference=False, error=True) for row in STATE_ROWS
)


def drawn(caption: str, *rows: Row, until_s: float = RUN_S) -> Figure:
    """A figure of these panels."""
    return Figure(caption, rows_drawn(rows, until_s=until_s))


def within_pressures(*names: str) -> Callable[[Results], bool]:
    """Between vacuum and supply, in the median run."""
    return lambda results: all(
        bool(results[name].medians[6] >= 0.0 and results[name].medians[7] <= 1e-6 * SUPPLY_PA) for name in names
    )


EXPERIMENTS: Final = (
    Experiment(
        "p3-intsmc-origin", "cylinder of uncertain mass to the origin", "P3, INTSMC paper, figures 7 to 9",
        (*COLUMNS, *PRESSURES), loaded(ORIGIN), CONTROLLERS, {OURS: (0.08,), TWIN: (0.11,)},
        (
            PaperClaim("the states reach the origin (here: x within 5 mm in 5 s)", below(5.0, AFTER, OURS)),
            PaperClaim("INTSMC converges more rapidly than NTSMC (with our gains)", smaller(TIME, OURS, TWIN)),
            PaperClaim("INTSMC's RMSE is below NTSMC's (with our gains)", smaller(0, OURS, TWIN)),
            PaperClaim("an RMSE of 0.08 and 0.11 m", None, "gains and duration are not available"),
            PaperClaim("the chamber pressures stay acceptable (here: 0 to 14 MPa)", within_pressures(OURS, TWIN)),
        ),
        (*NOTES, "10 s. The origin is an end of the stroke, which a plant with end stops would touch."),
        Metric("RMSE, others as named", with_pressures), 0, along(ORIGIN), DT_S,
        {
            "p3-intsmc-figure7": drawn("INTSMC paper, figure 7: states, the first 6 s", *STATE_ROWS, until_s=6.0),
            "p3-intsmc-figure8": drawn("INTSMC paper, figure 8: command, the first 6 s", Row("u, V", 3), until_s=6.0),
            "p3-intsmc-figure9": drawn(
                "INTSMC paper, figure 9: pressures, the first 6 s", Row("A, MPa", 5), Row("B, MPa", 6), until_s=6.0
            ),
        },
    ),
    Experiment(
        "p3-intsmc-track", "cylinder of uncertain mass along 0.15 sin 2t + 0.3",
        "P3, INTSMC paper, table 6, figures 10 to 13", (*COLUMNS, *PRESSURES, "x after 5 s, m"), loaded(SINE),
        CONTROLLERS, {},
        (
            PaperClaim("INTSMC tracks the trajectory (here: x within 5 mm in 5 s)", below(5.0, AFTER, OURS)),
            PaperClaim("INTSMC reaches the path sooner than NTSMC (with our gains)", smaller(TIME, OURS, TWIN)),
            PaperClaim("INTSMC's errors are smaller in all states (with our gains)", less(slice(0, 3), OURS, TWIN)),
            PaperClaim("after 5 s INTSMC's error is smaller (with our gains)", smaller(LATER, OURS, TWIN)),
            PaperClaim("the RMSE of table 6", None, "gains and table are not available"),
        ),
        (
            *NOTES, "20 s. The RMSE is that of the start. Later, what held commands and the unknown mass leave within "
            "the layers is smaller with INTSMC.",
        ),
        Metric("RMSE, others as named", and_later), 0, along(SINE), DT_S,
        {
            "p3-intsmc-figure10": drawn("INTSMC paper, figure 10: states, the first 8 s", *STATE_ROWS, until_s=8.0),
            "p3-intsmc-figure11": drawn("INTSMC paper, figure 11: errors, the first 8 s", *ERROR_ROWS, until_s=8.0),
            "p3-intsmc-figure12": drawn(
                "INTSMC paper, figure 12: command and sliding variables, the first 8 s", Row("u, V", 3),
                Row("sigma, m/s", 4, (OURS,)), Row("s, m", 4, (TWIN,)), until_s=8.0,
            ),
            "p3-intsmc-figure13": drawn(
                "INTSMC paper, figure 13: pressures, the first 8 s", Row("A, MPa", 5), Row("B, MPa", 6), until_s=8.0
            ),
        },
    ),
)  # fmt: skip
