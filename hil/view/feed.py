"""From what a rig says to what pages are sent: one binary block and one small text per tick. No I/O."""

import json
import time
from collections import deque
from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.diagnosis_words import readable_diagnosis
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.encoding import EncodingError, decode_batch
from servohil.hil.telemetry.publisher import readable_snapshot
from servohil.hil.view.block import encode_block
from servohil.hil.view.columns import NAMES, Recent, columns_of
from servohil.hil.view.freshness import STALE_NS, Freshness
from servohil.hil.view.lateness import BINS_PER_OCTAVE, FIRST_EDGE_NS, RecentLateness
from servohil.hil.view.rig_link import Message, cycle_of, parsed

NOW_NS: Final = 100_000_000  # people read numbers no faster
SLOW_NS: Final = 500_000_000
RECENT_S: Final = 60.0
EVENTS: Final = 100  # kept for a page that is opened later
# What the page shows of the newest cycle; the rest of the Snapshot stays in the recording.
SHOWN: Final = (
    "cycle", "t_ns", "active_t_ns", "state", "fault", "skipped", "overruns", "lateness_ns", "exec_ns", "rx_rejected",
    "tx_failed", "filter_repairs", "leak_alarm", "leak_since_ns", "param_version",
    "position_m", "ref_position_m", "est_position_m", "est_velocity_mps", "ref_velocity_mps",
    "pressure_a_pa", "pressure_b_pa", "est_pressure_a_pa", "est_pressure_b_pa", "std_pressure_a_pa",
    "std_pressure_b_pa", "supply_pa", "tank_pa", "command_v", "law_v", "spool_v", "nis",
    "change_statistic", "change_threshold",
)  # fmt: skip


class Feed:
    """Takes messages of a rig and makes messages for pages. Times are this process's monotonic clock, ns."""

    def __init__(self) -> None:
        self.freshness = Freshness()
        self.documents_old = False  # since the last look: the rig has come back, or another one has come
        self.problem: str | None = None  # with the way to the rig, for people
        self.lost = 0  # batches that did not come, and messages that nobody could read
        self._recent = Recent(RECENT_S)
        self._lateness = RecentLateness()
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS)
        self._parameters: dict[str, dict[str, Any]] = {}
        self._meta: dict[str, Any] = {}
        self._health: dict[str, Any] | None = None
        self._last_row: Any = None
        self._seq: int | None = None
        self._now_ns = self._slow_ns = 0

    def tick(self, messages: Iterable[Message], now_ns: int) -> tuple[bytes | None, str | None]:
        """A block of new columns and a text of what else is new, each None where nothing is."""
        parts: list[NDArray[np.void]] = []
        news: dict[str, Any] = {}
        events: list[dict[str, Any]] = []
        for message in sorted(messages, key=cycle_of):
            if message.name == "state":
                rows = self._rows(message)
                if len(rows):
                    parts.append(rows)
            elif (content := parsed(message.payload)) is None:
                self.lost += 1
            elif message.name == "health":
                news["health"] = self._health = content
            elif message.name == "meta":
                self._meta = content
                news["meta"] = self._about()
            elif message.name.startswith("param/"):
                self._parameters[message.name.removeprefix("param/")] = content
                news["parameters"] = list(self._parameters.values())
            elif message.name.startswith("event/") and content not in self._events:
                self._events.append(content)
                events.append(content)
        if events:
            news["events"] = events
        block = self._add(parts)
        if now_ns - self._now_ns >= NOW_NS:
            self._now_ns = now_ns
            news |= self._present(now_ns)
        if now_ns - self._slow_ns >= SLOW_NS and self._last_row is not None:
            self._slow_ns = now_ns
            news["lateness"] = self._lateness.counts()
        return block, json.dumps(news) if news else None

    def greeting(self, now_ns: int) -> tuple[str, bytes | None]:
        """What a page that is opened now has to know: how blocks are made, and what was before."""
        content = {
            "columns": NAMES,
            "stale_ms": STALE_NS / 1e6,
            "lateness_bins": {"first_us": FIRST_EDGE_NS / 1e3, "per_octave": BINS_PER_OCTAVE},
            "meta": self._about(),
            "parameters": list(self._parameters.values()),
            "events": list(self._events),
            "lateness": self._lateness.counts(),
            **({"health": self._health} if self._health else {}),
            **self._present(now_ns),
        }
        recent = self._recent.all()
        return json.dumps(content), None if recent is None else encode_block(recent)

    def _rows(self, message: Message) -> NDArray[np.void]:
        try:
            batch, rows = decode_batch(message.payload)
        except EncodingError:
            self.lost += 1
            return np.empty(0, SNAPSHOT)
        if self._seq is not None and batch.seq > self._seq + 1:
            self.lost += batch.seq - self._seq - 1
        self._seq = batch.seq
        if len(rows):
            self.documents_old |= self.freshness.is_stale(message.at_ns)
            if self.freshness.saw(int(rows["cycle"][-1]), batch.age_ns, message.at_ns):
                self.documents_old = True
                self._events.clear()
        return rows

    def _add(self, parts: list[NDArray[np.void]]) -> bytes | None:
        """Take new SNAPSHOT rows; the block of them. What a restart left behind in the same tick is dropped."""
        if not parts:
            return None
        rows = np.concatenate(parts)
        back = np.flatnonzero(np.diff(rows["t_ns"]) < 0)
        rows = rows[back[-1] + 1 :] if len(back) else rows
        self._last_row = rows[-1]
        self._lateness.add(rows)
        columns = columns_of(rows)
        self._recent.add(columns)
        return encode_block(columns)

    def _present(self, now_ns: int) -> dict[str, Any]:
        age_s = self.freshness.age_s(now_ns)
        content: dict[str, Any] = {
            "age_ms": None if age_s is None else round(age_s * 1e3, 1),
            "stale": self.freshness.is_stale(now_ns),
            "lost": self.lost,
            "problem": self.problem,
            "sent_ms": time.time_ns() // 1_000_000,
        }
        if self._last_row is not None:
            snapshot = readable_snapshot(self._last_row)
            content["now"] = {name: snapshot[name] for name in SHOWN}
            content["diagnosis"] = readable_diagnosis(self._last_row)
        return content

    def _about(self) -> dict[str, Any]:
        """Of `meta`, what a person wants to see; not the meaning of every field."""
        return {name: value for name, value in self._meta.items() if name not in ("fields", "states")}
