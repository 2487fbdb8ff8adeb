"""The gate's table of reactions, from `reactions.toml`; `python -m servohil.hil.reactions` prints it as Markdown."""

import sys
import tomllib
from pathlib import Path
from typing import Any, Final

from servohil.hil.gate import ALWAYS_STOP, Event, Reaction, Reactions

TABLE: Final = Path(__file__).with_name("reactions.toml")
KEYS: Final = {"trigger": str, "reaction": str, "latched": bool, "deadline": str, "why": str}
NAMES: Final = {reaction.name.lower(): reaction for reaction in Reaction}


class ReactionsError(ValueError):
    """The table is incomplete or contradicts a rule of the gate. Names file, event, value and what is allowed."""


def read_table(path: Path = TABLE) -> dict[Event, dict[str, Any]]:
    """The entries of the file, one per event in the order of their bits.

    Raises:
        ReactionsError: the file is not TOML; an event is missing or unknown; a key is missing, unknown or of the wrong
            type; the reaction is unknown; a fault is not latched; an event that the gate always stops on has another
            reaction.
    """
    try:
        entries: dict[str, dict[str, Any]] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ReactionsError(f"{path}: not TOML: {error}") from error
    for name in entries:
        if name not in Event.__members__:
            raise ReactionsError(f"{path}: {name}: unknown event; allowed: {', '.join(Event.__members__)}")
    for event in Event:
        _check(path, event, entries.get(str(event.name)))
    return {event: entries[str(event.name)] for event in Event}


def _check(path: Path, event: Event, entry: dict[str, Any] | None) -> None:
    if entry is None:
        raise ReactionsError(f"{path}: {event.name}: missing; every event needs an entry")
    if not isinstance(entry, dict):
        raise ReactionsError(f"{path}: {event.name} = {entry!r}: must be a table with {', '.join(KEYS)}")
    for key in entry:
        if key not in KEYS:
            raise ReactionsError(f"{path}: {event.name}.{key}: unknown key; allowed: {', '.join(KEYS)}")
    for key, kind in KEYS.items():
        if not isinstance(entry.get(key), kind):
            raise ReactionsError(f"{path}: {event.name}.{key} = {entry.get(key)!r}: must be a {kind.__name__}")
    if entry["reaction"] not in NAMES:
        allowed = ", ".join(NAMES)
        raise ReactionsError(f"{path}: {event.name}.reaction = {entry['reaction']!r}: allowed: {allowed}")
    if NAMES[entry["reaction"]] > Reaction.HOLD and not entry["latched"]:
        raise ReactionsError(f"{path}: {event.name}.latched = False: must be true for {entry['reaction']}")
    if event & ALWAYS_STOP and entry["reaction"] != "stop":
        raise ReactionsError(f"{path}: {event.name}.reaction = {entry['reaction']!r}: must be stop")


def load_reactions(leak_alarm: str = "none", path: Path = TABLE) -> Reactions:
    """Masks for the gate.

    Args:
        leak_alarm: reaction to LEAK_ALARM, `leakage.reaction` of the rig: none, hold or fault_hold.
        path: the table.

    Raises:
        ReactionsError: as `read_table`, or `leak_alarm` is something else.
    """
    if leak_alarm not in ("none", "hold", "fault_hold"):
        raise ReactionsError(f"leakage.reaction = {leak_alarm!r}: allowed: none, hold, fault_hold")
    masks = dict.fromkeys(Reaction, 0)
    latched = 0
    for event, entry in read_table(path).items():
        reaction = NAMES[leak_alarm if event is Event.LEAK_ALARM else entry["reaction"]]
        masks[reaction] |= int(event)
        # Nothing follows from an event without reaction, so there is nothing to reset either.
        latched |= int(event) if entry["latched"] and reaction != Reaction.NONE else 0
    return Reactions(
        none=masks[Reaction.NONE],
        hold=masks[Reaction.HOLD],
        fault_hold=masks[Reaction.FAULT_HOLD],
        ramp=masks[Reaction.RAMP],
        stop=masks[Reaction.STOP],
        latched=latched,
    )


def markdown(path: Path = TABLE) -> str:
    """The table for the documentation."""
    lines = ["| event | raised when | reaction | latched | deadline | why |", "|---|---|---|---|---|---|"]
    for event, entry in read_table(path).items():
        latched = "yes" if entry["latched"] else "no"
        cells = (event.name, entry["trigger"], entry["reaction"], latched, entry["deadline"], entry["why"])
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(markdown())
