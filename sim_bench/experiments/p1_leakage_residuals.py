"""P1 section 3.3: pressure residuals of filters that know no leak, and the thresholds they are held against.

P1 compares measured pressures with those "estimated from the system in fault-free conditions" (figure 12), which can be
read in three ways; see `INNOVATION`, `CORRECTED`, `POSITION_ALONE`.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from threading import local
from typing import Final, NamedTuple

import numpy as np

from servohil.estimators import ASRUKF, SRUKF
from servohil.estimators.filter import Filter
from servohil.estimators.models.cylinder import PA_PER_MPA
from servohil.estimators.trajectory import Trajectory
from servohil.sim_bench import noise_scenarios
from servohil.sim_bench.experiments.experiment import Data, Matrix
from servohil.sim_bench.experiments.p1_cylinder import P0, X0
from servohil.sim_bench.noise_scenarios import DT_S, PARAMETERS, Fault, NoiseScenario
from servohil.sim_bench.plants.cylinder import PAPER_LEAKAGE

INNOVATION: Final = "innovation"  # all outputs are measured: measured - predicted pressure
CORRECTED: Final = (
    "after correction"  # all outputs are measured: measured - estimated pressure, after the correction with it
)
POSITION_ALONE: Final = "position alone"  # as P1 estimates: the filter never sees the pressures
READINGS: Final = (INNOVATION, CORRECTED, POSITION_ALONE)

SAGE_HUSA: Final = "ASr-UKF"
LIKELIHOOD: Final = "ASr-UKF, likelihood"
WRONG: Final = "Sr-UKF"
RIGHT: Final = "Sr-UKF that knows Q and R"
FILTERS: Final = (SAGE_HUSA, LIKELIHOOD, WRONG, RIGHT)

START: Final = round(3.0 / DT_S)  # the filters start wrong; nothing is judged before
LEAKING: Final = replace(PARAMETERS, **PAPER_LEAKAGE)
FAULT_FREE_SEEDS: Final = range(1000, 1005)  # of what a threshold is derived from, apart from all judged runs
MARGIN: Final = 1.2


class Condition(NamedTuple):
    """One experiment's noise, start of the filters' Q and R, onset and threshold; variances in m2, (m/s)2, MPa2.

    Attributes:
        q, r: of the process and of position and pressures, outside 4 to 16 s.
        q0, r0: what the filters are told.
        factor: of both noises from 4 to 16 s.
        onset_s: of the leak; the run goes on for 10 s.
        threshold_pa: of P1; None: derived for each filter from its fault-free residual.
    """

    q: tuple[float, float, float, float]
    r: tuple[float, float, float]
    q0: tuple[float, float, float, float]
    r0: tuple[float, float, float]
    factor: float
    onset_s: float
    threshold_pa: float | None

    @property
    def onset(self) -> int:
        """The first step with the leak."""
        return round(self.onset_s / DT_S)

    @property
    def steps(self) -> int:
        """Length of a run."""
        return self.onset + round(10.0 / DT_S)

    def scenario(self, position_only: bool) -> NoiseScenario:
        """The noise as `noise_scenarios` takes it."""
        return NoiseScenario("leakage", "P1 3.3", self.q, self.r, self.factor, position_only)

    def data(self, rng: np.random.Generator) -> Data:
        """One run with the leak of eq. 21 from the onset on."""
        return self._simulated(int(rng.integers(2**31)), Fault(LEAKING, self.onset))

    def fault_free(self, seed: int) -> Data:
        """One run without."""
        return self._simulated(seed, None)

    def _simulated(self, seed: int, fault: Fault | None) -> Data:
        scenario = self.scenario(False)
        inputs, samples, states = noise_scenarios.simulate(scenario, self.steps, seed, fault=fault)
        return Data(inputs, samples, states, *scenario.variances(self.steps))


class Detector(NamedTuple):
    """A filter, how its residual is read, and the condition it works in."""

    condition: Condition
    filter: str
    reading: str

    @property
    def outputs(self) -> int:
        """How many of (position, pressure A, pressure B) the filter measures."""
        return 1 if self.reading == POSITION_ALONE else 3

    def new_filter(self) -> Filter:
        """From zero, the model without a leak."""
        model = noise_scenarios.filter_model(self.condition.scenario(self.reading == POSITION_ALONE))
        q0, r0 = np.diag(self.condition.q0), np.diag(self.condition.r0[: self.outputs])
        if self.filter == SAGE_HUSA:
            return ASRUKF(model, X0, P0, q0, r0, adaptation="sage-husa")
        if self.filter == LIKELIHOOD:
            return ASRUKF(model, X0, P0, q0, r0)
        return SRUKF(model, X0, P0, q0, r0)

    def path(self, data: Data) -> Trajectory:
        """The filter's run over the data."""
        known = {}
        if self.filter == RIGHT:
            for name, variances in (("Q", data.q), ("R", data.r[:, : self.outputs])):
                known[name] = np.einsum("ki,ij->kij", variances, np.eye(variances.shape[1]))
        return self.new_filter().run(data.inputs, data.samples[:, : self.outputs], **known)

    def residuals(self, data: Data) -> Matrix:
        """(N, 2) measured - estimated pressures of A and B, Pa."""
        path = _PATHS.of(self, data)
        found = path.innovation[:, 1:] if self.reading == INNOVATION else data.samples[:, 1:] - path.x[:, 2:]
        return np.asarray(PA_PER_MPA * found)


class _Paths(local):
    """The last run of each thread: two readings look at the same one."""

    run: tuple[Condition, str, int] | None = None
    data: Data | None = None
    path: Trajectory

    def of(self, detector: Detector, data: Data) -> Trajectory:
        run = detector.condition, detector.filter, detector.outputs
        if self.run != run or self.data is not data:
            self.path = detector.path(data)
            self.run, self.data = run, data
        return self.path


_PATHS: Final = _Paths()


@cache
def _largest_fault_free(condition: Condition, filter: str, outputs: int) -> dict[str, Matrix]:
    """(2,) largest residuals of A and B, Pa, in fault-free runs, by the readings of a filter of so many outputs."""
    readings = [Detector(condition, filter, reading) for reading in READINGS]
    readings = [detector for detector in readings if detector.outputs == outputs]
    largest = {detector.reading: np.zeros(2) for detector in readings}
    for seed in FAULT_FREE_SEEDS:
        data = condition.fault_free(seed)
        for detector in readings:
            here = np.abs(detector.residuals(data)[START:]).max(axis=0)
            largest[detector.reading] = np.maximum(largest[detector.reading], here)
    return largest


def thresholds(detector: Detector) -> tuple[float, float]:
    """Of A and B, Pa: P1's, or a margin above the largest residual of fault-free runs."""
    printed = detector.condition.threshold_pa
    if printed is not None:
        return printed, printed
    largest = _largest_fault_free(detector.condition, detector.filter, detector.outputs)[detector.reading]
    a, b = MARGIN * largest
    return float(a), float(b)


def judged(detector: Detector, data: Data) -> Matrix:
    """(N, 4) residuals of A and B, then their thresholds, Pa."""
    residuals = detector.residuals(data)
    return np.hstack([residuals, np.tile(thresholds(detector), (len(residuals), 1))])


def detectors(condition: Condition) -> dict[str, Callable[[], Detector]]:
    """All filters in all readings, by their name on the page."""
    return {
        f"{name}: {reading}": partial(Detector, condition, name, reading) for name in FILTERS for reading in READINGS
    }
