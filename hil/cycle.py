"""The cycle: one pure function of (state, inputs) to (state, Snapshot, command frame). No clock, no I/O, no randomness.

Its state is one arena (`Cycle.arena`), which every component lives in: saving its bytes is a checkpoint, and the same
bytes with the same inputs give the same Snapshots, bit for bit, on the same build.
"""

from math import isfinite, nan
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.control.laws import law
from servohil.drivers.codec import Kind
from servohil.estimators.health import DIVERGED, GATED, NOT_FINITE_INPUT, REPAIRED
from servohil.estimators.leakage import residual_monitor
from servohil.estimators.leakage.levels import ALARM
from servohil.hil import assemble, events, parameters, supervision, valve_watch
from servohil.hil.arena import Arena
from servohil.hil.commands import Command, Result
from servohil.hil.config import Rig
from servohil.hil.control_word import control_word
from servohil.hil.estimation import Estimation
from servohil.hil.events import SensorView
from servohil.hil.gate import POWER_UP, DeviceState, Event, GateState, gate, gate_limits
from servohil.hil.inputs import InputsHeader
from servohil.hil.reactions import load_reactions
from servohil.hil.sensing import Sensing
from servohil.hil.snapshot import SnapshotRecord
from servohil.hil.tracking import Tracking

NS_PER_S: Final = 1_000_000_000
LONGEST_PREDICTION: Final = 200  # periods; after a longer gap the filter starts anew from the next measurement
HOLD, ACTIVE, INIT = int(DeviceState.HOLD), int(DeviceState.ACTIVE), int(DeviceState.INIT)
SENSOR_STALE, SECOND_COMMANDER = int(Event.SENSOR_STALE), int(Event.SECOND_COMMANDER)
LEAK_ALARM, BUS_OFF = int(Event.LEAK_ALARM), int(Event.BUS_OFF)
OWN_ID: Final = int(Kind.OWN_ID)
FILTER_TROUBLE: Final = GATED | REPAIRED | NOT_FINITE_INPUT | DIVERGED

(
    DEVICE, GOAL, FAULT, RAMP_LEFT, FIRST_ACTIVE, STARTED, OVERRUNS, OVERRUNS_IN_A_ROW, REJECTED, REPAIRS,
    COMMAND_SEQ, COMMAND_RESULT, PARAM_VERSION, LEAK_SINCE, OTHER_COMMANDERS, DOUBT, N_WORDS,
) = range(17)  # fmt: skip


class Cycle:
    """One controller, ready to run.

    Args:
        rig: the configuration.
        listen_only: shadow mode: the command message is received instead of sent, and is what the filter takes as
        input.

    Raises:
        DbcError, GainError, ReferenceError, ValueError: what of the configuration cannot work, named.
    """

    def __init__(self, rig: Rig, listen_only: bool = False) -> None:
        self.rig = rig
        self.listen_only = listen_only
        self.period_ns = rig.loop.period_ns
        self.dt = self.period_ns / NS_PER_S
        command = assemble.command_message(rig)
        sensors = assemble.sensor_messages(rig)
        self.codec = assemble.load_bus_codec(
            rig, receive=[*sensors, command] if listen_only else sensors, transmit=[] if listen_only else [command]
        )
        codec_f8, codec_i8 = self.codec.state_size
        self.arena = Arena(
            f8={
                "motion": Tracking.motion_size(rig),
                "codec": codec_f8,
                **assemble.filter_sizes(rig),
                "monitor": residual_monitor.ARENA_SIZE,
                "law": law.STATE_SIZE,
                "parameters": parameters.N_PARAMETERS,
                "command": 1,
                "supervision": supervision.SIZE,
                "valve": valve_watch.SIZE,
            },
            i8={"codec": codec_i8, "words": N_WORDS},
        )
        self._words = self.arena.i8["words"]
        self._command_v = self.arena.f8["command"]
        self.codec.attach(self.arena.f8["codec"], self.arena.i8["codec"])
        self.codec.reset()
        self._estimation = Estimation(rig, self.arena.f8)
        self.monitor = assemble.build_monitor(rig, self.arena.f8["monitor"])
        self._reactions = load_reactions(rig.leakage.reaction)
        self._bounds = assemble.build_bounds(rig)
        self._sensing = Sensing(rig, self.codec)
        self._supervision = supervision.Supervision(rig, self.arena.f8["supervision"])
        self._valve = valve_watch.ValveWatch(self.period_ns, self.arena.f8["valve"])
        self._estimate_view = self._estimation.view
        self._tracking = Tracking(rig, self.arena.f8["law"], self.arena.f8["motion"])
        self.parameters = parameters.parameter_table(rig)
        self._tunables = self.arena.f8["parameters"]
        self._tunables[: len(self.parameters)] = [entry.value for entry in self.parameters]
        self._apply_parameters()
        self._record = SnapshotRecord()
        self.snapshot = self._record.row
        self.snapshot_bytes = self._record.bytes
        self._residuals, self._variances = np.zeros(2), np.ones(2)
        self._command_values, self.command_id = np.zeros(0), 0
        if not listen_only:
            self._command_index = self.codec.message_index(command)
            self.command_id = self.codec.transmit_ids[0]
            slots = list(self.codec.slots(self._command_index))
            self._command_values = np.zeros(len(slots))
            self._voltage_at = slots.index(self.codec.slot(rig.signals.command))
            self._word_at = slots.index(self.codec.slot(rig.signals.control_word))
        else:
            self._observed_slot = self.codec.slot(rig.signals.command)
        self._words[[FIRST_ACTIVE, LEAK_SINCE]] = -1
        self._keep(POWER_UP)

    def step(self, header: Any, frames: NDArray[Any]) -> bytes:
        """One cycle: fills `self.snapshot` and returns the data bytes of the command frame (empty in shadow mode).

        Args:
            header: a record of INPUTS_HEADER.
            frames: (>= n_frames,) of FRAME, the frames drained in this cycle.
        """
        words = self._words
        inputs = InputsHeader._make(header.item())
        skipped, t_ns = inputs.skipped, inputs.t_ns
        words[OVERRUNS] += skipped > 0
        words[OVERRUNS_IN_A_ROW] = words[OVERRUNS_IN_A_ROW] + 1 if skipped else 0
        words[REJECTED] += self.codec.receive(frames, inputs.n_frames, t_ns)
        sensed = self._sensing.read(t_ns, self._valve_in_force())
        status = self._estimate(sensed.complete, skipped, self._moving())
        command, result = self._operator(inputs)
        found = self._events(inputs, sensed, status)
        device = int(words[DEVICE])
        found |= LEAK_ALARM if self._diagnose(sensed.complete, skipped, t_ns) else 0
        x = self._estimate_view.x
        requested = self._tracking.command(
            device, inputs.cycle, x, self._sensing.u, float(self._command_v[0]), self._limits, 1 + skipped
        )
        ready = bool(words[STARTED]) and not found & SENSOR_STALE
        decision = gate(
            self._gate_state(), found, command, requested, ready, self._reactions, self._limits, 1 + skipped
        )
        self._keep(decision.state)
        if decision.state.device_state != device:
            self._enter(inputs.cycle)
        if inputs.command_seq:
            words[COMMAND_SEQ] = inputs.command_seq
            words[COMMAND_RESULT] = decision.result if result == Result.NONE else result
        frame = b"" if self.listen_only else self._encode(decision.permitted_v, decision.state.device_state)
        self._fill(inputs, sensed, status, decision.events, requested)
        return frame

    def zero_frame(self) -> bytes:
        """A command frame with zero volts and every enable bit off: the last word on the bus."""
        return self._encode(0.0, DeviceState.INIT)

    def _encode(self, command_v: float, device: int) -> bytes:
        values = self._command_values
        values[self._voltage_at] = command_v
        values[self._word_at] = control_word(device)
        return self.codec.encode(self._command_index, values)

    def _valve_in_force(self) -> float:
        if self.listen_only:
            observed = float(self.codec.values[self._observed_slot])
            return observed if isfinite(observed) else 0.0
        return float(self._command_v[0])

    def _moving(self) -> bool:
        """Whether what the diagnosis sees is the motion that it judges."""
        return bool(self._words[DEVICE] == ACTIVE or (self.listen_only and self._words[STARTED]))

    def _estimate(self, complete: bool, skipped: int, moving: bool) -> int:
        """Predict over the past interval and the skipped ones, correct with what came; returns the filter's status."""
        words, estimation = self._words, self._estimation
        y, u = self._sensing.y, self._sensing.u
        if skipped > LONGEST_PREDICTION:
            words[STARTED] = 0
        if not words[STARTED]:
            if complete:
                estimation.start(y)
                words[STARTED] = 1
            return 0
        saturated = abs(u[0]) >= self._limits.command_max_v - self.rig.control.dead_band_v
        estimation.hold(saturated or words[DOUBT] != 0)
        estimation.predict(u, skipped, moving)
        status = estimation.step(u, y, moving)
        words[REPAIRS] += (status & FILTER_TROUBLE) != 0
        return status

    def _operator(self, inputs: InputsHeader) -> tuple[int, Result]:
        """What of the operator's command concerns the gate, and the result of what does not."""
        code = inputs.command_code
        if code == Command.SET_PARAM:
            index, value = inputs.command_index, inputs.command_value
            result = parameters.change(self._tunables, index, value, self.parameters, self.rig)
            if result == Result.ACCEPTED:
                self._words[PARAM_VERSION] += 1
                self._apply_parameters()
            return Command.NONE, result
        if code == Command.ACKNOWLEDGE:
            self.monitor.acknowledge()
            self._estimation.diagnosis.acknowledge()
            return Command.NONE, Result.ACCEPTED
        if self.listen_only and code in (Command.ENABLE, Command.HOLD):
            return Command.NONE, Result.REFUSED_STATE  # nothing is sent: it must not look as if it were
        return code, Result.NONE

    def _apply_parameters(self) -> None:
        """Bring everything that is derived from the tunables in line with them; also after a restored checkpoint."""
        values = self._tunables
        limits = self.rig.limits
        self.monitor.arena[residual_monitor.THRESHOLD_SIGMA] = values[parameters.THRESHOLD_SIGMA]
        self.monitor.arena[residual_monitor.CUSUM_THRESHOLD] = values[parameters.CUSUM_THRESHOLD]
        parameters.put_into_gains(values, self.parameters, self._tracking.gains, self.rig.control.law)
        self._limits = gate_limits(
            float(values[parameters.COMMAND_MAX]), limits.command_slew_v_per_s, limits.ramp_down_s, self.dt
        )

    def restore(self, checkpoint: bytes) -> None:
        """Continue from a checkpoint (`arena.save()`). Raises ValueError if it belongs to another configuration."""
        self.arena.restore(checkpoint)
        self._apply_parameters()

    def _events(self, inputs: InputsHeader, sensed: SensorView, status: int) -> int:
        words, limits, view, skipped = self._words, self.rig.limits, self._estimate_view, inputs.skipped
        found = events.loop_events(int(words[OVERRUNS_IN_A_ROW]), limits.overruns_hold, limits.overruns_fault)
        if words[STARTED]:
            found |= events.sensor_events(sensed, self._bounds, skipped * self.period_ns)
            found |= events.estimate_events(float(view.x[1]), self._bounds, bool(status & DIVERGED))
            found |= self._supervision.events(sensed.position_m, view.innovation_m, inputs.tx_failed, 1 + skipped)
        driven = words[DEVICE] in (HOLD, ACTIVE) and not self.listen_only
        found |= self._valve.event(driven, float(self._command_v[0]), sensed.spool_v, sensed.status_word)
        others = 0 if self.listen_only else int(self.codec.counters[self._command_index, OWN_ID])
        if others > words[OTHER_COMMANDERS]:
            words[OTHER_COMMANDERS] = others
            found |= SECOND_COMMANDER
        return found | (BUS_OFF if inputs.bus_flags else 0)

    def _diagnose(self, complete: bool, skipped: int, t_ns: int) -> bool:
        """Run the residual test, and look what the diagnosis says; returns whether its leak alarm stands."""
        words, diagnosis = self._words, self._estimation.diagnosis
        residuals, variances = self._residuals, self._variances
        residuals[:] = nan
        if complete and not skipped:
            self._estimation.pressure_residuals(residuals, variances)
        monitor, alarm = self.monitor, diagnosis.alarm
        monitor.step(residuals, variances, self._moving() and not diagnosis.learning)
        if not alarm or words[LEAK_SINCE] < 0:
            words[LEAK_SINCE] = t_ns if alarm else -1
        # Of the model: the residual test is quicker, the diagnosis knows better within a second.
        doubt = bool(alarm or diagnosis.pending or (monitor.alarm and monitor.age * self.dt < 1.0))
        if doubt != words[DOUBT]:
            words[DOUBT] = doubt
            self._estimation.forget_noise()
            if not doubt:
                monitor.acknowledge()
        return alarm == ALARM

    def _enter(self, cycle: int) -> None:
        """The device state changed: every entry starts at the measured position, at rest, with a fresh law."""
        words = self._words
        self._tracking.enter(self._estimate_view.x, cycle)
        if words[DEVICE] == ACTIVE:
            parameters.put_into_profile(self._tunables, self.parameters, self._tracking.profile)
            if words[FIRST_ACTIVE] < 0:
                words[FIRST_ACTIVE] = cycle

    def _gate_state(self) -> GateState:
        device, goal, fault, ramp_left = self._words[:FIRST_ACTIVE].tolist()
        return GateState(device, goal, fault, ramp_left, float(self._command_v[0]))

    def _keep(self, state: GateState) -> None:
        words = self._words
        words[DEVICE], words[GOAL], words[FAULT], words[RAMP_LEFT], self._command_v[0] = state

    def _fill(self, inputs: InputsHeader, sensed: SensorView, status: int, found: int, requested: float) -> None:
        """Write this cycle's Snapshot, in the order of `snapshot.FIELDS`."""
        monitor, tracking, record = self.monitor, self._tracking, self._record
        (
            device, _, fault, _, first_active, _, overruns, _, rejected, repairs,
            command_seq, command_result, param_version, leak_since, _, _,
        ) = self._words.tolist()  # fmt: skip
        active_t_ns = (inputs.cycle - first_active) * self.period_ns if first_active >= 0 else -1
        record.integers[:] = (
            inputs.cycle, inputs.t_ns, active_t_ns, device, found, fault, inputs.skipped, overruns,
            inputs.lateness_ns, inputs.exec_ns, inputs.n_frames, rejected, inputs.tx_failed, status, repairs,
            self._estimation.diagnosis.alarm, monitor.channels, leak_since, command_seq, command_result, param_version,
        )  # fmt: skip
        record.measured[:] = sensed[:6]
        self._estimate_view.to_si(record.estimate, record.deviation)
        record.rest[:] = (
            self._estimate_view.nis, *tracking.reference.tolist(), tracking.sigma, requested, self._command_v[0],
            *self._residuals.tolist(), monitor.threshold_a_pa, monitor.threshold_b_pa, monitor.cusum_a, monitor.cusum_b,
            monitor.cusum_threshold,
        )  # fmt: skip
        self._estimation.noise(record.noise)
        record.law[0], record.cpu[0] = tracking.flags, inputs.cpu_ns
        self._estimation.diagnosis.report(record.diagnosis_integers, record.diagnosis)
