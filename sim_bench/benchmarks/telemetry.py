"""`hil benchmark telemetry`: how old a sample is at a subscriber, and what many rigs cost behind one router."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

from servohil.hil.claims import Claim
from servohil.sim_bench.benchmarks.telemetry_fleet import FleetRun, run_fleet

Tick = Callable[[int], None]

RATE_HZ: Final = 1000.0
FLEET_HZ: Final = 50.0
FLEETS: Final = (5, 10, 20)
QUICK_FLEETS: Final = (2, 4)
LINEAR_WITHIN: Final = 1.5


def telemetry_claims(quick: bool, tick: Tick) -> list[Claim]:
    """Ages with one rig at 1 kHz; losses and costs of fleets at 50 Hz. A quick run judges the losses alone."""
    command = f"hil benchmark telemetry{' --quick' if quick else ''}"
    seconds = 3.0 if quick else 15.0
    one = _run(1, RATE_HZ, seconds, routed=False)
    tick(1)
    how = f"{command}; one rig at {RATE_HZ:g} Hz for {seconds:g} s, recorded, a subscriber in Python on this machine"
    claims = [
        Claim.judge("telemetry.lost", one.written - one.received, "1", "== 0", how),
        Claim.judge("telemetry.age.p50", one.age_ms["p50"], "ms", None if quick else "<= 2", f"{how}; newest sample"),
        Claim.judge("telemetry.age.p99", one.age_ms["p99"], "ms", None if quick else "<= 10", f"{how}; newest sample"),
        Claim.judge("telemetry.rig", one.rig_share, "%", None, f"{how}; telemetry's share of one processor"),
        Claim.judge("telemetry.subscriber", one.subscriber_share, "%", None, f"{how}; its share of one processor"),
    ]
    shares = []
    fleets = QUICK_FLEETS if quick else FLEETS
    for number, rigs in enumerate(fleets):
        fleet = _run(rigs, FLEET_HZ, seconds, routed=True)
        tick(2 + number)
        shares.append(fleet.router_share / rigs)
        how = f"{command}; {rigs} rigs at {FLEET_HZ:g} Hz for {seconds:g} s through one router, one subscriber to all"
        name = f"telemetry.fleet{rigs}"
        claims += [
            Claim.judge(f"{name}.lost", fleet.written - fleet.received, "1", "== 0", how),
            Claim.judge(f"{name}.router_per_rig", shares[-1], "%", None, f"{how}; of one processor"),
            Claim.judge(f"{name}.rig", fleet.rig_share, "%", None, f"{how}; telemetry of one rig, of one processor"),
            Claim.judge(f"{name}.age.p99", fleet.age_ms["p99"], "ms", None, f"{how}; newest sample"),
        ]
    text = f"router's share per rig, {fleets[-1]} rigs to {fleets[0]}: linear growth is 1"
    limit = None if quick else f"<= {LINEAR_WITHIN}"
    ratio = shares[-1] / shares[0] if shares[0] else None
    return [*claims, Claim.judge("telemetry.fleet.growth", ratio, "1", limit, f"{command}; {text}")]


def _run(rigs: int, rate_hz: float, seconds: float, routed: bool) -> FleetRun:
    with tempfile.TemporaryDirectory(prefix="servohil-telemetry-") as folder:
        return run_fleet(rigs, rate_hz, seconds, Path(folder), routed)
