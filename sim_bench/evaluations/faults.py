"""`hil evaluate faults`: every row of the fault table on a moving cylinder in lockstep, and what came of it."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from servohil.hil.commands import Command
from servohil.hil.config import ConfigError, Rig
from servohil.hil.config.effective import effective_tables
from servohil.hil.config.problems import from_pydantic
from servohil.hil.config.section import Section
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState, Event
from servohil.hil.snapshot import SNAPSHOT
from servohil.sim_bench import faults
from servohil.sim_bench.actuator_node import NS_PER_S, ActuatorNode, TruthLog
from servohil.sim_bench.faults.kinds import Fault
from servohil.sim_bench.faults.lockstep import run_with_faults
from servohil.sim_bench.faults.report import event_names, reacting_events
from servohil.sim_bench.faults.scenario import check_scenario, faults_of

TABLE: Final = Path(faults.__file__).with_name("fault_table.toml")
ONSET: Final = 960  # cycles after the first ACTIVE one; the piston then moves at its highest speed
WATCHED: Final = 700  # cycles from the onset to the reset of a lasting fault, and to its end soon after
LATER: Final = 50  # cycles from that reset to the end of the fault, and from the next reset to the end
RECOVERED: Final = 300  # cycles from the end of the fault to the next reset: the estimate comes back
SETTLE: Final = 20  # cycles in DISABLED before the enable
MOVING_MPS: Final = 0.1
SWING: Final = 250  # cycles, three periods of the oil's resonance: over them a mean does not swing
CREEP_M: Final = 1e-3
# What a rig PC has, and a motion that is fast at the onset.
LIMITS: Final = {"sensor_age_periods": 5, "overruns_hold": 3, "overruns_fault": 10}
REFERENCE: Final = {
    "kind": "sine", "offset_m": 0.3, "amplitude_m": 0.085, "omega_rad_per_s": 3.3, "blend_s": 0.95,
}  # fmt: skip
STATES: Final = tuple(state.name for state in DeviceState)


class Row(Section):
    """One row of the table: faults, and what is to become of the cylinder."""

    name: Annotated[str, Field(min_length=1)]
    place: Literal["sensor", "bus", "actuator", "process"]
    fault: tuple[Fault, ...]
    event: str = ""  # of the gate; "": none
    state: str = "ACTIVE"  # reached through the fault
    cycles: Annotated[int, Field(ge=0)] = 0  # from the cause to the event, at most
    lasts: int | None = None  # cycles; None: until after the first reset
    reset: Literal["none", "after", "at_once"] = "none"  # when a reset is granted
    end: str = "ACTIVE"  # state at the end, after the reset where there is one
    stops: bool = True  # whether the piston then stays; a valve that is broken itself cannot be made to
    why: str = ""


def read_rows(path: Path = TABLE) -> list[Row]:
    """The table. A fault without a time sets in at ONSET and lasts as its row says.

    Raises:
        ConfigError: names the row and what is allowed.
    """
    rows = []
    for number, table in enumerate(tomllib.loads(path.read_text(encoding="utf-8"))["row"]):
        where = f"{path}: row[{number}] {table.get('name', '')!r}"
        lasts = table.get("lasts", WATCHED + LATER)
        timed = [
            {
                "at_cycle": ONSET,
                **({} if entry.get("kind") in ("operator", "parameter") else {"for_cycles": lasts}),
                **entry,
            }
            for entry in table.get("fault", [])
        ]
        found = faults_of(timed, where)
        try:
            row = Row.model_validate({**table, "fault": found})
        except ValidationError as error:
            raise ConfigError(
                "\n".join(problem.line(where, table) for problem in from_pydantic(error.errors(), table, Row))
            ) from None
        for key, value, allowed in (
            ("event", row.event, ("", *Event.__members__)), ("state", row.state, STATES), ("end", row.end, STATES),
        ):  # fmt: skip
            if value not in allowed:
                raise ConfigError(f"{where}: {key} = {value!r}: allowed: {', '.join(allowed)}")
        rows.append(row)
    return rows


def strict_rig(rig: Rig) -> Rig:
    """`rig` with the limits of a rig PC and the motion of the evaluation."""
    tables = effective_tables(rig)
    tables["limits"] |= LIMITS
    tables["reference"] = REFERENCE
    return Rig.model_validate(tables).at(rig.path)


class Found(NamedTuple):
    """What a row did. Cycles are counted from the cause; None: did not happen before the first reset."""

    events: str  # all that was latched
    to_event: int | None  # of the row, or any that the gate acts on where the row has none
    to_zero: int | None  # commanded, from there on
    to_centre: int | None  # the true spool, from there on
    state: str  # when the reaction was over
    creep_m: float  # of the mean over a swing
    reset_during: bool | None
    reset_after: bool | None
    end: str
    largest_error_m: float  # true minus reference, while ACTIVE
    speed_mps: float  # at the cause


class Operator:
    """Enables, resets while the fault lasts and after it, ends."""

    def __init__(self, resets: Sequence[int], last: int, period_ns: int) -> None:
        self.finished = False
        self._resets, self._last, self._period_ns = resets, last, period_ns
        self._disabled = 0
        self._reset = 0

    def next(self, state: int, active_t_ns: int) -> Command:
        """See `OperatorScript.next`."""
        since = active_t_ns // self._period_ns
        self.finished = since >= self._last - 1
        if active_t_ns < 0 or since == 0:
            self._disabled += state == DeviceState.DISABLED
            return Command.ENABLE if self._disabled == SETTLE else Command.NONE
        if self._reset < len(self._resets) and since >= self._resets[self._reset]:
            self._reset += 1
            return Command.RESET
        return Command.NONE


def run_row(rig: Rig, row: Row) -> tuple[Found, NDArray[np.void], NDArray[np.void]]:
    """One row in lockstep: (what was found, Snapshots, truth). `rig` is that of `strict_rig`.

    Raises:
        ConfigError: the rig cannot have such a fault.
    """
    check_scenario(row.fault, rig, lockstep=True)
    cycle = Cycle(rig)
    during = ONSET + WATCHED
    after = during + LATER + RECOVERED
    log = TruthLog(2 * (after + LATER) + 500)
    node = ActuatorNode(rig, None, log)
    operator = Operator([during, after] if row.reset != "none" else [], after + LATER, rig.loop.period_ns)
    kept: list[bytes] = []
    run_with_faults(cycle, node, row.fault, operator, lambda snapshot, _: kept.append(bytes(snapshot)))
    snapshots = np.frombuffer(b"".join(kept), dtype=SNAPSHOT)
    # After overruns the truth has more rows: those of the skipped periods.
    times = log.rows()["t_mono_ns"]
    truth = log.rows()[np.searchsorted(times, snapshots["t_ns"])]
    cause = min((fault.window(rig.loop.period_ns / NS_PER_S)[0] for fault in row.fault), default=ONSET)
    return look(row.event, rig.loop.period_ns, snapshots, truth, (cause, during, after)), snapshots, truth


def look(
    event: str, period_ns: int, snapshots: NDArray[np.void], truth: NDArray[np.void], at: tuple[int, int, int]
) -> Found:
    """What happened from the cycle of the cause on; `at`: cause and the two resets, in cycles since ACTIVE."""
    since = snapshots["active_t_ns"] // period_ns
    start, first_reset, second_reset = (int(np.searchsorted(since, cycle)) for cycle in at)
    told, position = snapshots[start:], truth["position_m"]
    mask = int(Event[event]) if event else reacting_events()

    def from_there_on(values: NDArray[np.float64]) -> int | None:
        """First row from which on these are zero, up to the first reset."""
        driven = np.flatnonzero(values[start:first_reset])
        row = start + (int(driven[-1]) + 1 if driven.size else 0)
        return row if row < first_reset else None

    def cycles(row: int | None) -> int | None:
        return None if row is None else int(snapshots["cycle"][row] - snapshots["cycle"][start])

    raised = np.flatnonzero(told["events"] & mask)
    zero, centre = from_there_on(snapshots["command_v"]), from_there_on(truth["spool_v"])
    creep_m = 0.0
    if zero is not None and zero + 2 * SWING <= first_reset:
        swings = position[first_reset - SWING : first_reset], position[zero + SWING : zero + 2 * SWING]
        creep_m = abs(float(swings[0].mean() - swings[1].mean()))
    active = told["state"] == DeviceState.ACTIVE
    error = np.abs(position[start:] - told["ref_position_m"])[active]
    return Found(
        events=" ".join(event_names(int(np.bitwise_or.reduce(told["fault"])))),
        to_event=cycles(start + int(raised[0])) if raised.size else None,
        to_zero=cycles(zero),
        to_centre=cycles(centre),
        state=DeviceState(int(snapshots["state"][first_reset - 1])).name,
        creep_m=creep_m,
        reset_during=_granted(snapshots, first_reset),
        reset_after=_granted(snapshots, second_reset),
        end=DeviceState(int(snapshots["state"][-1])).name,
        largest_error_m=float(np.nanmax(error)) if error.size else 0.0,
        speed_mps=abs(float(truth["velocity_mps"][start])),
    )


def _granted(snapshots: NDArray[np.void], at: int) -> bool | None:
    """Whether the reset given about here cleared a fault."""
    before, then = snapshots["fault"][at - 1], snapshots["fault"][min(at + 2, len(snapshots) - 1)]
    return None if before == 0 else bool(then == 0)
