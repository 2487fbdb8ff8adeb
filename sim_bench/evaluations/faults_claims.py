"""What a row of the fault table expects against what was found; claims and the table for the page."""

from collections.abc import Sequence
from typing import Final, NamedTuple

from servohil.hil.claims import Claim
from servohil.hil.config import Rig
from servohil.hil.gate import Event, Reaction
from servohil.hil.reactions import NAMES, read_table
from servohil.sim_bench.actuator_node import plant_section
from servohil.sim_bench.evaluations.faults import CREEP_M, MOVING_MPS, Found, Row

AS_EXPECTED: Final = "as expected"
LEAST_ROWS: Final = 60
STOPPING: Final = (Reaction.FAULT_HOLD, Reaction.RAMP, Reaction.STOP)
WAY: Final = 2  # cycles from a command to the spool, and on to the truth log


class Deadlines(NamedTuple):
    """Cycles from the cause, at most; None: not asked for."""

    event: int | None
    zero: int | None
    centre: int | None


def deadlines(row: Row, rig: Rig) -> Deadlines:
    """What follows from the row's event and the gate's reaction to it.

    The spool may stay for the node's own timeout where commands no longer arrive.
    """
    if not row.event:
        return Deadlines(None, None, None)
    reaction = reaction_of(row.event)
    if reaction not in STOPPING:
        return Deadlines(row.cycles, None, None)
    period_s = rig.loop.period_ns * 1e-9
    ramp = 0 if reaction == Reaction.STOP else round(rig.limits.ramp_down_s / period_s)
    zero = row.cycles + ramp
    timeout = round(plant_section(rig).command_timeout_s / period_s) + 1
    return Deadlines(row.cycles, zero, max(zero, row.cycles + timeout) + WAY if row.stops else None)


def reaction_of(event: str) -> Reaction:
    """What the gate's table says of an event."""
    return NAMES[read_table()[Event[event]]["reaction"]]


def deviations(row: Row, found: Found, rig: Rig) -> list[str]:
    """What is not as the row expects; empty: all is."""
    limit = deadlines(row, rig)
    wrong = []
    if found.speed_mps < MOVING_MPS:
        wrong.append(f"the piston moves at {found.speed_mps:.3f} m/s only")
    if not row.event and found.to_event is not None:
        wrong.append(f"reacts after {found.to_event} cycles: {found.events}")
    measured = {"event": found.to_event, "0 V": found.to_zero, "spool centred": found.to_centre}
    for (name, cycles), most in zip(measured.items(), limit, strict=True):
        if most is not None and (cycles is None or cycles > most):
            wrong.append(f"{name} {'never' if cycles is None else f'after {cycles} cycles'}, not within {most}")
    if found.state != row.state:
        wrong.append(f"state {found.state}")
    if limit.zero is not None and row.stops and found.creep_m > CREEP_M:
        wrong.append(f"the piston goes on by {found.creep_m * 1e3:.1f} mm")
    if row.reset == "at_once" and not found.reset_during:
        wrong.append("no reset granted")
    if row.reset == "after" and found.reset_during:
        wrong.append("reset granted while the fault lasts")
    if row.reset == "after" and not found.reset_after:
        wrong.append("no reset granted after the fault")
    if found.end != row.end:
        wrong.append(f"ends in {found.end}")
    return wrong


def fault_claims(rows: Sequence[Row], found: Sequence[Found], rig: Rig, *, quick: bool) -> list[Claim]:
    """One claim per row, and how many rows there are."""
    command = f"hil evaluate faults{' --quick' if quick else ''}"
    claims = [
        Claim.judge(
            f"faults.{row.place}.{slug(row.name)}", "; ".join(deviations(row, result, rig)) or AS_EXPECTED, "",
            f"== {AS_EXPECTED}", f"{command}: in lockstep at {rig.loop.rate_hz:g} Hz, {result.speed_mps:.2f} m/s",
        )
        for row, result in zip(rows, found, strict=True)
    ]  # fmt: skip
    limit = None if quick else f">= {LEAST_ROWS}"
    return [*claims, Claim.judge("faults.rows", len(rows), "1", limit, f"{command}: rows of the table")]


def slug(name: str) -> str:
    """A name as part of a claim's id."""
    kept = "".join(letter if letter.isalnum() else " " for letter in name.lower())
    return "-".join(kept.split())


def fault_table(rows: Sequence[Row], found: Sequence[Found], rig: Rig) -> str:
    """The table as Markdown; cycles of 1 ms from the cause."""
    holding = sum(not deviations(row, result, rig) for row, result in zip(rows, found, strict=True))
    head = ("fault", "expected", "within", "event", "0 V", "spool at 0", "reset", "end", "error, mm", "as expected", "")
    lines = [
        f"{holding} of {len(rows)} rows as expected. Cycles of {1e3 / rig.loop.rate_hz:g} ms from the cause.",
        "",
        f"| {' | '.join(head)} |",
        "|---|---|---:|---:|---:|---:|---|---|---:|---|---|",
    ]
    for row, result in zip(rows, found, strict=True):
        wrong = deviations(row, result, rig)
        limit = deadlines(row, rig)
        stops = limit.zero is not None
        expected = f"{row.event}: {row.state}" if row.event else f"goes on, {row.state}"
        cells = (
            row.name, expected, _cycles(limit.event), _cycles(result.to_event),
            _cycles(result.to_zero) if stops else "-", _cycles(result.to_centre) if stops else "-",
            row.reset.replace("_", " ").replace("none", "-"), result.end, f"{result.largest_error_m * 1e3:.1f}",
            f"**no**: {'; '.join(wrong)}" if wrong else "yes", row.why,
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _cycles(number: int | None) -> str:
    return "-" if number is None else str(number)
