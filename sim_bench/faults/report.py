"""What a bench report says of the faults of its run: when each set in, and when the controller reacted."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.gate import DeviceState, Event, Reaction
from servohil.hil.reactions import NAMES, read_table
from servohil.sim_bench.faults.kinds import FOREVER, Fault, Operator

NS_PER_S: Final = 1_000_000_000


def reacting_events() -> int:
    """Bits of the events that lead to something by the gate's table."""
    return int(sum(int(event) for event, entry in read_table().items() if NAMES[entry["reaction"]] > Reaction.NONE))


def event_names(bits: int) -> list[str]:
    """Names of the gate's events in a bit field."""
    return [str(event.name) for event in Event if bits & event]


def fault_report(scenario: Sequence[Fault], snapshots: NDArray[np.void], period_ns: int) -> list[dict[str, Any]]:
    """One entry per fault; times in s from the first ACTIVE cycle, None where there was no reaction.

    A reaction is an event that the gate acts on; to an operator's command, another device state.
    """
    mask = reacting_events()
    since = snapshots["active_t_ns"] // period_ns
    found = []
    for fault in scenario:
        first, end = fault.window(period_ns / NS_PER_S)
        entry: dict[str, Any] = {
            "kind": fault.kind,
            "at_s": first * period_ns / NS_PER_S,
            "for_s": None if end >= FOREVER else (end - first) * period_ns / NS_PER_S,
            "set_in": bool((since >= first).any()),
            "reacted_at_s": None, "events": [], "state": None,
        }  # fmt: skip
        at = int(np.searchsorted(since, first))
        if entry["set_in"]:
            told = snapshots[at:]
            reactions = (told["events"] & mask) != 0
            if isinstance(fault, Operator):
                reactions |= told["state"] != snapshots["state"][max(0, at - 1)]
            reacted = np.flatnonzero(reactions)
            if reacted.size:
                row = told[reacted[0]]
                entry["reacted_at_s"] = float(row["active_t_ns"]) / NS_PER_S
                entry["events"] = event_names(int(row["events"]) & mask)
                entry["state"] = DeviceState(int(row["state"])).name
        found.append(entry)
    return found


def fault_lines(report: Mapping[str, Any]) -> list[str]:
    """The same for a terminal; nothing for a run without faults."""
    lines = []
    for entry in report.get("faults", []):
        length = "to the end" if entry["for_s"] is None else f"for {entry['for_s']:g} s"
        text = f"{entry['kind']} at {entry['at_s']:.3f} s, {length}: "
        if not entry["set_in"]:
            text += "the run ended before"
        elif entry["reacted_at_s"] is None:
            text += "no reaction"
        else:
            text += " ".join([f"{entry['state']} at {entry['reacted_at_s']:.3f} s", *entry["events"]])
        lines.append(f"{'fault':<12} {text}")
    return lines
