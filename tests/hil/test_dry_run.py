"""The dry run exercises a cycle and leaves no trace in it, whatever the rate."""

from pathlib import Path

import pytest
from bench_rig import write_rig, write_slow_rig

from servohil.hil.commands import Command
from servohil.hil.config import load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.dry_run import dry_run
from servohil.hil.gate import DeviceState
from servohil.hil.operator_script import OperatorScript


@pytest.mark.parametrize("write", [write_rig, write_slow_rig])
@pytest.mark.parametrize("listen_only", [False, True])
def test_the_cycle_is_as_it_was(tmp_path: Path, write: object, listen_only: bool) -> None:
    assert callable(write)
    cycle = Cycle(load_rig(write(tmp_path)), listen_only=listen_only)
    state, told = cycle.arena.save(), bytes(cycle.snapshot_bytes)
    dry_run(cycle)
    assert cycle.arena.save() == state
    assert bytes(cycle.snapshot_bytes) == told
    assert (cycle.snapshot["state"], cycle.snapshot["active_t_ns"]) == (DeviceState.INIT, -1)


def test_an_operator_of_a_short_run_does_not_take_it_for_the_run(tmp_path: Path) -> None:
    rig = load_rig(write_slow_rig(tmp_path))
    cycle = Cycle(rig)
    dry_run(cycle)  # 3.7 s in its own time
    script = OperatorScript(rig.loop.rate_hz, 1.0, enable=True, stop_on_fault=True)
    for _ in range(30):
        told = script.next(int(cycle.snapshot["state"]), int(cycle.snapshot["active_t_ns"]))
        assert told == Command.NONE
    assert not script.finished
