"""What changed between two Snapshots that a person should hear about. Pure: rows in, events out."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.diagnosis_words import LEAKS, LEVELS, change_name, leak_text, verdict_text
from servohil.hil.telemetry.schema import FAULT_STATES, state_name

Event = dict[str, Any]
_WATCHED: Final = ("state", "leak_alarm", "fault", "verdicts")
ALARM: Final = LEVELS.index("alarm")
DIAGNOSED: Final = ("leak", "change")  # codes of events that come from the diagnosis


def bit_names(bits: int, names: tuple[str, ...]) -> list[str]:
    """Names of the set bits, lowest first; `bit_i` where there is no name."""
    return [names[i] if i < len(names) else f"bit_{i}" for i in range(bits.bit_length()) if bits >> i & 1]


class ChangeDetector:
    """Remembers the last row's state, leak alarm, fault bits and count of verdicts."""

    def __init__(self, fault_names: tuple[str, ...] = ()) -> None:
        self._fault_names = fault_names
        self._last = dict.fromkeys(_WATCHED, 0)
        self._seen = False

    def changes(self, rows: NDArray[np.void]) -> list[Event]:
        """Events of these SNAPSHOT rows (n,), oldest first."""
        last = self._last
        if self._seen and not any((rows[name] != last[name]).any() for name in _WATCHED):
            return []
        events = []
        for row in rows:
            for name, describe in (
                ("fault", self._fault), ("verdicts", self._change), ("leak_alarm", self._leak), ("state", self._state)
            ):  # fmt: skip
                value = int(row[name])
                if value != last[name] or (name == "state" and not self._seen):
                    event = describe(row, last[name], value)
                    events.append({**event, "cycle": int(row["cycle"]), "t_ns": int(row["t_ns"])})
                    last[name] = value
            self._seen = True
        return events

    def _state(self, _row: Any, before: int, now: int) -> Event:
        severity = "error" if now in FAULT_STATES else "info"
        start = state_name(before) if self._seen else None
        text = f"{start} -> {state_name(now)}" if start else state_name(now)
        return {"severity": severity, "code": "state", "from": start, "to": state_name(now), "text": text}

    def _change(self, row: Any, _before: int, _now: int) -> Event:
        name = change_name(int(row["verdict"]))
        severity = "warning" if name in LEAKS else "info"
        return {"severity": severity, "code": "change", "change": name, "text": verdict_text(row)}

    def _leak(self, row: Any, before: int, now: int) -> Event:
        text = leak_text(row) if now else "no leak alarm any more" if before == ALARM else "no leak warning any more"
        return {
            "severity": ("info", "warning", "alarm")[min(now, ALARM)],
            "code": "leak",
            "active": bool(now),
            "leak": change_name(int(row["leak_kind"])),
            "channel": int(row["leak_channel"]),
            "since_ns": int(row["leak_since_ns"]),
            "text": text,
        }

    def _fault(self, _row: Any, before: int, now: int) -> Event:
        new, names = now & ~before, bit_names(now, self._fault_names)
        return {
            "severity": "error" if new else "info",
            "code": "fault",
            "bits": now,
            "names": names,
            "new": bit_names(new, self._fault_names),
            "text": f"latched: {', '.join(names)}" if names else "no fault latched",
        }
