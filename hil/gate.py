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
    VALVE_FAULT = auto()


class Reaction(IntEnum):
    """What an event leads to, in order of severity; the most severe event of a cycle decides."""

    NONE = 0
    HOLD = 1  # no higher than HOLD
    FAULT_HOLD = 2  # ramp to 0 V, then FAULT_HOLD
    RAMP = 3  # ramp to 0 V, then FAULT_DISABLED
    STOP = 4  # FAULT_DISABLED in this cycle


class Reactions(NamedTuple):
    """Bit masks of events by reaction (`hil.reactions.load_reactions`). A bit in none of them is an INTERNAL_ERROR.

    Every event with a reaction above HOLD must be latched; the loader sees to it.
    """

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
INIT, DISABLED, HOLD, ACTIVE, FAULT_REACTION, FAULT_HOLD, FAULT_DISABLED = map(int, DeviceState)
NO_REACTION, TO_HOLD, TO_FAULT_HOLD, TO_RAMP, TO_STOP = map(int, Reaction)
SENSOR_STALE: Final = int(Event.SENSOR_STALE)
NOT_FINITE: Final = int(Event.NOT_FINITE)
ESTOP: Final = int(Event.ESTOP)
INTERNAL_ERROR: Final = int(Event.INTERNAL_ERROR)
ALWAYS_STOP: Final = NOT_FINITE | ESTOP | INTERNAL_ERROR  # whatever the table of reactions says
CLIPPED: Final = int(Event.COMMAND_CLIPPED)
SLEWED: Final = int(Event.COMMAND_SLEWED)

OPERATING: Final = (DISABLED, HOLD, ACTIVE)
CLOSED_LOOP: Final = (HOLD, ACTIVE)
AT_REST_IN_FAULT: Final = (FAULT_HOLD, FAULT_DISABLED)
NOT_FOR_THE_GATE: Final = (int(Command.NONE), int(Command.ACKNOWLEDGE), int(Command.SET_PARAM))
SWITCH_OFF: Final = (int(Command.DISABLE), int(Command.SHUTDOWN))
ASK_ENABLE: Final = int(Command.ENABLE)
ASK_HOLD: Final = int(Command.HOLD)
ASK_RESET: Final = int(Command.RESET)
ASK_ESTOP: Final = int(Command.ESTOP)
ACCEPTED: Final = int(Result.ACCEPTED)

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
    events = _complete(state, events, command, requested_v, sensors_ready, reactions)
    reaction = _most_severe(events, reactions)
    # Before the first valid measurement only what stops at once is a fault; all else keeps the device in INIT.
    latching = ALWAYS_STOP | (reactions.latched & (reactions.stop if now == INIT else -1))
    fault = state.fault | (events & latching)
    result = _judge(command, now, fault, reaction, pending=events & latching)
    goal = _goal(command, result, state.goal)

    if reaction == TO_STOP:
        after = FAULT_DISABLED
    elif command in SWITCH_OFF:
        after = _switched_off(now, reaction)
    elif command == ASK_RESET and result == ACCEPTED:
        after, fault = DISABLED, 0
    elif now == INIT:
        after = DISABLED if sensors_ready and reaction < TO_FAULT_HOLD else INIT
    elif now == FAULT_DISABLED or (now in (DISABLED, FAULT_HOLD) and reaction == TO_RAMP):
        after = FAULT_DISABLED
    elif now == DISABLED and reaction == TO_FAULT_HOLD:
        after = FAULT_DISABLED  # a reaction never raises the state
    elif now == FAULT_HOLD:
        after = FAULT_HOLD
    elif now == FAULT_REACTION or reaction >= TO_FAULT_HOLD:
        return _ramp(state, events, fault, reaction, result, limits, max(1, periods))
    else:
        after = _climb(now, goal, fault, reaction)

    permitted = 0.0
    if now in CLOSED_LOOP and after in CLOSED_LOOP:  # not in the first cycle of HOLD: the law has not run for it yet
        permitted, clipping = _limited(requested_v, state.command_v, limits)
        events |= clipping
    goal = goal if after in OPERATING else DISABLED
    enable = after in CLOSED_LOOP or after == FAULT_HOLD
    return GateDecision(GateState(after, goal, fault, 0, permitted), permitted, enable, result, events)


def _complete(
    state: GateState, events: int, command: int, requested_v: float, sensors_ready: bool, reactions: Reactions
) -> int:
    """`events` with what the gate sees by itself."""
    now = state.device_state
    goals = AT_REST_IN_FAULT if now == FAULT_REACTION else OPERATING
    if not INIT <= now <= FAULT_DISABLED or state.goal not in goals or not isfinite(state.command_v):
        events |= INTERNAL_ERROR
    if events & ~(reactions.none | reactions.hold | reactions.fault_hold | reactions.ramp | reactions.stop):
        events |= INTERNAL_ERROR
    if not isfinite(requested_v):
        events |= NOT_FINITE
    if command == ASK_ESTOP:
        events |= ESTOP
    if not sensors_ready and now != INIT:
        events |= SENSOR_STALE
    return events


def _most_severe(events: int, reactions: Reactions) -> int:
    if events & (reactions.stop | ALWAYS_STOP):
        return TO_STOP
    if events & reactions.ramp:
        return TO_RAMP
    if events & reactions.fault_hold:
        return TO_FAULT_HOLD
    return TO_HOLD if events & reactions.hold else NO_REACTION


def _judge(command: int, now: int, fault: int, reaction: int, pending: int) -> int:
    """Result of the operator's command: down is always granted, up only along the arrows and without a fault."""
    if command in NOT_FOR_THE_GATE:
        return int(Result.NONE)
    if command == ASK_ESTOP or command in SWITCH_OFF:
        return ACCEPTED
    if command == ASK_ENABLE:
        granted = now in OPERATING and fault == 0 and reaction == NO_REACTION
    elif command == ASK_HOLD:
        granted = reaction <= TO_HOLD and (now in CLOSED_LOOP or (now == DISABLED and fault == 0))
    elif command == ASK_RESET:
        granted = pending == 0 and (now in AT_REST_IN_FAULT or (now in (DISABLED, HOLD) and fault != 0))
    else:
        return int(Result.UNKNOWN)
    return ACCEPTED if granted else int(Result.REFUSED_STATE)


def _goal(command: int, result: int, goal: int) -> int:
    if result != ACCEPTED:
        return goal
    return {ASK_ENABLE: ACTIVE, ASK_HOLD: HOLD}.get(command, DISABLED)


def _switched_off(now: int, reaction: int) -> int:
    """Where DISABLE leads: 0 V and enable off in this very cycle, from every state."""
    if now == INIT:
        return INIT
    return DISABLED if now in OPERATING and reaction < TO_FAULT_HOLD else FAULT_DISABLED


def _climb(now: int, goal: int, fault: int, reaction: int) -> int:
    """One arrow up towards the goal, or down to what events and latched faults allow."""
    ceiling = HOLD if reaction == TO_HOLD else ACTIVE
    if fault:
        ceiling = min(HOLD, now)
    return min(goal, ceiling, now + 1)


def _ramp(
    state: GateState, events: int, fault: int, reaction: int, result: int, limits: GateLimits, periods: int
) -> GateDecision:
    """FAULT_REACTION: straight to 0 V from the last permitted command, whatever the law asks; then the fault state."""
    running = state.device_state == FAULT_REACTION
    left = min(state.ramp_left, limits.ramp_periods) if running else limits.ramp_periods
    worst = reaction == TO_RAMP or state.goal == FAULT_DISABLED  # the goal of HOLD and ACTIVE never is
    target = FAULT_DISABLED if worst else FAULT_HOLD
    if left <= periods:
        return GateDecision(GateState(target, DISABLED, fault, 0, 0.0), 0.0, target == FAULT_HOLD, result, events)
    start = min(max(state.command_v, -limits.command_max_v), limits.command_max_v)
    permitted = start * ((left - periods) / left)
    after = GateState(FAULT_REACTION, target, fault, left - periods, permitted)
    return GateDecision(after, permitted, True, result, events)


def _limited(requested_v: float, last_v: float, limits: GateLimits) -> tuple[float, int]:
    """The requested voltage within range and slew, and the event bits that say where it was cut."""
    top = limits.command_max_v
    wanted = min(max(requested_v, -top), top)
    last = min(max(last_v, -top), top)
    permitted = min(max(wanted, last - limits.slew_step_v), last + limits.slew_step_v)
    return permitted, (CLIPPED if wanted != requested_v else 0) | (SLEWED if permitted != wanted else 0)
