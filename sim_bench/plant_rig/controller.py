"""The other end of a plant rig's bus: a filter on what comes, a law on the estimate, the command on the bus.

For the desk: it has no safety gate. A machine is driven by `hil run`.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.filter import Filter
from servohil.sim_bench.actuator_node import NS_PER_S, TruthLog
from servohil.sim_bench.plant_rig.bus import plant_codec
from servohil.sim_bench.plant_rig.rig import APPLIED, COMMAND, PlantRig, PlantRigError

Vector = NDArray[np.float64]
Law = Callable[[float, Vector], Sequence[float]]  # (time s, estimate (n,)) -> inputs


def estimate_rows(rig: PlantRig, n: int) -> np.dtype[Any]:
    """A row of the controller's log; NaN in y: nothing came. x and its standard deviation: of the filter's n states."""
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = [
        ("t_ns", "<i8"), ("y", "<f8", (rig.truth.m,)), ("command", "<f8", (rig.truth.n_u,)), ("x", "<f8", (n,)),
        ("std", "<f8", (n,)), ("nis", "<f8"),
    ]  # fmt: skip
    return np.dtype(fields)


class PlantController:
    """One controller on the bus.

    Args:
        rig: whose bus it is on.
        filter_: estimates the state from the outputs and the inputs in force.
        law: from time and estimate to the inputs; what exceeds an input's range is cut to it.
        log: of rows `estimate_rows(rig, filter_.model.n)`.

    Raises:
        PlantRigError: the filter's model has other inputs, outputs or another period than the rig.
    """

    def __init__(self, rig: PlantRig, filter_: Filter, law: Law, log: TruthLog) -> None:
        model, truth = filter_.model, rig.truth
        if (model.n_u, model.m) != (truth.n_u, truth.m) or abs(model.dt - truth.dt) > 1e-9 * truth.dt:
            raise PlantRigError(
                f"the filter's model has {model.n_u} inputs, {model.m} outputs, dt = {model.dt} s; rig {rig.name!r} "
                f"has {truth.n_u}, {truth.m}, {truth.dt} s"
            )
        filter_.reset()  # whatever it has seen before
        self.filter = filter_
        self.codec = plant_codec(rig, node=False)
        self.command_id = self.codec.transmit_ids[0]
        self._law = law
        self._log = log
        self._command = self.codec.message_index(COMMAND)
        order = [self.codec.paths[slot].partition(".")[2] for slot in self.codec.slots(self._command)]
        self._order = [list(rig.inputs).index(name) for name in order]
        applied = self.codec.message_index(APPLIED)
        self._applied = applied, [self.codec.slot(f"{APPLIED}.{name}") for name in rig.inputs]
        self._outputs = [(self.codec.message_index(name), self.codec.slot(f"{name}.{name}")) for name in rig.outputs]
        slots = [self.codec.slot(f"{COMMAND}.{name}") for name in rig.inputs]
        self._low, self._high = self.codec.minimum[slots], self.codec.maximum[slots]
        self._u = np.zeros(truth.n_u)
        self.y = np.full(truth.m, np.nan)
        self._missing = np.full(truth.m, np.nan)

    def hear(self, frames: NDArray[np.void], n_frames: int, t_ns: int) -> bool:
        """Take the measurements; whether each output has come. What has not is missing, not old."""
        codec = self.codec
        codec.receive(frames, n_frames, t_ns)
        message, slots = self._applied
        if codec.fresh[message]:
            self._u = codec.values[slots]
        self.y[:] = [codec.values[slot] if codec.fresh[index] else np.nan for index, slot in self._outputs]
        return not np.isnan(self.y).any()

    def step(self, frames: NDArray[np.void], n_frames: int, t_ns: int, start_ns: int, skipped: int = 0) -> bytes:
        """One period: measurements, estimate, command frame; before it, a prediction for each that was skipped.

        Raises:
            PlantRigError: the law returned what cannot be sent: names it and the time.
        """
        for _ in range(skipped):
            self.filter.step(self._u, self._missing)
        self.hear(frames, n_frames, t_ns)
        self.filter.step(self._u, self.y)
        seconds = (t_ns - start_ns) / NS_PER_S
        command = np.array(self._law(seconds, self.filter.x), dtype=np.float64)
        if command.shape != self._low.shape or not np.isfinite(command).all():
            raise PlantRigError(f"law at {seconds:.3f} s gave {command}: must be {len(self._low)} finite numbers")
        command = np.minimum(np.maximum(command, self._low), self._high)
        std = np.sqrt(np.diag(self.filter.P))
        self._log.append((t_ns, self.y, command, self.filter.x, std, self.filter.nis))
        return self._frame(command)

    def zero_frame(self) -> bytes:
        """All inputs 0: the last word on the bus."""
        return self._frame(np.zeros(len(self._low)))

    def _frame(self, command: Vector) -> bytes:
        return self.codec.encode(self._command, command[self._order])
