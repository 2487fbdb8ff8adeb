"""`hil top`: a running rig on one screen of a terminal, from what it says in JSON."""

import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from rich.columns import Columns
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from servohil.hil.diagnosis_words import L_PER_MIN
from servohil.hil.view.freshness import Freshness
from servohil.hil.view.rig_link import Message, RigLink, cycle_of, parsed

KEYS: Final = ("snapshot", "health", "diagnosis", "event/**")
ONCE_S: Final = 5.0  # for a first screen; `health` comes once a second
REFRESH_HZ: Final = 5
EVENTS: Final = 8
BAR: Final = 1e5
_STYLES: Final = {"alarm": "bold red", "error": "bold red", "warning": "yellow", "none": "green"}


class Screen:
    """What is known of the rig, and how it looks. Times are this process's monotonic clock, ns."""

    def __init__(self, rig: str, endpoint: str) -> None:
        self._title = f"{rig} at {endpoint}"
        self._freshness = Freshness()
        self._newest: dict[str, dict[str, Any]] = {"snapshot": {}, "health": {}, "diagnosis": {}}
        self._events: deque[dict[str, Any]] = deque(maxlen=EVENTS)

    @property
    def complete(self) -> bool:
        """Whether every part has something to show."""
        return all(self._newest.values())

    def take(self, messages: Iterable[Message]) -> None:
        """Remember what is newest; what is not JSON is nobody's."""
        for message in sorted(messages, key=cycle_of):
            content = parsed(message.payload)
            if content is None:
                continue
            if message.name in self._newest:
                self._newest[message.name] = content
            elif message.name.startswith("event/") and content not in self._events:
                self._events.append(content)
            cycle = content.get("cycle")
            if message.name == "snapshot" and isinstance(cycle, int):
                self._freshness.saw(cycle, -1, message.at_ns)

    def render(self, now_ns: int, problem: str | None) -> RenderableType:
        """The screen as of now; `problem`: with the way to the rig."""
        if not self._newest["snapshot"]:
            return Panel(Text(f"no data: {problem or 'the rig is silent'}", style="yellow"), title=self._title)
        age_s, stale = self._freshness.age_s(now_ns) or 0.0, self._freshness.is_stale(now_ns)
        parts: list[RenderableType] = [self._head(age_s)]
        if stale:
            text = f" STALE: no new cycle for {age_s:.1f} s; what you see is the past "
            parts.append(Text(text, style="bold white on red"))
        parts += ["", Columns([self._motion(), self._leakage()], padding=(0, 3)), "", self._timing(), "", self._log()]
        return Panel(Group(*parts), title=self._title, border_style="red" if stale else "default", width=100)

    def _head(self, age_s: float) -> Text:
        state = str(self._newest["snapshot"].get("state"))
        style = "bold red" if state.startswith("FAULT") else "bold green" if state == "ACTIVE" else "bold cyan"
        loop_s = _number(self._newest["snapshot"], "t_ns", 1e9)
        cycle = self._newest["snapshot"].get("cycle")
        return Text.assemble((f"{state:<16}", style), f"loop time {loop_s:>10} s   cycle {cycle}   age {age_s:.1f} s")

    def _motion(self) -> Table:
        table = _table("", "measured", "estimated", "+- 2 sigma", "reference", "")
        for name, measured, estimated, deviation, reference, scale, unit in (
            ("position", "position_m", "est_position_m", "std_position_m", "ref_position_m", 1e-3, "mm"),
            ("velocity", "", "est_velocity_mps", "std_velocity_mps", "ref_velocity_mps", 1e-3, "mm/s"),
            ("pressure A", "pressure_a_pa", "est_pressure_a_pa", "std_pressure_a_pa", "", BAR, "bar"),
            ("pressure B", "pressure_b_pa", "est_pressure_b_pa", "std_pressure_b_pa", "", BAR, "bar"),
            ("supply", "supply_pa", "", "", "", BAR, "bar"),
            ("valve", "spool_v", "", "", "command_v", 1.0, "V"),
        ):
            values = [_number(self._newest["snapshot"], key, scale) for key in (measured, estimated)]
            values.append(_number(self._newest["snapshot"], deviation, scale / 2.0))
            table.add_row(name, *values, _number(self._newest["snapshot"], reference, scale), unit)
        return table

    def _leakage(self) -> RenderableType:
        content = self._newest["diagnosis"]
        level = str(content.get("level"))
        table = _table("leak", "l/min")
        leaks = content.get("leaks")
        for name, leak in leaks.items() if isinstance(leaks, dict) else ():
            found = level != "none" and content.get("leak") == name
            flow = _number(leak if isinstance(leak, dict) else {}, "flow_m3ps", 1.0 / L_PER_MIN, 3)
            table.add_row(str(name), flow, style="bold red" if found else "")
        words = f"{content.get('mode')}; leak {level}\n{content.get('text')}"
        return Group(table, Text(words, style=_STYLES.get(level, "")))

    def _timing(self) -> RenderableType:
        health = self._newest["health"]
        table = _table("us, since the start", "p50", "p99", "p99.9", "max")
        for name, key in (("lateness", "lateness_us"), ("execution", "exec_us")):
            figures = health.get(key)
            spread = figures if isinstance(figures, dict) else {}
            table.add_row(name, *(_number(spread, part, 1.0, 1) for part in ("p50", "p99", "p999", "max")))
        counts = (("overruns", "overruns"), ("skipped", "periods_skipped"), ("rejected", "rx_rejected"))
        words = [f"{text} {health.get(key, '-')}" for text, key in (*counts, ("lost", "lost"))]
        rate = f"rate {_number(health, 'rate_hz', 1.0, 1)} Hz"
        return Group(table, Text("   ".join([rate, *words]), style="default"))

    def _log(self) -> RenderableType:
        lines = Text()
        for event in reversed(self._events):
            severity = str(event.get("severity"))
            when = _number(event, "t_ns", 1e9)
            lines.append(f"{when:>10} s  {severity:<8} {event.get('text', '')}\n", style=_STYLES.get(severity, ""))
        return lines


def _table(*heads: str) -> Table:
    table = Table(box=None, padding=(0, 1), pad_edge=False)
    for place, head in enumerate(heads):
        table.add_column(head, justify="right" if place and head else "left", header_style="dim", no_wrap=True)
    return table


def _number(content: dict[str, Any], name: str, scale: float, digits: int = 2) -> str:
    """A value from somebody else's JSON in units of `scale`; a dash where there is none."""
    value = content.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "-" if name else ""
    return f"{value / scale:.{digits}f}"


def top_command(endpoint: str, rig: str, credentials: Path | None, once: bool) -> None:
    """Show the rig until Ctrl-C, or `once`. Raises CredentialsError, OSError; OSError with `once` and no data."""
    link = RigLink(endpoint, rig, KEYS, credentials)
    screen = Screen(rig, endpoint)
    console = Console()
    link.start()
    try:
        if once:
            _once(link, screen, console)
            return
        with Live(console=console, screen=True, auto_refresh=False) as live:
            while True:
                screen.take(link.take())
                live.update(screen.render(time.monotonic_ns(), link.problem), refresh=True)
                time.sleep(1.0 / REFRESH_HZ)
    finally:
        link.close()


def _once(link: RigLink, screen: Screen, console: Console) -> None:
    deadline = time.monotonic() + ONCE_S
    while not screen.complete and time.monotonic() < deadline:
        screen.take(link.take())
        time.sleep(0.02)
    console.print(screen.render(time.monotonic_ns(), link.problem))
    if not screen.complete:
        raise OSError(f"{link.endpoint}: rig {link.rig}: {link.problem or 'the rig is silent'}")
