"""The Snapshot: everything one cycle saw, concluded and sent, as one fixed record of 8-byte fields.

Deterministic in the cycle's state and inputs; copied byte for byte into the ring, the recording and, field by field,
into the Protobuf `State` message. NaN in a measured field means: no valid frame brought this signal in this cycle.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

# (name, type, unit, meaning). The order is the record's layout; append only, and raise SNAPSHOT_VERSION.
FIELDS: Final[tuple[tuple[str, str, str, str], ...]] = (
    ("cycle", "<i8", "1", "cycle number; jumps by 1 + skipped"),
    ("t_ns", "<i8", "ns", "monotonic time of this cycle since the loop started"),
    ("active_t_ns", "<i8", "ns", "time since the first ACTIVE cycle; -1 before"),
    ("state", "<i8", "1", "CiA 408 device state (hil.gate.DeviceState)"),
    ("events", "<i8", "bits", "events seen by the gate in this cycle (hil.gate.Event)"),
    ("fault", "<i8", "bits", "events latched since the last reset"),
    ("skipped", "<i8", "1", "whole periods skipped before this cycle"),
    ("overruns", "<i8", "1", "overruns since the start"),
    ("lateness_ns", "<i8", "ns", "wake-up behind the deadline, previous cycle"),
    ("exec_ns", "<i8", "ns", "execution time, previous cycle"),
    ("rx_frames", "<i8", "1", "frames drained in this cycle"),
    ("rx_rejected", "<i8", "1", "frames refused since the start (CRC, counter, length, range, foreign sender)"),
    ("tx_failed", "<i8", "1", "commands the bus did not take since the start"),
    ("filter_status", "<i8", "1", "status code of the estimator's step"),
    ("filter_repairs", "<i8", "1", "estimator steps that were gated or repaired since the start"),
    ("leak_alarm", "<i8", "1", "0 none, 1 warning, 2 alarm (latched until acknowledged)"),
    ("leak_channel", "<i8", "bits", "residuals beyond their threshold, until explained: 1 pressure A, 2 pressure B"),
    ("leak_since_ns", "<i8", "ns", "t_ns of the warning or alarm, -1 without one"),
    ("command_seq", "<i8", "1", "sequence number of the last operator command or parameter change handled"),
    ("command_result", "<i8", "1", "its result (hil.commands.Result)"),
    ("param_version", "<i8", "1", "counts accepted parameter changes"),
    ("position_m", "<f8", "m", "measured position, 0 = retracted"),
    ("pressure_a_pa", "<f8", "Pa", "measured pressure, chamber A (cap side)"),
    ("pressure_b_pa", "<f8", "Pa", "measured pressure, chamber B (rod side)"),
    ("supply_pa", "<f8", "Pa", "measured supply pressure"),
    ("tank_pa", "<f8", "Pa", "measured return line pressure"),
    ("spool_v", "<f8", "V", "measured spool position, in volts of command"),
    ("est_position_m", "<f8", "m", "estimated position"),
    ("est_velocity_mps", "<f8", "m/s", "estimated velocity"),
    ("est_pressure_a_pa", "<f8", "Pa", "estimated pressure A"),
    ("est_pressure_b_pa", "<f8", "Pa", "estimated pressure B"),
    ("std_position_m", "<f8", "m", "standard deviation of the estimate"),
    ("std_velocity_mps", "<f8", "m/s", "standard deviation of the estimate"),
    ("std_pressure_a_pa", "<f8", "Pa", "standard deviation of the estimate"),
    ("std_pressure_b_pa", "<f8", "Pa", "standard deviation of the estimate"),
    ("nis", "<f8", "1", "normalised innovation squared"),
    ("ref_position_m", "<f8", "m", "reference position"),
    ("ref_velocity_mps", "<f8", "m/s", "its first derivative"),
    ("ref_acceleration_mps2", "<f8", "m/s2", "its second derivative"),
    ("ref_jerk_mps3", "<f8", "m/s3", "its third derivative"),
    ("sliding", "<f8", "1", "sliding variable of the control law, in its own unit (intsmc: m/s); 0 without one"),
    ("law_v", "<f8", "V", "what the control law asked for"),
    ("command_v", "<f8", "V", "what the gate permitted and the frame carries"),
    ("residual_a_pa", "<f8", "Pa", "measured - estimated pressure A"),
    ("residual_b_pa", "<f8", "Pa", "measured - estimated pressure B"),
    ("threshold_a_pa", "<f8", "Pa", "threshold of residual A"),
    ("threshold_b_pa", "<f8", "Pa", "threshold of residual B"),
    ("cusum_a", "<f8", "1", "CUSUM statistic of residual A, in standard deviations"),
    ("cusum_b", "<f8", "1", "CUSUM statistic of residual B, in standard deviations"),
    ("cusum_threshold", "<f8", "1", "alarm level of both CUSUM statistics"),
    ("process_std_position_m", "<f8", "m", "process noise that the filter uses, per millisecond"),
    ("process_std_velocity_mps", "<f8", "m/s", "process noise that the filter uses, per millisecond"),
    ("process_std_pressure_a_pa", "<f8", "Pa", "process noise that the filter uses, per millisecond"),
    ("process_std_pressure_b_pa", "<f8", "Pa", "process noise that the filter uses, per millisecond"),
    ("measurement_std_position_m", "<f8", "m", "measurement noise that the filter uses"),
    ("measurement_std_pressure_a_pa", "<f8", "Pa", "measurement noise that the filter uses"),
    ("measurement_std_pressure_b_pa", "<f8", "Pa", "measurement noise that the filter uses"),
    ("process_doubt_position", "<f8", "1", "relative standard deviation of that estimate; NaN: not estimated"),
    ("process_doubt_velocity", "<f8", "1", "relative standard deviation of that estimate; NaN: not estimated"),
    ("process_doubt_pressure_a", "<f8", "1", "relative standard deviation of that estimate; NaN: not estimated"),
    ("process_doubt_pressure_b", "<f8", "1", "relative standard deviation of that estimate; NaN: not estimated"),
    ("measurement_doubt_position", "<f8", "1", "relative standard deviation of that estimate; NaN: not estimated"),
    ("measurement_doubt_pressure_a", "<f8", "1", "relative standard deviation of that estimate; NaN: not estimated"),
    ("measurement_doubt_pressure_b", "<f8", "1", "relative standard deviation of that estimate; NaN: not estimated"),
    ("law_flags", "<i8", "bits", "of the control law: 1 at a limit, 2 an input was not finite, 4 no authority"),
    ("diagnosis_mode", "<i8", "1", "0 learning, 1 calibrating, 2 watching, 3 something changed and is being judged"),
    ("suspect", "<i8", "1", "the change that explains most now, a place in CHANGES; 13 none"),
    ("unclear", "<i8", "bits", "the changes that cannot be excluded yet, by place in CHANGES"),
    ("verdict", "<i8", "1", "the last change that was found, a place in CHANGES; 13 none explains it; -1 none yet"),
    ("verdicts", "<i8", "1", "changes found since the start"),
    ("verdict_onset_cycles", "<i8", "1", "cycles from the onset of that change to this one; -1 none yet"),
    ("leak_kind", "<i8", "1", "the largest leak: 0 internal, 1 external A, 2 external B, -1 none"),
    ("change_statistic", "<f8", "1", "2 ln of the likelihood ratio of the suspect"),
    ("change_threshold", "<f8", "1", "of that statistic"),
    ("verdict_size", "<f8", "1", "size of that change, in the unit of its place in CHANGES"),
    ("verdict_std", "<f8", "1", "its standard deviation"),
    ("verdict_confidence", "<f8", "1", "its posterior probability among all single changes"),
    ("leak_internal", "<f8", "m3/(s Pa)", "internal leak above the baseline"),
    ("leak_external_a", "<f8", "m3/(s Pa)", "external leak of chamber A above the baseline"),
    ("leak_external_b", "<f8", "m3/(s Pa)", "external leak of chamber B above the baseline"),
    ("leak_internal_std", "<f8", "m3/(s Pa)", "its standard deviation"),
    ("leak_external_a_std", "<f8", "m3/(s Pa)", "its standard deviation"),
    ("leak_external_b_std", "<f8", "m3/(s Pa)", "its standard deviation"),
    ("leak_internal_m3ps", "<f8", "m3/s", "its flow at the pressure difference of now, averaged over 3 s"),
    ("leak_external_a_m3ps", "<f8", "m3/s", "its flow at the pressure of now, averaged over 3 s"),
    ("leak_external_b_m3ps", "<f8", "m3/s", "its flow at the pressure of now, averaged over 3 s"),
    ("cpu_ns", "<i8", "ns", "processor time that the loop's thread used, previous cycle"),
)

SNAPSHOT_VERSION: Final = 5
SNAPSHOT = np.dtype([(name, kind) for name, kind, _, _ in FIELDS])


class SnapshotRecord:
    """One Snapshot in memory of its own: `row` by field name, and views of its parts for fast writing.

    `integers` (21,), then `measured` (6,), `estimate` (4,), `deviation` (4,), `rest`, `noise` (14,), `law` (1,),
    `diagnosis_integers` (7,), `diagnosis` (14,) and `cpu` (1,), all in the order of FIELDS.
    """

    def __init__(self) -> None:
        record = np.zeros(1, dtype=SNAPSHOT)
        names = [name for name, _, _, _ in FIELDS]
        n_integers = names.index("position_m")
        starts = ("est_position_m", "std_position_m", "nis", "process_std_position_m", "law_flags")
        diagnosis, sizes, cpu = (names.index(name) for name in ("diagnosis_mode", "change_statistic", "cpu_ns"))
        estimate, deviation, rest, noise, law = (names.index(name) for name in starts)
        words = record.view(np.float64)
        self.row: Any = record[0]
        self.row["active_t_ns"] = -1  # before the first cycle, as before the first ACTIVE one
        self.bytes: memoryview = record.view(np.uint8).data
        self.integers: NDArray[np.int64] = record.view(np.int64)[:n_integers]
        self.measured: NDArray[np.float64] = words[n_integers:estimate]
        self.estimate: NDArray[np.float64] = words[estimate:deviation]
        self.deviation: NDArray[np.float64] = words[deviation:rest]
        self.rest: NDArray[np.float64] = words[rest:noise]
        self.noise: NDArray[np.float64] = words[noise:law]
        self.law: NDArray[np.int64] = record.view(np.int64)[law:diagnosis]
        self.diagnosis_integers: NDArray[np.int64] = record.view(np.int64)[diagnosis:sizes]
        self.diagnosis: NDArray[np.float64] = words[sizes:cpu]
        self.cpu: NDArray[np.int64] = record.view(np.int64)[cpu:]
