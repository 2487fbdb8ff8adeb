"""P2's combined filter as a leak detector: its switching index beside the diagnosis, on the same cylinder."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import CombinedSecondOrderFilter, Model
from servohil.hil import assemble
from servohil.hil.config import Rig
from servohil.sim_bench.evaluations.leakage_bench import CYCLES_PER_S, LeakageBench
from servohil.sim_bench.evaluations.leakage_episode import place
from servohil.sim_bench.evaluations.leakage_faults import index_faults
from servohil.sim_bench.evaluations.leakage_loop import MEASURED_U, MEASURED_Y

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

WINDOWS: Final = (1.0, 50.0)  # steps: P2's, and our default
HEALTHY_S: Final = 600.0
PIECE_S: Final = 60.0
WATCH_S: Final = 20.0


def group_of(window: float) -> str:
    """Of the rows, in the campaign's table."""
    return f"index {window:g}"


@dataclass(frozen=True)
class SwitchingDetector:
    """The combined filter with the model and the noise that the diagnosis of `bench` has, at this moment.

    Attributes:
        filter: started where the diagnosis' own filter is.
        to_u, to_y: (3,) added to inputs and outputs: what commissioning found of null and sensors.
    """

    filter: CombinedSecondOrderFilter
    to_u: Vector
    to_y: Vector

    @classmethod
    def beside(cls, bench: LeakageBench, rig: Rig, window: float) -> "SwitchingDetector":
        """With an index that forgets over so many steps."""
        p, to_u, to_y = bench.learnt_model()
        start, covariance = bench.twin_estimate()
        likeness = assemble.build_model(rig)
        model = Model(likeness.f, likeness.h, likeness.n, likeness.m, p, likeness.dt, n_u=likeness.n_u)
        q = assemble.process_covariance(rig, rig.leakage.process_std)
        r = assemble.measurement_covariance(rig.leakage.measurement_std or rig.estimator.measurement_std)
        return cls(CombinedSecondOrderFilter(model, start, covariance, q, r, window=window), to_u, to_y)

    def indices(self, log: Matrix) -> Vector:
        """(N,) switching index after each row of a log of every cycle."""
        inputs = log[:, MEASURED_U : MEASURED_U + 3] + self.to_u
        samples = log[:, MEASURED_Y : MEASURED_Y + 3] + self.to_y
        found = np.empty(len(log))
        for k, (u, y) in enumerate(zip(inputs, samples, strict=True)):
            self.filter.step(u, y)
            found[k] = self.filter.switching_index
        return found


def switching_rows(bench: LeakageBench, rig: Rig, phases: Vector) -> list[dict[str, Any]]:
    """How soon the index says what it did not say in ten healthy minutes, for every leak of `index_faults`.

    Args:
        bench: commissioned; only copies of it are used.
        rig: that of `bench`.
        phases: of the motion at the onset, one per fault, 0 to 1.

    Returns:
        group (by window), fault, threshold, detected_s (None: not in WATCH_S).
    """
    rows = []
    for window in WINDOWS:
        threshold = _largest_healthy(bench.copy(), rig, window)
        for fault, phase in zip(index_faults(group_of(window)), phases, strict=True):
            broken = bench.copy()
            place(broken, fault, float(phase))
            detector = SwitchingDetector.beside(broken, rig, window)
            above = detector.indices(_cycles(broken, WATCH_S)) > threshold
            after = float(above.argmax() + 1) / CYCLES_PER_S if above.any() else None
            rows.append({"group": fault.group, "fault": fault.name, "threshold": threshold, "detected_s": after})
    return rows


def _largest_healthy(bench: LeakageBench, rig: Rig, window: float) -> float:
    detector = SwitchingDetector.beside(bench, rig, window)
    pieces = range(round(HEALTHY_S / PIECE_S))
    return max(float(detector.indices(_cycles(bench, PIECE_S)).max()) for _ in pieces)


def _cycles(bench: LeakageBench, seconds: float) -> Matrix:
    return bench.run(seconds, round(seconds * CYCLES_PER_S))
