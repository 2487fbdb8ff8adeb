"""The kinds of faults of a scenario, one table of parameters each; a sensor's values are in its SI unit (m, Pa, V)."""

from typing import Annotated, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from servohil.hil.config.section import NonNegative, Positive, Section

FOREVER: Final = 2**62  # cycles
Signal = Literal["position", "pressure_a", "pressure_b", "supply", "tank", "spool"]
Count = Annotated[int, Field(ge=1)]


class Fault(Section):
    """What every fault has: its kind, when it sets in and how long it lasts; without a length, to the end."""

    kind: str
    at_s: NonNegative | None = None
    at_cycle: Count | None = None
    for_s: Positive | None = None
    for_cycles: Count | None = None

    REAL_TIME: ClassVar[bool] = False  # whether it lives in the node's process

    @model_validator(mode="after")
    def _one_time(self) -> Self:
        if (self.at_s is None) == (self.at_cycle is None):
            raise ValueError("needs exactly one of at_s and at_cycle")
        if self.for_s is not None and self.for_cycles is not None:
            raise ValueError("takes only one of for_s and for_cycles")
        return self

    def window(self, period_s: float) -> tuple[int, int]:
        """(first cycle, first cycle after it), counted from the first ACTIVE cycle, which is number 0."""
        first = self.at_cycle if self.at_cycle is not None else max(1, round((self.at_s or 0.0) / period_s))
        length = FOREVER if self.for_s is None else max(1, round(self.for_s / period_s))
        return first, min(FOREVER, first + (self.for_cycles or length))


class NodeFault(Fault):
    """A fault of sensors, valve or cylinder."""

    REAL_TIME = True


class SensorFault(NodeFault):
    """A fault of one sensor."""

    signal: Signal


class SensorNan(SensorFault):
    """The raw value that says "not available": the most negative number, or all bits set where there is no sign."""

    kind: Literal["sensor_nan"]


class SensorRange(SensorFault):
    """A value beyond the DBC's range, in a frame that is right otherwise."""

    kind: Literal["sensor_range"]
    value: float


class SensorStuck(SensorFault):
    """The reading stays where it was, or at `value`."""

    kind: Literal["sensor_stuck"]
    value: float | None = None


class SensorJump(SensorFault):
    """The reading is off by `by`, at once."""

    kind: Literal["sensor_jump"]
    by: float


class SensorDrift(SensorFault):
    """The reading runs away by `rate` per second."""

    kind: Literal["sensor_drift"]
    rate: float


class SensorNoise(SensorFault):
    """The noise of the reading is `factor` times as large; a sensor without noise has none to enlarge."""

    kind: Literal["sensor_noise"]
    factor: Positive


class SpoolStuck(NodeFault):
    """The spool stays where it is, whatever the command."""

    kind: Literal["spool_stuck"]


class SpoolNotCentring(NodeFault):
    """The spool comes no closer to its centre than `rest_v`, on the side it is on."""

    kind: Literal["spool_not_centring"]
    rest_v: Positive


class SlowValve(NodeFault):
    """The spool follows its command like a first order of this time constant."""

    kind: Literal["slow_valve"]
    time_constant_s: Positive


class SupplyLoss(NodeFault):
    """The supply has this pressure."""

    kind: Literal["supply_loss"]
    supply_pa: NonNegative


class HoseBurst(NodeFault):
    """A large leak from one chamber to the outside, m3/(s Pa)."""

    kind: Literal["hose_burst"]
    chamber: Literal["a", "b"]
    coefficient: Positive = 1e-9


class EndStop(NodeFault):
    """Something in the way: the piston gets no further out than this."""

    kind: Literal["end_stop"]
    position_m: Positive


class Air(NodeFault):
    """Air in the oil: the bulk modulus is `factor` times that of before."""

    kind: Literal["air"]
    factor: Annotated[float, Field(gt=0.0, lt=1.0)]


class Load(NodeFault):
    """A force on the piston; > 0 opposes extension."""

    kind: Literal["load"]
    force_n: float


class FrameFault(Fault):
    """A fault of the frames of one message, or of all that the node sends; of the command: on its way to the node."""

    REAL_TIME = True
    message: str | None = None


class FramesDropped(FrameFault):
    """Every `every`-th frame is lost."""

    kind: Literal["frames_dropped"]
    every: Count = 1


class FramesDelayed(FrameFault):
    """Frames come so many cycles late; at the end those under way come all at once."""

    kind: Literal["frames_delayed"]
    cycles: Annotated[int, Field(ge=1, le=1000)]


class FramesDuplicated(FrameFault):
    """Every frame comes twice."""

    kind: Literal["frames_duplicated"]


class FramesStale(FrameFault):
    """A sender that restarts: silence, and then, one beside each new frame, the frames of before."""

    kind: Literal["frames_stale"]


class WrongCrc(FrameFault):
    """The CRC is wrong."""

    kind: Literal["wrong_crc"]


class WrongLength(FrameFault):
    """The frame says that it has so many bytes."""

    kind: Literal["wrong_length"]
    length: Annotated[int, Field(ge=0, le=8)]


class WrongType(FrameFault):
    """A frame of another type under the same identifier."""

    kind: Literal["wrong_type"]
    type: Literal["extended", "remote", "fd"]
    REAL_TIME = False


class CounterFreeze(FrameFault):
    """The counter stands still, CRC right."""

    kind: Literal["counter_freeze"]


class CounterJump(FrameFault):
    """The counter is `by` ahead, CRC right."""

    kind: Literal["counter_jump"]
    by: Annotated[int, Field(ge=1, le=15)]


class CounterRepeat(FrameFault):
    """Every other frame carries the counter of the one before, CRC right."""

    kind: Literal["counter_repeat"]


class Masquerade(FrameFault):
    """The frames are protected with the data ids of another message: somebody else's, under this identifier."""

    kind: Literal["masquerade"]
    as_message: str


class SecondCommander(Fault):
    """Somebody else sends this command under our identifier, well protected, in every cycle."""

    kind: Literal["second_commander"]
    command_v: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.0
    REAL_TIME = True


class Babbling(Fault):
    """A node that sends so many foreign frames per cycle, before all others."""

    kind: Literal["babbling"]
    frames: Annotated[int, Field(ge=1, le=400)]


class ErrorFrames(Fault):
    """So many error frames per cycle; `passive`: they say that the controller is error-passive."""

    kind: Literal["error_frames"]
    frames: Annotated[int, Field(ge=1, le=100)] = 1
    passive: bool = False


class BusOff(Fault):
    """The controller is bus-off: nothing comes, nothing goes, and the port says so."""

    kind: Literal["bus_off"]


class InterfaceDown(Fault):
    """The interface is down: nothing comes, nothing goes, and the port says so."""

    kind: Literal["interface_down"]


class SendBufferFull(Fault):
    """ENOBUFS: the bus takes no frame of ours; what others send still comes."""

    kind: Literal["send_buffer_full"]


class LateCycles(Fault):
    """Every cycle comes so many periods late, which are skipped."""

    kind: Literal["late_cycles"]
    skipped: Annotated[int, Field(ge=1, le=1000)]


class Operator(Fault):
    """The operator's command in every cycle of its time; without a length, once."""

    kind: Literal["operator"]
    command: Literal["enable", "hold", "disable", "reset", "estop", "acknowledge", "shutdown"]


class ParameterChange(Fault):
    """A parameter is set by the operator, once."""

    kind: Literal["parameter"]
    name: str
    value: float


CLASSES: Final[tuple[type[Fault], ...]] = (
    SensorNan, SensorRange, SensorStuck, SensorJump, SensorDrift, SensorNoise, SpoolStuck, SpoolNotCentring, SlowValve,
    SupplyLoss, HoseBurst, EndStop, Air, Load, FramesDropped, FramesDelayed, FramesDuplicated, FramesStale, WrongCrc,
    WrongLength, WrongType, CounterFreeze, CounterJump, CounterRepeat, Masquerade, SecondCommander, Babbling,
    ErrorFrames, BusOff, InterfaceDown, SendBufferFull, LateCycles, Operator, ParameterChange,
)  # fmt: skip
KINDS: Final[dict[str, type[Fault]]] = {cls.model_fields["kind"].annotation.__args__[0]: cls for cls in CLASSES}  # type: ignore[union-attr]
