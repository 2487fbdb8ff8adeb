"""Every control law in the cycle: it starts without a jump, follows, and a checkpoint holds it; the valve's limits."""

from pathlib import Path

import numpy as np
import pytest
from bench_rig import ROOT, write_rig
from cycle_bench import Bench

from servohil.control.laws.catalogue import LAWS
from servohil.control.laws.law import SATURATED
from servohil.hil.commands import Command, Result
from servohil.hil.config import ConfigError, Rig, load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState, GateLimits
from servohil.sim_bench.evaluations.closed_loop import Case, rig_of
from servohil.sim_bench.evaluations.law_tables import LAW_TABLES

RIG = load_rig(ROOT / "rigs" / "bench.toml")


def rig_with(law: str, **changes: dict[str, object]) -> Rig:
    control = {**LAW_TABLES[law], **changes.pop("control", {})}
    return rig_of(RIG, Case(control, **changes), seed=1)  # type: ignore[arg-type]


@pytest.mark.parametrize("law", LAW_TABLES)
def test_it_starts_without_a_jump_follows_and_goes_on_from_a_checkpoint(law: str) -> None:
    bench = Bench(rig_with(law))
    bench.run(50, DeviceState.DISABLED)
    bench.step(Command.ENABLE)
    bench.run(5, DeviceState.ACTIVE)
    commands = [float(bench.step()["command_v"]) for _ in range(300)]
    assert max(abs(command) for command in commands[:5]) < 0.5
    assert np.abs(np.diff(commands)).max() < 0.5
    row = bench.run(400)
    assert row["state"] == DeviceState.ACTIVE and row["law_flags"] == 0
    assert abs(row["est_position_m"] - row["ref_position_m"]) < (5e-3 if law == "pid" else 5e-4)
    twin = Cycle(rig_with(law))
    twin.restore(bench.cycle.arena.save())
    for _ in range(50):
        bench.step()
        twin.step(bench.inputs.header, bench.inputs.frames)
        assert bytes(twin.snapshot_bytes) == bytes(bench.cycle.snapshot_bytes)


def test_an_integral_waits_while_the_gate_limits_the_slope() -> None:
    """The slew limit is the law's own window, so that its command is never more than a step ahead of what is sent."""
    slow = {"limits": {"command_slew_v_per_s": 20.0, "ramp_down_s": 0.6}}
    bench = Bench(rig_with("intsmc", tables=slow)).active()
    flagged, before = 0, float(bench.cycle.snapshot["command_v"])
    for _ in range(1500):
        row = bench.step()
        assert abs(row["law_v"] - before) <= 0.02 + 1e-12
        flagged += row["law_flags"] == SATURATED
        before = float(row["command_v"])
    assert flagged > 10


@pytest.mark.parametrize("last_v", [-9.0, -0.1, 0.0, 0.1, 9.0])
@pytest.mark.parametrize("limit_v", [0.2, 0.35, 1.0])
def test_a_limit_that_was_lowered_under_way_never_asks_for_more_or_the_other_way(last_v: float, limit_v: float) -> None:
    """With a dead band of 0.3 V a limit of 0.2 V leaves nothing: 0, not the window turned round."""
    tracking = Bench(rig_with("intsmc", control={"dead_band_v": 0.3})).active().cycle._tracking
    x, u = np.array([0.3, 0.2, 2.7, 5.1]), np.array([0.0, 14e6, 0.9e6])
    limits = GateLimits(limit_v, 2.0, 100)
    asked = tracking.command(DeviceState.ACTIVE, 1000, x, u, last_v, limits, 1)
    assert abs(asked) <= limit_v + 1e-12
    if limit_v <= 0.3:
        assert asked == 0.0


@pytest.mark.parametrize(("law", "has"), [("fintsc", True), ("smc", True), ("pid", False), ("pole_placement", False)])
def test_the_switching_gain_is_tunable_where_the_law_has_one(law: str, has: bool) -> None:
    bench = Bench(rig_with(law, control={"dead_band_v": 0.3}))
    table = bench.cycle.parameters
    names = [entry.name for entry in table]
    assert ("control.switching_gain" in names) is has
    assert table[names.index("limits.command_max_v")].minimum == pytest.approx(0.4)
    gains = bench.cycle._tracking.gains.copy()
    if has:
        index = names.index("control.switching_gain")
        row = bench.step(Command.SET_PARAM, command_seq=1, command_index=index, command_value=123.0)
        assert row["command_result"] == Result.ACCEPTED
        changed = np.flatnonzero(bench.cycle._tracking.gains != gains)
        assert changed.tolist() == [LAWS[law].switching] and bench.cycle._tracking.gains[changed[0]] == 123.0


def test_a_dead_band_that_is_known_costs_next_to_nothing() -> None:
    errors = {}
    for known in (0.0, 0.3):
        rig = rig_with("intsmc", control={"dead_band_v": known}, imperfections={"dead_band_v": 0.3})
        bench = Bench(rig).active()
        rows = [bench.step() for _ in range(3000)]
        assert rows[-1]["state"] == DeviceState.ACTIVE
        tracked = []
        for _ in range(2500):
            row = bench.step()
            tracked.append(bench.node.plant.state[0] - row["ref_position_m"])
        errors[known] = float(np.sqrt(np.mean(np.square(tracked))))
    assert errors[0.3] < 0.3 * errors[0.0]


def test_a_dead_band_wider_than_the_command_is_refused(tmp_path: Path) -> None:
    path = write_rig(tmp_path, {"singularity_bound = 0.97": "singularity_bound = 0.97\ndead_band_v = 10.0"})
    with pytest.raises(ConfigError, match=r"control.dead_band_v = 10.0: must be below limits.command_max_v = 10"):
        load_rig(path)
