"""The simulated plant behind CAN frames: truth, sensors, and its own watchdog on the command.

As with the cylinder's node, per step the plant first moves with the inputs as they stood, then is measured, then
commands are read: a command acts from the next period on.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.integrate import STAGES
from servohil.sim_bench.actuator_node import NS_PER_S, TruthLog
from servohil.sim_bench.plant_rig.bus import plant_codec
from servohil.sim_bench.plant_rig.rig import APPLIED, COMMAND, PlantRig
from servohil.sim_bench.plants.simulate import compiled_drive


def truth_rows(rig: PlantRig) -> np.dtype[Any]:
    """A row of the truth's log: time ns, state after the period, inputs in force over it."""
    return np.dtype([("t_ns", "<i8"), ("x", "<f8", (rig.truth.n,)), ("u", "<f8", (rig.truth.n_u,))])


class PlantNode:
    """One plant on the bus.

    Args:
        rig: what to simulate.
        log: of rows `truth_rows(rig)`.

    Fields:
        x: (n,) the true state.
        u: (n_u,) the inputs in force.
    """

    def __init__(self, rig: PlantRig, log: TruthLog) -> None:
        model = rig.truth
        self.rig = rig
        self.log = log
        self.period_ns = rig.period_ns
        self.codec = plant_codec(rig, node=True)
        self._command = self.codec.message_index(COMMAND)
        self._command_slots = [self.codec.slot(f"{COMMAND}.{name}") for name in rig.inputs]
        self._applied = self.codec.message_index(APPLIED)
        self._order = [list(rig.inputs).index(path.partition(".")[2]) for path in self._paths(self._applied)]
        self._outputs = [self.codec.message_index(name) for name in rig.outputs]
        self._slots = [self.codec.slots(index)[0] for index in self._outputs]
        self._low, self._high = self.codec.minimum[self._slots], self.codec.maximum[self._slots]
        self._rng = np.random.default_rng(rig.seed)
        self._process_std = np.broadcast_to(np.asarray(rig.process_std, dtype=np.float64), model.n)
        self._sensor_std = np.asarray(rig.sensor_std, dtype=np.float64)
        self._drive = compiled_drive(model)
        self._y = np.empty((1, model.m))
        self._state_after = np.empty((1, model.n))
        self._stages = np.empty(STAGES * model.n)
        self._timeout_ns = int(rig.command_timeout_s * NS_PER_S)
        self._last_command_ns = 0
        self.x = np.array(rig.x0, dtype=np.float64)
        self.u = np.zeros(model.n_u)

    def _paths(self, message: int) -> list[str]:
        return [self.codec.paths[slot] for slot in self.codec.slots(message)]

    def step(self, frames: NDArray[np.void], n_frames: int, t_ns: int, periods: int) -> Sequence[tuple[int, bytes]]:
        """Advance by `periods`, measure, then take the commands in `frames[:n_frames]`; returns the frames to send.

        Raises:
            ValueError: the true state is not finite any more: names the time.
        """
        for missed in range(periods - 1, -1, -1):
            self._advance(t_ns - missed * self.period_ns)
        outgoing = self._measure()
        self._take_commands(frames, n_frames, t_ns)
        return outgoing

    def _advance(self, t_ns: int) -> None:
        noise = self._process_std * self._rng.standard_normal(len(self.x))
        self._drive(self.x, self.rig.truth.p, self.u[None], noise[None], self._state_after, self._y, self._stages)
        if not np.isfinite(self.x).all():
            raise ValueError(f"{self.rig.name}: the true state {self.x} at {t_ns / NS_PER_S:.3f} s is not finite")
        self.log.append((t_ns, self.x, self.u))

    def _measure(self) -> list[tuple[int, bytes]]:
        codec = self.codec
        readings = self._y[0] + self._sensor_std * self._rng.standard_normal(len(self._sensor_std))
        # A sensor saturates at the end of its range, it does not fall silent.
        readings = np.minimum(np.maximum(readings, self._low), self._high)
        sent = [(codec.messages[self._applied].frame_id, codec.encode(self._applied, self.u[self._order]))]
        for index, reading in zip(self._outputs, readings, strict=True):
            sent.append((codec.messages[index].frame_id, codec.encode(index, np.array([reading]))))
        return sent

    def _take_commands(self, frames: NDArray[np.void], n_frames: int, t_ns: int) -> None:
        codec = self.codec
        codec.receive(frames, n_frames, t_ns)
        if codec.fresh[self._command]:
            self._last_command_ns = t_ns
            self.u = codec.values[self._command_slots]
        elif t_ns - self._last_command_ns > self._timeout_ns:
            self.u = np.zeros(len(self.u))
