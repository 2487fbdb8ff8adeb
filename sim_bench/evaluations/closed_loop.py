"""One closed loop in lockstep: estimated states, encoded frames, sensor noise, quantisation, a truth of its own."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.config import Rig
from servohil.hil.config.effective import effective_tables
from servohil.hil.cycle import Cycle
from servohil.hil.lockstep import run_lockstep
from servohil.hil.operator_script import OperatorScript
from servohil.hil.snapshot import SNAPSHOT
from servohil.sim_bench.actuator_node import NS_PER_S, ActuatorNode, LeakPlan, TruthLog

Vector = NDArray[np.float64]

SETTLED_M: Final = 0.5e-3


@dataclass(frozen=True)
class Case:
    """What differs from the rig file.

    Attributes:
        control: the [control] table.
        truth: of [plant.cylinder].
        imperfections: of [plant.imperfections].
        tables: other tables to merge in, e.g. {"reference": {...}}.
        leak: opens on the way.
        load_n: force that sets in `load_at_s` after enabling.
    """

    control: dict[str, Any]
    truth: dict[str, float] = field(default_factory=dict)
    imperfections: dict[str, Any] = field(default_factory=dict)
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    leak: LeakPlan | None = None
    load_n: float = 0.0
    load_at_s: float = 0.0


@dataclass(frozen=True)
class Loop:
    """A run, cycle by cycle, from the first ACTIVE one on: time s, true position and reference m, command V."""

    time: Vector
    position: Vector
    reference: Vector
    command: Vector
    faulted: bool

    def error(self, start_s: float) -> Vector:
        """True position minus reference, m, from `start_s` on."""
        return np.asarray((self.position - self.reference)[self.time >= start_s])

    def rmse_m(self, start_s: float) -> float:
        """Root mean square of the error; NaN for a run that ended in a fault."""
        return float(np.sqrt(np.mean(np.square(self.error(start_s))))) if not self.faulted else float("nan")

    def settling_s(self, start_s: float = 0.0) -> float:
        """Time after `start_s` from which the error stays within half a millimetre; inf: never."""
        outside = np.flatnonzero((np.abs(self.position - self.reference) > SETTLED_M) & (self.time >= start_s))
        if self.faulted or (outside.size and outside[-1] == len(self.time) - 1):
            return float("inf")
        return float(self.time[outside[-1] + 1] - start_s) if outside.size else 0.0

    def chatter_v(self, start_s: float) -> float:
        """Mean change of the command per cycle, V."""
        return float(np.mean(np.abs(np.diff(self.command[self.time >= start_s]))))

    def effort_v(self, start_s: float) -> float:
        """Mean magnitude of the command, V."""
        return float(np.mean(np.abs(self.command[self.time >= start_s])))


class LoadedNode(ActuatorNode):
    """The bench's node with a load force that sets in on the way."""

    def __init__(self, rig: Rig, case: Case, log: TruthLog) -> None:
        super().__init__(rig, case.leak, log)
        self._load_n = case.load_n
        self._load_at_ns = int(case.load_at_s * NS_PER_S)

    def step(self, frames: NDArray[np.void], n_frames: int, t_ns: int, periods: int) -> Any:
        """As the node's, the load before it."""
        if self._load_n and self.active_since_ns >= 0 and t_ns - self.active_since_ns >= self._load_at_ns:
            self.plant.set_load(self._load_n)
            self._load_n = 0.0
        return super().step(frames, n_frames, t_ns, periods)


def rig_of(rig: Rig, case: Case, seed: int) -> Rig:
    """The rig with the case's tables.

    Raises:
        ValidationError: a table breaks a rule.
    """
    tables = effective_tables(rig, seed=seed)
    tables["control"] = case.control
    tables["plant"]["cylinder"] = {**tables["plant"]["cylinder"], **case.truth}
    tables["plant"]["imperfections"] = {**tables["plant"]["imperfections"], **case.imperfections}
    for name, values in case.tables.items():
        tables[name] = {**tables[name], **values} if values.get("kind") is None else values
    return Rig.model_validate(tables).at(rig.path)


def run_loop(rig: Rig, case: Case, duration_s: float, seed: int) -> Loop:
    """Close the loop for `duration_s` of ACTIVE.

    Raises:
        GainError, ProfileError, ValueError: what of the case cannot work.
    """
    own = rig_of(rig, case, seed)
    cycle = Cycle(own)
    log = TruthLog(int((duration_s + 5.0) * own.loop.rate_hz))
    node = LoadedNode(own, case, log)
    script = OperatorScript(own.loop.rate_hz, duration_s, enable=True, stop_on_fault=True)
    rows: list[bytes] = []
    run_lockstep(cycle, node, script, lambda snapshot, _: rows.append(bytes(snapshot)))
    snapshots = np.frombuffer(b"".join(rows), dtype=SNAPSHOT)
    truth = log.rows()[: len(snapshots)]
    active = snapshots["active_t_ns"] >= 0
    followed = active & np.isfinite(snapshots["ref_position_m"]) & (snapshots["active_t_ns"] < duration_s * NS_PER_S)
    return Loop(
        snapshots["active_t_ns"][followed] / NS_PER_S,
        truth["position_m"][followed].copy(),
        snapshots["ref_position_m"][followed].copy(),
        snapshots["command_v"][followed].copy(),
        bool(snapshots["fault"].any()) or not followed.any(),
    )
