"""`hil observability RIG.toml`: which sensors of a rig can tell its states, and how well, along its own motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.control.laws.catalogue import LAWS
from servohil.control.laws.law import STATE_SIZE
from servohil.control.references import evaluate
from servohil.estimators.model import Model
from servohil.estimators.models import cylinder
from servohil.estimators.observability import Observability, gramian_observability, lie_observability
from servohil.hil.assemble import PA_PER_MPA, build_model, build_profile
from servohil.hil.claims import Claim, write_claims
from servohil.hil.config import Rig
from servohil.hil.provenance import provenance

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SENSOR_SETS: Final = ((0, 1, 2), (0,), (1, 2))  # all; position alone (P3); pressures alone
POINTS: Final = 25  # of the motion at which the rank is taken
WINDOWS: Final = 8
WINDOW_S: Final = 1.0
LONGEST_S: Final = 30.0


@dataclass(frozen=True)
class Motion:
    """What the rig does in its reference: state before and input over each cycle."""

    states: Matrix  # (N, 4) m, m/s, MPa, MPa
    inputs: Matrix  # (N, 3) V, Pa, Pa
    what: str


@dataclass(frozen=True)
class SensorSet:
    """How some of the rig's sensors see the states."""

    sensors: tuple[str, ...]
    ranks: tuple[int, ...]  # at points along the motion
    hardest: Observability  # over the worst of some windows


def observability_command(rig: Rig, json_path: Path | None) -> list[str]:
    """Judge the rig's sensors and write the claims if asked to; the lines for the terminal.

    Raises:
        GainError, ProfileError: the rig's law or reference cannot be used.
        ObservabilityError: the simulated motion does not stay finite.
    """
    model = build_model(rig)
    motion = simulate_motion(rig, model)
    sets = [judge(rig, model, motion, outputs) for outputs in SENSOR_SETS]
    if json_path is not None:
        write_claims(json_path, claims(sets, motion), provenance(config_hash=rig.config_hash()))
    return lines(rig, sets, motion)


def simulate_motion(rig: Rig, model: Model) -> Motion:
    """One period of the reference, or its first 30 s, under the rig's law, all on the estimator's model; no noise."""
    supply, tank = (rig.plant.supply_pa, rig.plant.tank_pa) if rig.plant else (rig.limits.supply_min_pa, 0.0)
    reference = build_profile(rig)
    period = min(reference.period_s, LONGEST_S)
    profile, gains, law = reference.vector(), rig.control.gains(), np.zeros(STATE_SIZE)
    step, limit_v = LAWS[rig.control.law].step, rig.limits.command_max_v
    ref, e, jerk = np.zeros(4), np.zeros(3), np.zeros(3)
    evaluate(profile, reference.blend_s, 0.0, ref)
    start = float(ref[0])
    x = np.array([start, 0.0, *balanced_pressures(rig, supply, tank)])
    u = np.array([0.0, supply, tank])
    before, steps = round(reference.blend_s / model.dt), round(period / model.dt)
    states, inputs = np.empty((before + steps, 4)), np.empty((before + steps, 3))
    for k in range(before + steps):
        evaluate(profile, k * model.dt, start, ref)
        e[:] = x[0] - ref[0], x[1] - ref[1], cylinder.acceleration(x, model.p) - ref[2]
        cylinder.jerk_model(x, u, model.p, jerk)
        u[0] = step(law, gains, e, ref, *jerk, -limit_v, limit_v, model.dt)
        states[k], inputs[k] = x, u
        x = model.advance(x, u)
    part = "one period" if period == reference.period_s else "the beginning"
    what = f"{part} ({period:.3g} s) of the {rig.reference.kind} reference at {supply / 1e5:.3g} bar supply"
    return Motion(states[before:], inputs[before:], what)


def balanced_pressures(rig: Rig, supply_pa: float, tank_pa: float) -> tuple[float, float]:
    """Chamber pressures, MPa, of a piston that extends slowly: the forces and the valve's two flows in balance."""
    body = rig.cylinder
    ratio = body.area_a_m2 / body.area_b_m2
    load = body.load_force_n / body.area_a_m2
    pressure_b = (supply_pa + ratio**2 * tank_pa - load) / (ratio**2 + 1.0 / ratio)
    return (pressure_b / ratio + load) / PA_PER_MPA, pressure_b / PA_PER_MPA


def judge(rig: Rig, model: Model, motion: Motion, outputs: Sequence[int]) -> SensorSet:
    """Rank at points along the motion, and the Gramian of the worst window."""
    initial, measured = rig.estimator.initial_std, rig.estimator.measurement_std
    floor = np.array([initial.position_m, initial.velocity_mps, initial.pressure_a_pa, initial.pressure_b_pa])
    floor[2:] /= PA_PER_MPA
    noise = np.array([measured.position_m, measured.pressure_a_pa / PA_PER_MPA, measured.pressure_b_pa / PA_PER_MPA])
    scales = np.maximum(np.ptp(motion.states, axis=0) / 2.0, floor)
    count = len(motion.states)
    ranks = [
        lie_observability(model, motion.states[k], motion.inputs[k], scales, outputs).rank
        for k in np.linspace(0, count - 1, POINTS).astype(int)
    ]
    length = min(round(WINDOW_S / model.dt), count)
    windows = [
        gramian_observability(model, motion.states[k], motion.inputs[k : k + length], scales, noise, outputs)
        for k in np.linspace(0, count - length, WINDOWS).astype(int)
    ]
    names = tuple(cylinder.OUTPUT_NAMES[channel] for channel in outputs)
    return SensorSet(names, tuple(ranks), min(windows, key=lambda window: float(window.strengths[-1])))


def lines(rig: Rig, sets: Sequence[SensorSet], motion: Motion) -> list[str]:
    """What a person reads."""
    states = len(cylinder.STATE_NAMES)
    text = [f"{rig.name}: which sensors tell {', '.join(cylinder.STATE_NAMES)}", f"along {motion.what}"]
    for judged in sets:
        full, hardest = sum(rank == states for rank in judged.ranks), judged.hardest
        text += ["", f"{', '.join(judged.sensors)}"]
        text.append(f"  rank      {states} of {states} at {full} of {POINTS} points{_elsewhere(judged)}")
        if hardest.rank < states or hardest.strengths[-1] < 1.0:
            text.append(
                f"  not told  {hardest.describe_weakest()}: {WINDOW_S:g} s of data do not show a change so large"
            )
            continue
        step = hardest.describe_weakest(1.0 / hardest.strengths[-1])
        text.append(f"  hardest   {step} (condition {hardest.condition:.1e})")
        best = zip(hardest.state_std, cylinder.STATE_UNITS, cylinder.STATE_NAMES, strict=True)
        text.append("  at best   " + ", ".join(f"{name} +-{std:.2g} {unit}" for std, unit, name in best))
    text += [
        "",
        "rank: of the Lie derivatives at single states; below full the sensors cannot tell all states there.",
        "hardest: the combination of states that shows least, as large as the sensors' noise leaves it after",
        f"{WINDOW_S:g} s, the worst of {WINDOWS} stretches. at best: standard deviations that no filter can better",
        "from these data alone, before any process noise.",
    ]
    return text


def _elsewhere(judged: SensorSet) -> str:
    lower = sorted({rank for rank in judged.ranks if rank < len(cylinder.STATE_NAMES)})
    return f", {' or '.join(map(str, lower))} at the others" if lower else ""


def claims(sets: Sequence[SensorSet], motion: Motion) -> list[Claim]:
    """The same as figures. P3 3.2: the position alone makes all states observable, so more sensors do."""
    states = len(cylinder.STATE_NAMES)
    how = f"hil observability: {motion.what}"
    result = []
    for judged in sets:
        name = f"observability.{'-'.join(judged.sensors)}"
        hardest = judged.hardest
        limit = f">= {states}" if "position" in judged.sensors else None
        rank = f"{how}, least rank of the Lie derivatives at {POINTS} points"
        gramian = f"{how}, empirical Gramian of the worst of {WINDOWS} windows of {WINDOW_S:g} s"
        condition = hardest.condition if hardest.rank == states else None
        result.append(Claim.judge(f"{name}.rank", min(judged.ranks), "1", limit, rank))
        result.append(Claim.judge(f"{name}.condition", condition, "1", None, gramian))
        result.append(Claim.judge(f"{name}.hardest", hardest.describe_weakest(), "", None, gramian))
    return result
