"""The safety gate: events, operator command and requested voltage in; device state and permitted voltage out.

Pure: no clock, no I/O, no hidden state, so every state x event x command is tested. Deny by default: only HOLD, ACTIVE
and the ramp of FAULT_REACTION permit a voltage, and what is not known (a state, an event bit) stops the cylinder.
Not safety-rated: the emergency stop is hard-wired, and the node on the bus centres the spool by itself.

States are those of CiA 408. `goal` holds what the operator asked for; the state climbs to it one arrow per cycle, so
ENABLE in DISABLED is HOLD in this cycle and ACTIVE in the next. A HOLD reaction that is not latched lasts as long as
its event, then the state climbs back to the goal; after a latched one it takes RESET and a new ENABLE.
"""

from enum import IntEnum, IntFlag, auto
from math import isfinite
from typing import Final, NamedTuple

from servohil.hil.commands import Command, Result


class DeviceState(IntEnum):
    """CiA 408 device states."""

    INIT = 0  # waiting for valid measurements
    DISABLED = 1  # enable off, 0 V
    HOLD = 2  # loop closed at the hold setpoint
    ACTIVE = 3  # loop closed at the reference
    FAULT_REACTION = 4  # command on its ramp to 0 V
    FAULT_HOLD = 5  # enable on, 0 V: the valve keeps its spool centred
    FAULT_DISABLED = 6  # enable off, 0 V


class Event(IntFlag):
    """What the gate can be told, one bit each; `reactions.toml` says when each is raised and what follows."""

    OVERRUNS_HOLD = auto()
    OVERRUNS_FAULT = auto()
    SETPOINT_STALE = auto()
    SENSOR_STALE = auto()
    BAD_FRAMES = auto()
    IMPLAUSIBLE = auto()
    POSITION_LIMIT = auto()
    SPEED_LIMIT = auto()
    PRESSURE_LIMIT = auto()
    SLEW_LIMIT = auto()
    SUPPLY_LOST = auto()
    ESTIMATOR_UNHEALTHY = auto()
    NOT_FINITE = auto()
    ESTOP = auto()
    BUS_OFF = auto()
    SECOND_COMMANDER = auto()
    LEAK_WARNING = auto()
    LEAK_ALARM = auto()
    INTERNAL_ERROR = auto()
    COMMAND_CLIPPED = auto()
    COMMAND_SLEWED = auto()


class Reaction(IntEnum):
    """What an event leads to, in order of severity; the most severe event of a cycle decides."""

    NONE = 0
    HOLD = 1  # no higher than HOLD
    FAULT_HOLD = 2  # ramp to 0 V, then FAULT_HOLD
    RAMP = 3  # ramp to 0 V, then FAULT_DISABLED
    STOP = 4  # FAULT_DISABLED in this cycle


class Reactions(NamedTuple):
    """Bit masks of events by reaction (`hil.reactions.load_reactions`); a bit in none of the first five means STOP."""

    none: int
    hold: int
    fault_hold: int
    ramp: int
    stop: int
    latched: int


class GateLimits(NamedTuple):
    """Bounds of the permitted voltage; see `gate_limits`."""

    command_max_v: float
    slew_step_v: float  # per cycle
    ramp_periods: int  # length of the ramp to 0 V


class GateState(NamedTuple):
    """All that the gate remembers: five integers and a float of the cycle's arena."""

    device_state: int
    goal: int  # operating states: what the operator wants; FAULT_REACTION: the state after the ramp
    fault: int  # event bits latched since the last reset
    ramp_left: int  # periods until the ramp is at 0 V
    command_v: float  # permitted in the previous cycle


class GateDecision(NamedTuple):
    """Outcome of one cycle. `events` adds to those given what the gate found itself, clipping included."""

    state: GateState
    permitted_v: float
    enable: bool
    result: int  # hil.commands.Result
    events: int


# Plain integers: flag arithmetic on enum members costs microseconds per cycle.
INIT, DISABLED, HOLD, ACTIVE, FAULT_REACTION, FAULT_HOLD, FAULT_DISABLED = (int(state) for state in DeviceState)
SENSOR_STALE: Final = int(Event.SENSOR_STALE)
NOT_FINITE: Final = int(Event.NOT_FINITE)
ESTOP: Final = int(Event.ESTOP)
INTERNAL_ERROR: Final = int(Event.INTERNAL_ERROR)
COMMAND_CLIPPED: Final = int(Event.COMMAND_CLIPPED)
COMMAND_SLEWED: Final = int(Event.COMMAND_SLEWED)
NO_REACTION, TO_HOLD, TO_FAULT_HOLD, TO_RAMP, TO_STOP = (int(reaction) for reaction in Reaction)
NOT_FOR_THE_GATE: Final = frozenset(map(int, (Command.NONE, Command.ACKNOWLEDGE, Command.SET_PARAM)))
SWITCH_OFF: Final = frozenset(map(int, (Command.DISABLE, Command.SHUTDOWN)))
CMD_ENABLE, CMD_HOLD, CMD_RESET, CMD_ESTOP = map(
    int, (Command.ENABLE, Command.HOLD, Command.RESET, Command.ESTOP)
)
NONE, ACCEPTED, REFUSED, UNKNOWN = map(
    int, (Result.NONE, Result.ACCEPTED, Result.REFUSED_STATE, Result.UNKNOWN)
)

POWER_UP: Final = GateState(device_state=INIT, goal=DISABLED, fault=0, ramp_left=0, command_v=0.0)


def gate_limits(command_max_v: float, slew_v_per_s: float, ramp_down_s: float, period_s: float) -> GateLimits:
    """Limits in cycles of `period_s`; the ramp is rounded down, as `ramp_down_s` is the longest allowed.

    Raises:
        ValueError: an argument is not finite and > 0; the message names it.
    """
    arguments = {
        "command_max_v": command_max_v, "slew_v_per_s": slew_v_per_s, "ramp_down_s": ramp_down_s, "period_s": period_s,
    }  # fmt: skip
    for name, value in arguments.items():
        if not (isfinite(value) and value > 0.0):
            raise ValueError(f"gate limit {name} = {value!r}: must be finite and > 0")
    # A whole number of periods may come out one rounding error short.
    return GateLimits(command_max_v, slew_v_per_s * period_s, max(1, int(ramp_down_s / period_s * (1.0 + 1e-12))))


def gate(
    state: GateState,
    events: int,
    command: int,
    requested_v: float,
    sensors_ready: bool,
    reactions: Reactions,
    limits: GateLimits,
    periods: int = 1,
) -> GateDecision:
    """One cycle of the gate.

    Args:
        state: from the previous decision; `POWER_UP` at the start.
        events: `Event` bits of this cycle.
        command: one `hil.commands.Command` code; each code given is one edge.
        requested_v: what the control law asks for, V; 0.0 where no law runs.
        sensors_ready: every measurement is valid and younger than its limit.
        reactions: what each event leads to.
        limits: bounds of the command.
        periods: whole periods since the previous call, 1 + skipped: the ramp keeps its time through overruns.
    """
    now = state.device_state
    events = _complete(state, events, command, requested_v, sensors_ready)
    reaction = _most_severe(events, reactions)
    # Before the first valid measurement only what stops at once is a fault; all else keeps the device in INIT.
    fault = state.fault | (events & reactions.latched & (reactions.stop if now == INIT else -1))
    result = _judge(command, now, fault, events & reactions.latched, reaction)
    goal = _goal(command, result, state.goal)

    if reaction == TO_STOP:
        after, goal = FAULT_DISABLED, DISABLED
    elif command in SWITCH_OFF:
        after = _switched_off(now, reaction)
    elif command == CMD_RESET and result == ACCEPTED:
        after, fault = DISABLED, 0
    elif now == INIT:
        after = DISABLED if sensors_ready and reaction < TO_FAULT_HOLD else INIT
    elif now == FAULT_HOLD:
        after = FAULT_DISABLED if reaction == TO_RAMP else FAULT_HOLD
    elif now == FAULT_DISABLED:
        after = FAULT_DISABLED
    elif now == FAULT_REACTION or reaction >= TO_FAULT_HOLD:
        return _ramp(state, events, fault, reaction, result, limits, max(1, periods))
    else:
        after = _operate(now, goal, fault, reaction)

    if after not in (HOLD, ACTIVE) or now not in (HOLD, ACTIVE):
        # Includes the first cycle of HOLD: the law has not seen an enabled valve yet.
        permitted = 0.0
    else:
        permitted, clipped = _limited(requested_v, state.command_v, limits)
        events |= clipped
    after_state = GateState(after, goal, fault, 0, permitted)
    return GateDecision(after_state, permitted, after in (HOLD, ACTIVE, FAULT_HOLD), result, events)
