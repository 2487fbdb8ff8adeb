"""P1 section 3.3: a leak of the servo-hydraulic cylinder detected by a fixed threshold (figures 13 and 14)."""

from typing import Final

from servohil.sim_bench.experiments.experiment import Experiment, Figure, Metric, PaperClaim
from servohil.sim_bench.experiments.p1_leakage_figures import draw_residuals
from servohil.sim_bench.experiments.p1_leakage_measures import (
    COLUMNS,
    below,
    detected,
    detects_more,
    hidden,
    measures,
    quiet,
    told_apart,
)
from servohil.sim_bench.experiments.p1_leakage_residuals import (
    INNOVATION,
    LIKELIHOOD,
    READINGS,
    RIGHT,
    SAGE_HUSA,
    WRONG,
    Condition,
    detectors,
    judged,
)

PA: Final = 1e-12  # MPa2 of 1 Pa2
PRINTED_Q, PRINTED_R, PRINTED_START = 1e-5, 1e-4, 1e-10
PRESSURE_STD_PA: Final = 0.01  # of PRINTED_R
# The bench, `rigs/bench.toml`: process noise per millisecond; sensors of 20 um and 0.2 bar.
BENCH_Q, BENCH_R = (0.0, 1e-10, 2.5e-7, 2.5e-7), (4e-10, 4e-4, 4e-4)
BENCH_PRESSURE_STD_PA: Final = 2e4

PAPERS: Final = tuple(f"{SAGE_HUSA}: {reading}" for reading in READINGS)
OTHERS: Final = tuple(f"{WRONG}: {reading}" for reading in READINGS)
PROPERLY: Final = "an alarm within 1 s of the onset and none from 3 s to it, in 95 % of the runs, in some reading"


def in_pascal(variance: float) -> tuple[float, float, float, float]:
    """The printed number for (m, m/s, Pa, Pa) as variances of (m, m/s, MPa, MPa)."""
    return (variance, variance, PA * variance, PA * variance)


def printed(factor: float, onset_s: float, threshold_pa: float) -> Condition:
    """All numbers of the paper in its units."""
    q, r, start = in_pascal(PRINTED_Q), in_pascal(PRINTED_R), in_pascal(PRINTED_START)
    return Condition(q, r[1:], start, start[1:], factor, onset_s, threshold_pa)


def in_megapascal(factor: float, onset_s: float) -> Condition:
    """The numbers of the paper for a state in MPa, as in tables 6 to 8."""
    return Condition(
        (PRINTED_Q,) * 4, (PRINTED_R,) * 3, (PRINTED_START,) * 4, (PRINTED_START,) * 3, factor, onset_s, None
    )  # fmt: skip


def scaled(factor: float, onset_s: float) -> Condition:
    """The bench's noise; Q and R start as far off as in the paper."""
    (q1, q2, q3, q4), (r1, r2, r3) = BENCH_Q, BENCH_R
    a, b = PRINTED_START / PRINTED_Q, PRINTED_START / PRINTED_R
    return Condition(
        BENCH_Q, BENCH_R, (a * q1, a * q2, a * q3, a * q4), (b * r1, b * r2, b * r3), factor, onset_s, None
    )  # fmt: skip


SHARED: Final = (
    'Residual: measured - estimated pressure. P1\'s "estimated from the system in fault-free conditions" is read in '
    "three ways: the innovation of a filter that measures position and both pressures; the same filter's residual "
    "after its correction; a filter that measures the position alone, as P1 estimates, and never sees the pressures. "
    "No filter's model has a leak; the plant has that of eq. 21 from the onset on: internal 1.7e-13, A 2.4e-12, B "
    "1.0e-13 m3/(s Pa), to the tank. `Sr-UKF` keeps the wrong start of Q and R; the one that knows is told both at "
    "every step, and nothing of it adapts.",
    "Not given: input, sample time, run length, initial covariance, alpha, persistence. Chosen: as for tables 6 to 8 "
    "(the start of the plant too); 10 s after the onset. Alarm: either pressure; its delay is that of the first sample "
    "above the threshold after the onset, whatever it did before, 10 s if there is none; false alarms are the times "
    "from 3 s to the onset at which the residual rises above the threshold.",
    "The plant, as P1's, has no vacuum: its lightly damped pressures swing below zero.",
)
IN_PASCAL: Final = (
    "As printed, and in the paper's units: Q = 1e-5 I, R = 1e-4 I, starts and threshold are of m, m/s and Pa, "
    "converted to the MPa of our state. The sensor's noise is 0.01 Pa. But 1e-5 (m/s)2 is 3 mm/s of process noise "
    "in every sample, which moves the pressures by beta A / V x 3 mm/s x 1 ms = 4 kPa until the next: "
    "no filter can predict them to within the threshold. After the correction with a pressure known to 0.01 Pa a "
    "filter with small R leaves next to nothing of a residual, fault or not, but for a few % of the samples.",
)
DERIVED: Final = (
    "The threshold is derived for each filter, reading and chamber: 1.2 times the largest residual from 3 s on of 5 "
    "runs without a leak, which are not among those judged. Margin and number of runs are ours.",
)


def converted(threshold_pa: float, std_pa: float, unit: str) -> tuple[float, str]:
    """The printed threshold in another noise, Pa, and how it was found."""
    ratio = threshold_pa / PRESSURE_STD_PA
    here = ratio * std_pa
    return here, (
        f"{unit} P1's threshold converted with the noise: {threshold_pa:g} Pa is {ratio:g} standard deviations of its "
        f"sensor's 0.01 Pa, and as many of {1e-3 * std_pa:g} kPa are {1e-6 * here:g} MPa, beyond any pressure in the "
        "machine (the supply has 14 MPa)."
    )


def better_than_conventional() -> PaperClaim:
    """The sentence on both filters."""
    return PaperClaim(
        "ASr-UKF's residuals have the better FDD performance than Sr-UKF's (here: proper detection in more runs, in "
        "some reading)", detects_more(PAPERS, OTHERS),
    )  # fmt: skip


def frozen() -> PaperClaim:
    """Ours, of a filter that is right."""
    return PaperClaim(
        "ours: the innovation of a filter with the right Q and R, which does not adapt, detects the fault properly",
        detected(f"{RIGHT}: {INNOVATION}"),
    )


def as_printed(id: str, section: str, factor: float, onset_s: float, threshold_pa: float) -> Experiment:
    """With the printed numbers and threshold."""
    condition = printed(factor, onset_s, threshold_pa)
    number = section.rpartition(" ")[2]
    return Experiment(
        id, f"leak, {constancy(factor)} noise, as printed", section, COLUMNS, condition.data, detectors(condition), {},
        (
            PaperClaim(
                f"the threshold of {threshold_pa:g} Pa allows the fault to be detected properly (here: by ASr-UKF, "
                f"{PROPERLY})", detected(*PAPERS),
            ),
            PaperClaim(
                "in fault-free conditions ASr-UKF's residuals do not exceed it (in 95 % of the runs, in some reading)",
                quiet(*PAPERS),
            ),
            better_than_conventional(), frozen(),
        ),
        (*IN_PASCAL, *SHARED), metric(condition), 0, judged,
        figures={f"p1-figure{number}": Figure(
            f"Figure {number}: residuals over the threshold of {threshold_pa:g} Pa, largest of every 0.1 s; dashed: "
            "onset", draw_residuals,
        )},
    )  # fmt: skip


def with_derived(
    id: str, title: str, section: str, condition: Condition, threshold_pa: float, std_pa: float, unit: str
) -> Experiment:
    """With thresholds from fault-free runs, the printed one converted beside them."""
    here, how = converted(threshold_pa, std_pa, unit)
    number = section.rpartition(" ")[2]
    return Experiment(
        id, f"leak, {constancy(condition.factor)} noise, {title}", section, COLUMNS, condition.data,
        detectors(condition), {},
        (
            PaperClaim(
                f"P1's threshold, converted to {1e-6 * here:g} MPa, allows the fault to be detected properly (here: "
                "by ASr-UKF, in 95 % of the runs, in some reading)", told_apart(here, *PAPERS),
            ),
            PaperClaim(
                "in fault-free conditions ASr-UKF's residuals do not exceed it (in 95 % of the runs, in some reading)",
                below(here, *PAPERS),
            ),
            PaperClaim(
                "a threshold fixed in fault-free conditions allows the fault to be detected properly (here: by "
                f"ASr-UKF, {PROPERLY})", detected(*PAPERS),
            ),
            PaperClaim(
                "in fault-free conditions ASr-UKF's residuals do not exceed that either (in 95 % of the runs, in some "
                "reading)", quiet(*PAPERS),
            ),
            better_than_conventional(), frozen(),
            PaperClaim(
                "ours: adaptation hides the fault: from 5 s after the onset the likelihood form's innovation is above "
                "its threshold less than a fifth as often as that of the filter that knows (which must be so at all)",
                hidden(0.2, f"{LIKELIHOOD}: {INNOVATION}", f"{RIGHT}: {INNOVATION}"),
            ),
        ),
        (how, *DERIVED, *SHARED), metric(condition), 0, judged,
        figures={f"p1-figure{number}-{id.rpartition('-')[2]}": Figure(
            f"Figure {number}, {title}: residuals over their thresholds, largest of every 0.1 s; dashed: onset",
            draw_residuals,
        )},
    )  # fmt: skip


def constancy(factor: float) -> str:
    """What to call a noise."""
    return "constant" if factor == 1.0 else "changing"


def metric(condition: Condition) -> Metric:
    """Of a condition's onset."""
    return Metric("alarms", measures(condition.onset))


def family(id: str, section: str, factor: float, onset_s: float, threshold_pa: float) -> tuple[Experiment, ...]:
    """As printed, with a state in MPa, and physically scaled."""
    return (
        as_printed(id, section, factor, onset_s, threshold_pa),
        with_derived(
            f"{id}-mpa", "printed numbers for MPa", section, in_megapascal(factor, onset_s), threshold_pa, 1e4,
            "The printed numbers for a state in (m, m/s, MPa, MPa), as in tables 6 to 8.",
        ),
        with_derived(
            f"{id}-scaled", "physically scaled", section, scaled(factor, onset_s), threshold_pa,
            BENCH_PRESSURE_STD_PA,
            "Physically scaled: the process noise of rigs/bench.toml, sensors of 20 um and 0.2 bar rms, 1 kHz; Q and R "
            "start at 1e-5 and 1e-6 of the truth, as in P1. Measuring the position alone ASr-UKF loses the pressures "
            "altogether.",
        ),
    )  # fmt: skip


EXPERIMENTS: Final = (
    *family("p1-leakage-constant", "P1 section 3.3.1, figure 13", 1.0, 10.0, 200.0),
    *family("p1-leakage-varying", "P1 section 3.3.2, figure 14", 10.0, 15.0, 50.0),
)
