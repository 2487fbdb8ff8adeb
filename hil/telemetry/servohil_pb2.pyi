# mypy: ignore-errors
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class State(_message.Message):
    __slots__ = ("cycle", "t_ns", "active_t_ns", "state", "events", "fault", "skipped", "overruns", "lateness_ns", "exec_ns", "rx_frames", "rx_rejected", "tx_failed", "filter_status", "filter_repairs", "leak_alarm", "leak_channel", "leak_since_ns", "command_seq", "command_result", "param_version", "position_m", "pressure_a_pa", "pressure_b_pa", "supply_pa", "tank_pa", "spool_v", "est_position_m", "est_velocity_mps", "est_pressure_a_pa", "est_pressure_b_pa", "std_position_m", "std_velocity_mps", "std_pressure_a_pa", "std_pressure_b_pa", "nis", "ref_position_m", "ref_velocity_mps", "ref_acceleration_mps2", "ref_jerk_mps3", "sliding", "law_v", "command_v", "residual_a_pa", "residual_b_pa", "threshold_a_pa", "threshold_b_pa", "cusum_a", "cusum_b", "cusum_threshold", "process_std_position_m", "process_std_velocity_mps", "process_std_pressure_a_pa", "process_std_pressure_b_pa", "measurement_std_position_m", "measurement_std_pressure_a_pa", "measurement_std_pressure_b_pa", "process_doubt_position", "process_doubt_velocity", "process_doubt_pressure_a", "process_doubt_pressure_b", "measurement_doubt_position", "measurement_doubt_pressure_a", "measurement_doubt_pressure_b", "law_flags")
    CYCLE_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_T_NS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    SKIPPED_FIELD_NUMBER: _ClassVar[int]
    OVERRUNS_FIELD_NUMBER: _ClassVar[int]
    LATENESS_NS_FIELD_NUMBER: _ClassVar[int]
    EXEC_NS_FIELD_NUMBER: _ClassVar[int]
    RX_FRAMES_FIELD_NUMBER: _ClassVar[int]
    RX_REJECTED_FIELD_NUMBER: _ClassVar[int]
    TX_FAILED_FIELD_NUMBER: _ClassVar[int]
    FILTER_STATUS_FIELD_NUMBER: _ClassVar[int]
    FILTER_REPAIRS_FIELD_NUMBER: _ClassVar[int]
    LEAK_ALARM_FIELD_NUMBER: _ClassVar[int]
    LEAK_CHANNEL_FIELD_NUMBER: _ClassVar[int]
    LEAK_SINCE_NS_FIELD_NUMBER: _ClassVar[int]
    COMMAND_SEQ_FIELD_NUMBER: _ClassVar[int]
    COMMAND_RESULT_FIELD_NUMBER: _ClassVar[int]
    PARAM_VERSION_FIELD_NUMBER: _ClassVar[int]
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    PRESSURE_A_PA_FIELD_NUMBER: _ClassVar[int]
    PRESSURE_B_PA_FIELD_NUMBER: _ClassVar[int]
    SUPPLY_PA_FIELD_NUMBER: _ClassVar[int]
    TANK_PA_FIELD_NUMBER: _ClassVar[int]
    SPOOL_V_FIELD_NUMBER: _ClassVar[int]
    EST_POSITION_M_FIELD_NUMBER: _ClassVar[int]
    EST_VELOCITY_MPS_FIELD_NUMBER: _ClassVar[int]
    EST_PRESSURE_A_PA_FIELD_NUMBER: _ClassVar[int]
    EST_PRESSURE_B_PA_FIELD_NUMBER: _ClassVar[int]
    STD_POSITION_M_FIELD_NUMBER: _ClassVar[int]
    STD_VELOCITY_MPS_FIELD_NUMBER: _ClassVar[int]
    STD_PRESSURE_A_PA_FIELD_NUMBER: _ClassVar[int]
    STD_PRESSURE_B_PA_FIELD_NUMBER: _ClassVar[int]
    NIS_FIELD_NUMBER: _ClassVar[int]
    REF_POSITION_M_FIELD_NUMBER: _ClassVar[int]
    REF_VELOCITY_MPS_FIELD_NUMBER: _ClassVar[int]
    REF_ACCELERATION_MPS2_FIELD_NUMBER: _ClassVar[int]
    REF_JERK_MPS3_FIELD_NUMBER: _ClassVar[int]
    SLIDING_FIELD_NUMBER: _ClassVar[int]
    LAW_V_FIELD_NUMBER: _ClassVar[int]
    COMMAND_V_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_A_PA_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_B_PA_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_A_PA_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_B_PA_FIELD_NUMBER: _ClassVar[int]
    CUSUM_A_FIELD_NUMBER: _ClassVar[int]
    CUSUM_B_FIELD_NUMBER: _ClassVar[int]
    CUSUM_THRESHOLD_FIELD_NUMBER: _ClassVar[int]
    PROCESS_STD_POSITION_M_FIELD_NUMBER: _ClassVar[int]
    PROCESS_STD_VELOCITY_MPS_FIELD_NUMBER: _ClassVar[int]
    PROCESS_STD_PRESSURE_A_PA_FIELD_NUMBER: _ClassVar[int]
    PROCESS_STD_PRESSURE_B_PA_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENT_STD_POSITION_M_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENT_STD_PRESSURE_A_PA_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENT_STD_PRESSURE_B_PA_FIELD_NUMBER: _ClassVar[int]
    PROCESS_DOUBT_POSITION_FIELD_NUMBER: _ClassVar[int]
    PROCESS_DOUBT_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    PROCESS_DOUBT_PRESSURE_A_FIELD_NUMBER: _ClassVar[int]
    PROCESS_DOUBT_PRESSURE_B_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENT_DOUBT_POSITION_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENT_DOUBT_PRESSURE_A_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENT_DOUBT_PRESSURE_B_FIELD_NUMBER: _ClassVar[int]
    LAW_FLAGS_FIELD_NUMBER: _ClassVar[int]
    cycle: int
    t_ns: int
    active_t_ns: int
    state: int
    events: int
    fault: int
    skipped: int
    overruns: int
    lateness_ns: int
    exec_ns: int
    rx_frames: int
    rx_rejected: int
    tx_failed: int
    filter_status: int
    filter_repairs: int
    leak_alarm: int
    leak_channel: int
    leak_since_ns: int
    command_seq: int
    command_result: int
    param_version: int
    position_m: float
    pressure_a_pa: float
    pressure_b_pa: float
    supply_pa: float
    tank_pa: float
    spool_v: float
    est_position_m: float
    est_velocity_mps: float
    est_pressure_a_pa: float
    est_pressure_b_pa: float
    std_position_m: float
    std_velocity_mps: float
    std_pressure_a_pa: float
    std_pressure_b_pa: float
    nis: float
    ref_position_m: float
    ref_velocity_mps: float
    ref_acceleration_mps2: float
    ref_jerk_mps3: float
    sliding: float
    law_v: float
    command_v: float
    residual_a_pa: float
    residual_b_pa: float
    threshold_a_pa: float
    threshold_b_pa: float
    cusum_a: float
    cusum_b: float
    cusum_threshold: float
    process_std_position_m: float
    process_std_velocity_mps: float
    process_std_pressure_a_pa: float
    process_std_pressure_b_pa: float
    measurement_std_position_m: float
    measurement_std_pressure_a_pa: float
    measurement_std_pressure_b_pa: float
    process_doubt_position: float
    process_doubt_velocity: float
    process_doubt_pressure_a: float
    process_doubt_pressure_b: float
    measurement_doubt_position: float
    measurement_doubt_pressure_a: float
    measurement_doubt_pressure_b: float
    law_flags: int
    def __init__(self, cycle: _Optional[int] = ..., t_ns: _Optional[int] = ..., active_t_ns: _Optional[int] = ..., state: _Optional[int] = ..., events: _Optional[int] = ..., fault: _Optional[int] = ..., skipped: _Optional[int] = ..., overruns: _Optional[int] = ..., lateness_ns: _Optional[int] = ..., exec_ns: _Optional[int] = ..., rx_frames: _Optional[int] = ..., rx_rejected: _Optional[int] = ..., tx_failed: _Optional[int] = ..., filter_status: _Optional[int] = ..., filter_repairs: _Optional[int] = ..., leak_alarm: _Optional[int] = ..., leak_channel: _Optional[int] = ..., leak_since_ns: _Optional[int] = ..., command_seq: _Optional[int] = ..., command_result: _Optional[int] = ..., param_version: _Optional[int] = ..., position_m: _Optional[float] = ..., pressure_a_pa: _Optional[float] = ..., pressure_b_pa: _Optional[float] = ..., supply_pa: _Optional[float] = ..., tank_pa: _Optional[float] = ..., spool_v: _Optional[float] = ..., est_position_m: _Optional[float] = ..., est_velocity_mps: _Optional[float] = ..., est_pressure_a_pa: _Optional[float] = ..., est_pressure_b_pa: _Optional[float] = ..., std_position_m: _Optional[float] = ..., std_velocity_mps: _Optional[float] = ..., std_pressure_a_pa: _Optional[float] = ..., std_pressure_b_pa: _Optional[float] = ..., nis: _Optional[float] = ..., ref_position_m: _Optional[float] = ..., ref_velocity_mps: _Optional[float] = ..., ref_acceleration_mps2: _Optional[float] = ..., ref_jerk_mps3: _Optional[float] = ..., sliding: _Optional[float] = ..., law_v: _Optional[float] = ..., command_v: _Optional[float] = ..., residual_a_pa: _Optional[float] = ..., residual_b_pa: _Optional[float] = ..., threshold_a_pa: _Optional[float] = ..., threshold_b_pa: _Optional[float] = ..., cusum_a: _Optional[float] = ..., cusum_b: _Optional[float] = ..., cusum_threshold: _Optional[float] = ..., process_std_position_m: _Optional[float] = ..., process_std_velocity_mps: _Optional[float] = ..., process_std_pressure_a_pa: _Optional[float] = ..., process_std_pressure_b_pa: _Optional[float] = ..., measurement_std_position_m: _Optional[float] = ..., measurement_std_pressure_a_pa: _Optional[float] = ..., measurement_std_pressure_b_pa: _Optional[float] = ..., process_doubt_position: _Optional[float] = ..., process_doubt_velocity: _Optional[float] = ..., process_doubt_pressure_a: _Optional[float] = ..., process_doubt_pressure_b: _Optional[float] = ..., measurement_doubt_position: _Optional[float] = ..., measurement_doubt_pressure_a: _Optional[float] = ..., measurement_doubt_pressure_b: _Optional[float] = ..., law_flags: _Optional[int] = ...) -> None: ...

class StateBatch(_message.Message):
    __slots__ = ("seq", "t_unix_ns", "age_ns", "lost", "samples")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    T_UNIX_NS_FIELD_NUMBER: _ClassVar[int]
    AGE_NS_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    seq: int
    t_unix_ns: int
    age_ns: int
    lost: int
    samples: _containers.RepeatedCompositeFieldContainer[State]
    def __init__(self, seq: _Optional[int] = ..., t_unix_ns: _Optional[int] = ..., age_ns: _Optional[int] = ..., lost: _Optional[int] = ..., samples: _Optional[_Iterable[_Union[State, _Mapping]]] = ...) -> None: ...

class CycleInputs(_message.Message):
    __slots__ = ("payload",)
    PAYLOAD_FIELD_NUMBER: _ClassVar[int]
    payload: bytes
    def __init__(self, payload: _Optional[bytes] = ...) -> None: ...

class Checkpoint(_message.Message):
    __slots__ = ("state",)
    STATE_FIELD_NUMBER: _ClassVar[int]
    state: bytes
    def __init__(self, state: _Optional[bytes] = ...) -> None: ...
