"""The live page in a real browser against a running controller and cylinder: what an operator sees and does."""

import itertools
import math
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from bench_rig import start, wait_until, write_slow_rig

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")

CHROMIUM = Path("/usr/bin/chromium")
pytestmark = [
    pytest.mark.processes,
    pytest.mark.skipif(not CHROMIUM.exists(), reason=f"no {CHROMIUM}: the live page is not tested (apt: chromium)"),
]
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
PATIENCE_MS = 60_000
LEAK_AT_S = 9.0  # after the first ACTIVE command: 2 s of blending in, 2 s until anything is judged, some motion
GAP_S = 0.5  # the page has something new every 0.2 s
FLAGGED_S, ALARMED_S = 2.0, 5.0  # the page's promise, after the leak
LEAK = 4e-12  # m3/(s Pa): 1 l/min at the pressures of this motion


WATCH = """
window.seen = [];
setInterval(() => {
  const now = [document.querySelector('#time').textContent, document.querySelector('#leak').dataset.mode ?? '',
    document.querySelector('#alarm-list [data-level=alarm]') !== null];
  if (!Number.isNaN(Number(now[0])) && String(now) !== String(window.seen.at(-1))) window.seen.push(now);
}, 20);
"""


@dataclass
class Rig:
    """A controller that is up and disabled, its cylinder, and the page's address with the operator's token."""

    controller: subprocess.Popen[str]
    telemetry_pid: int
    address: str


def line_of(process: subprocess.Popen[str], beginning: str) -> str:
    """The first line of a process that begins so."""
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if line.startswith(beginning):
            return line
    raise AssertionError("".join(lines))


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    file = write_slow_rig(tmp_path)
    started = [start("rig", file, "--leak-at", LEAK_AT_S, "--leak", LEAK)]
    try:
        started.append(start("run", file))
        found = re.match(r"telemetry: (\S+), process (\d+)", line_of(started[-1], "telemetry: "))
        assert found
        options = ("--connect", found[1], "--rig", "bench", "--listen", "127.0.0.1:0", "--operator")
        started.append(start("view", *options))
        yield Rig(started[1], int(found[2]), line_of(started[-1], "view: ").split()[1])
    finally:
        for process in reversed(started):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            assert process.stdout is not None
            process.stdout.close()


@pytest.fixture
def browser() -> Iterator["playwright.Browser"]:
    with playwright.sync_playwright() as engine:
        running = engine.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield running
        running.close()


class OpenPage:
    """What the test asks of a page."""

    def __init__(self, browser: "playwright.Browser", address: str) -> None:
        self.errors: list[str] = []
        self.tab = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
        self.tab.set_default_timeout(PATIENCE_MS)
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("console", lambda m: self.errors.append(m.text) if m.type in ("error", "warning") else None)
        self.tab.goto(address)

    def text(self, selector: str) -> str:
        return self.tab.inner_text(selector)

    def number(self, selector: str) -> float:
        """A figure as the page writes it; NaN for a dash."""
        return float(self.text(selector).replace("\N{MINUS SIGN}", "-").replace("\N{EN DASH}", "nan"))

    def shows(self, selector: str, text: str) -> None:
        """Wait until an element that can be seen holds `text`."""
        self.tab.locator(selector, has_text=text).first.wait_for(state="visible")

    def does(self, condition: str) -> None:
        """Wait until an expression is true in the page (asked from outside: the page itself may not evaluate text)."""
        wait_until(lambda: self.tab.evaluate(condition), condition, PATIENCE_MS / 1000)

    def watch(self) -> None:
        """Have the page note when it shows what; the test does other things meanwhile and misses nothing."""
        self.tab.evaluate(WATCH)

    def seen(self) -> list[tuple[float, str, bool]]:
        """(loop time in s, mode of the diagnosis, whether a leak alarm is shown), whenever one of them changed."""
        return [(float(time), mode, alarm) for time, mode, alarm in self.tab.evaluate("window.seen")]

    def press(self, command: str) -> None:
        """Press an operator's button and wait for the answer."""
        self.tab.click(f"[data-cmd={command}]")
        self.shows("#reply[data-ok]", f"{command}: ")

    def swing_mm(self, series: str, patience_s: float, least_mm: float) -> float:
        """Largest less smallest value that the legend shows of a series, once it is `least_mm`."""
        seen: list[float] = []

        def wide() -> bool:
            value = self.number(f"[data-series={series}]")
            seen.extend([] if math.isnan(value) else [value])
            return bool(seen) and max(seen) - min(seen) >= least_mm

        wait_until(wide, f"{series} to swing by {least_mm} mm", patience_s)
        return max(seen) - min(seen)


def check_delays(seen: list[tuple[float, str, bool]], leak_s: float) -> None:
    """The change is flagged and the leak alarmed in time, and not before; in loop time as the page shows it.

    A machine that stands still shows nothing new meanwhile; that time is not the page's.
    """
    after = [entry for entry in seen if entry[0] >= leak_s - 0.5]
    flagged_s = next(time for time, mode, _ in after if mode == "judging")
    alarmed_s = next(time for time, _, alarm in after if alarm)
    assert not any(alarm for time, _, alarm in seen if time < leak_s - 0.5)
    times = [leak_s, *(time for time, _, _ in after)]
    gaps = [(end, end - start) for start, end in itertools.pairwise(times) if end - start > GAP_S]
    assert flagged_s <= leak_s + FLAGGED_S + sum(gap for end, gap in gaps if end <= flagged_s)
    assert alarmed_s <= leak_s + ALARMED_S + sum(gap for end, gap in gaps if end <= alarmed_s)


@pytest.mark.timeout(280)
def test_an_operators_hour(rig: Rig, browser: "playwright.Browser") -> None:
    page = OpenPage(browser, rig.address)
    page.shows("#state", "DISABLED")
    page.shows("#link", "live")
    page.tab.wait_for_selector("body.may-operate")
    assert "token" not in page.tab.url  # not left in the address for the next person to copy

    # A profile outside the limits is refused with what is allowed, and nothing changes; one inside them is taken.
    amplitude = '[name="reference.amplitude_m"]'
    page.does(f"document.querySelector('{amplitude}')?.value === '0.05'")
    page.tab.fill(amplitude, "5")
    page.tab.click("#apply")
    page.shows("#reply[data-ok=false]", "allowed is 0 to 0.28 m")
    page.tab.fill(amplitude, "0.1")
    page.tab.click("#apply")
    page.shows("#reply[data-ok=true]", "reference.amplitude_m = 0.1: accepted")

    page.watch()
    page.press("enable")
    page.shows("#events", "HOLD -> ACTIVE")
    enabled_s = float(page.text("#events li:has-text('HOLD -> ACTIVE') time").split()[0])
    page.swing_mm("position_m", 60.0, 5.0)
    assert page.swing_mm("ref_position_m", 60.0, 120.0) < 205.0  # 2 x 100 mm; the file says 2 x 50 mm

    # Whoever has only the bare address sees everything and can do nothing.
    viewer = OpenPage(browser, rig.address.partition("#")[0])
    viewer.shows("#state", "ACTIVE")
    assert not viewer.tab.is_visible("#estop") and not viewer.tab.is_visible("[data-cmd=enable]")
    viewer.tab.close()

    page.shows("#alarm-list [data-level=alarm]", "internal leak, A to B")
    page.shows("#leak tr.found", "internal")
    assert page.number("#leak tr.found td:nth-child(2)") == pytest.approx(1.0, abs=0.4)  # l/min
    check_delays(page.seen(), enabled_s + LEAK_AT_S)
    page.press("hold")

    page.tab.click("#acknowledge")
    page.shows("#reply[data-ok=true]", "acknowledge: accepted")
    page.tab.keyboard.press("p")
    page.shows("#pause", "Paused")

    page.tab.click("#estop")
    page.shows("#reply[data-ok=true]", "e-stop: accepted")
    page.shows("#state", "FAULT DISABLED")
    page.shows("#alarm-list", "ESTOP")
    page.tab.locator("#banner").wait_for(state="hidden")
    page.tab.keyboard.press("Escape")  # works from anywhere, in every state
    page.shows("#reply[data-ok=true]", "FAULT_DISABLED")

    os.kill(rig.controller.pid, signal.SIGKILL)
    page.shows("#banner", "STALE: no new cycle for")
    page.does("document.body.classList.contains('stale')")
    assert page.errors == []
