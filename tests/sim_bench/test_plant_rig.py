"""Any plant on the bus: the truth is exact, the frames are what the rig says, silence and garbage move nothing."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cantools
import mass_rig
import numpy as np
import pytest
from click.testing import CliRunner
from mass_rig import DAMPING, DT, MASS, MODEL, SPRING, estimator, f, h, law
from scipy.linalg import expm

from servohil.drivers.dbc_writer import NewSignal, resolution
from servohil.drivers.frame import FRAME, FRAME_STRUCT
from servohil.estimators import KF, Model
from servohil.hil.cli import main
from servohil.sim_bench.actuator_node import TruthLog
from servohil.sim_bench.plant_rig import Channel, PlantRig, PlantRigError
from servohil.sim_bench.plant_rig.bench import bench
from servohil.sim_bench.plant_rig.bus import plant_codec, write_dbc
from servohil.sim_bench.plant_rig.controller import PlantController, estimate_rows
from servohil.sim_bench.plant_rig.node import PlantNode, truth_rows

PERIOD_NS = 1_000_000
RIG = mass_rig.rig
QUIET = replace(RIG, sensor_std=(0.0, 0.0))


def node_of(rig: PlantRig) -> PlantNode:
    return PlantNode(rig, TruthLog(100, truth_rows(rig)))


def frames_of(*sent: tuple[int, bytes]) -> np.ndarray:
    frames = np.zeros(max(1, len(sent)), dtype=FRAME)
    for k, (can_id, data) in enumerate(sent):
        frames[k] = np.frombuffer(FRAME_STRUCT.pack(can_id, len(data), 0, 0, 0, data), dtype=FRAME)[0]
    return frames


def decoded(rig: PlantRig, sent: list[tuple[int, bytes]], path: Path) -> dict[str, float]:
    """What the public DBC tool reads from the frames."""
    write_dbc(rig, path)
    database = cantools.database.load_file(path)
    found: dict[str, float] = {}
    for can_id, data in sent:
        message = database.get_message_by_frame_id(can_id)
        values = database.decode_message(can_id, data)
        found.update({f"{message.name}.{key}": value for key, value in values.items()})
    return found


def test_the_truth_is_the_matrix_exponential_and_the_inputs_are_those_in_force() -> None:
    run = bench(QUIET, estimator, law, 0.5)
    block = expm(DT * np.array([[0.0, 1.0, 0.0], [-SPRING / MASS, -DAMPING / MASS, 1.0 / MASS], [0.0, 0.0, 0.0]]))
    x, step = np.array([0.1, 0.0]), resolution(NewSignal("force", *RIG.inputs["force"]), 32)
    for k in range(500):
        # Sent in period k - 2, on the node in k - 1, in force from then on. The first frame's counter is not trusted.
        u = run.command[k - 2, 0] if k >= 3 else 0.0
        x = block[:2, :2] @ x + block[:2, 2] * u
        np.testing.assert_allclose(run.truth[k], x, atol=1e-12 + 1e-3 * k * step * DT)
    assert np.ptp(run.command) > 10.0
    measured = run.measured[1:]
    assert (
        np.abs(measured[:, 0] - run.truth[1:, 0]).max()
        <= 0.5e-3 * resolution(NewSignal("position", *RIG.outputs["position"]), 32) * 1.001
    )


def test_the_filter_follows_and_two_runs_are_the_same_bit_for_bit(tmp_path: Path) -> None:
    first, second = bench(RIG, estimator, law, 1.0), bench(RIG, estimator, law, 1.0)
    np.testing.assert_array_equal(first.truth, second.truth)
    np.testing.assert_array_equal(first.estimate, second.estimate)
    expected = np.sqrt(np.square(first.std[500:]).mean(axis=0))
    assert (first.rms_error < 2.5 * expected).all() and (first.rms_error > 0.2 * expected).all()
    assert np.nanmean(first.nis[500:]) == pytest.approx(2.0, rel=0.2)
    other = bench(replace(RIG, seed=2), estimator, law, 1.0)
    assert (other.measured[1:] != first.measured[1:]).all()
    assert "position" in first.lines()[1] and "m/s" in first.lines()[2]
    first.draw(tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


def test_a_stranger_reads_the_frames_with_the_dbc(tmp_path: Path) -> None:
    node = node_of(QUIET)
    found = decoded(QUIET, list(node.step(frames_of(), 0, 0, 1)), tmp_path / "mass.dbc")
    assert found["position.position"] == pytest.approx(1e3 * node.x[0], abs=1e-6)
    acceleration = -(DAMPING * node.x[1] + SPRING * node.x[0]) / MASS
    assert found["acceleration.acceleration"] == pytest.approx(acceleration, abs=1e-7)
    assert found["applied.force"] == 0.0
    later = decoded(QUIET, list(node.step(frames_of(), 0, PERIOD_NS, 1)), tmp_path / "mass.dbc")
    assert later["position.counter"] == found["position.counter"] + 1


def test_a_sensor_saturates_at_the_end_of_its_range(tmp_path: Path) -> None:
    node = node_of(QUIET)
    node.x[0] = 0.7
    found = decoded(QUIET, list(node.step(frames_of(), 0, 0, 1)), tmp_path / "mass.dbc")
    assert found["position.position"] == 500.0


def commands(count: int, force: float) -> list[tuple[int, bytes]]:
    codec = plant_codec(RIG, node=False)
    return [(0x0A0, codec.encode(codec.message_index("command"), np.array([force]))) for _ in range(count)]


def test_without_a_valid_command_the_inputs_go_to_zero() -> None:
    node = node_of(RIG)
    for k, sent in enumerate(commands(3, 25.0)):
        node.step(frames_of(sent), 1, k * PERIOD_NS, 1)
    assert node.u[0] == 25.0
    for k in range(3, 23):
        node.step(frames_of(), 0, k * PERIOD_NS, 1)
    assert node.u[0] == 25.0  # the last command came 20 ms ago, and not more
    node.step(frames_of(), 0, 23 * PERIOD_NS, 1)
    assert node.u[0] == 0.0


def test_a_damaged_repeated_or_foreign_frame_changes_nothing() -> None:
    node = node_of(RIG)
    good = commands(4, 25.0)
    node.step(frames_of(good[0]), 1, 0, 1)
    node.step(frames_of(good[1]), 1, PERIOD_NS, 1)
    codec = plant_codec(RIG, node=False)
    for _ in range(2):
        other = codec.encode(codec.message_index("command"), np.array([-30.0]))
    flipped = other[:5] + bytes([other[5] ^ 4]) + other[6:]
    for k, bad in enumerate([(0x0A0, flipped), (0x0A0, other), good[1], (0x0A1, good[2][1]), (0x0A0, good[2][1][:6])]):
        node.step(frames_of(bad), 1, (2 + k) * PERIOD_NS, 1)
        assert node.u[0] == 25.0
    node.step(frames_of(good[3]), 1, 8 * PERIOD_NS, 1)
    assert node.u[0] == 25.0


def test_what_does_not_come_is_missing_and_skipped_periods_are_predicted() -> None:
    node, log = node_of(QUIET), TruthLog(10, estimate_rows(RIG, 2))
    controller = PlantController(RIG, estimator, law, log)
    for k in range(3):
        sent = node.step(frames_of(), 0, k * PERIOD_NS, 1)
        controller.step(frames_of(*sent), len(sent), k * PERIOD_NS, 0)
    rows = log.rows()
    assert np.isnan(rows["y"][0]).all() and np.isfinite(rows["y"][1:]).all()
    sent = node.step(frames_of(), 0, 6 * PERIOD_NS, 4)
    only_position = [frame for frame in sent if frame[0] == 0x121]
    controller.step(frames_of(*only_position), 1, 6 * PERIOD_NS, 0, 3)
    last = log.rows()[-1]
    assert np.isfinite(last["y"][0]) and np.isnan(last["y"][1])
    assert controller.filter.health.steps == 7
    np.testing.assert_allclose(controller.filter.x, node.x, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"name": "two words"}, "two words"),
        ({"x0": (0.1,)}, "2 finite numbers"),
        ({"x0": (0.6, 0.0)}, "outputs['position'] = -0.5 .. 0.5: the plant starts at 0.6"),
        ({"inputs": {}}, "the truth has 1"),
        ({"inputs": {"force": Channel(5.0, 40.0, "N")}}, "must contain 0"),
        ({"inputs": {"command": Channel(-5.0, 40.0, "N")}}, "neither 'command' nor 'applied'"),
        ({"inputs": {"force": Channel(-5.0, 40.0, "lbf")}}, "unknown unit 'lbf'"),
        ({"inputs": {"force": Channel(40.0, -40.0, "N")}}, "must be finite and rise"),
        ({"outputs": {"position": Channel(-1.0, 1.0)}}, "the truth has 2"),
        ({"sensor_std": (-1.0, 0.0)}, "sensor_std"),
        ({"process_std": np.nan}, "process_std"),
        ({"command_timeout_s": 0.002}, "at least 3 periods"),
        ({"truth": Model(f, h, 2, 2, [MASS, 9e3, SPRING], DT)}, "above the stability limit"),
    ],
)
def test_a_rig_that_cannot_be_is_refused(change: dict[str, object], named: str) -> None:
    with pytest.raises(ValueError) as refused:
        replace(RIG, **change)
    assert named in str(refused.value)


def test_a_law_that_gives_what_cannot_be_sent_ends_the_run_and_too_much_is_cut() -> None:
    with pytest.raises(PlantRigError, match=r"law at 0\.100 s gave \[nan\]"):
        bench(RIG, estimator, lambda t, x: [np.nan if t >= 0.1 else 0.0], 0.5)
    with pytest.raises(PlantRigError, match="must be 1 finite numbers"):
        bench(RIG, estimator, lambda t, x: [0.0, 0.0], 0.5)
    assert (bench(RIG, estimator, lambda t, x: [1e3], 0.01).command == 40.0).all()
    slow = Model(f, h, 2, 2, MODEL.p, 2 * DT)
    with pytest.raises(PlantRigError, match=r"dt = 0\.002 s"):
        bench(RIG, KF(slow, [0.1, 0.0], np.eye(2), np.eye(2), np.eye(2)), law, 0.01)


NIGHTLY_PLANTS = [
    pytest.param(name, marks=pytest.mark.nightly) for name in ("eha", "two_link_arm", "three_link_arm", "pendubot")
]


@pytest.mark.parametrize("name", ["one_link_arm", *NIGHTLY_PLANTS])  # a filter to compile for each
def test_every_plant_of_the_papers_runs_on_the_bus(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["bench", name, "--lockstep", "--duration", "2", "--json", "found.json"]
    done = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    nis, expected = (float(word) for word in done.output.split("NIS ")[1].split("\n")[0].split(", expected "))
    assert 0.5 * expected < nis < 1.5 * expected
    assert '"rms_error"' in Path("found.json").read_text()


def test_the_command_line_refuses_clearly(tmp_path: Path) -> None:
    empty, half = tmp_path / "empty.py", tmp_path / "half.py"
    empty.write_text("x = 1\n")
    half.write_text("from servohil.sim_bench.plants.rigs.pendubot import rig\n")
    for arguments, named in (
        (["bench", str(tmp_path / "none.py")], "no such file"),
        (["bench", str(empty)], "rig = None: must be a PlantRig"),
        (["bench", str(half), "--lockstep"], "estimator = None: must be a Filter"),
        (["bench", str(half), "--leak-at", "3"], "--leak-at"),
        (["rig", str(half), "--leak", "1e-12"], "--leak"),
        (["bench", "three_armed_bandit"], "no such file"),
    ):
        refused = CliRunner().invoke(main, arguments)
        assert refused.exit_code != 0 and named in refused.output, refused.output


@pytest.mark.processes
def test_in_real_time_a_killed_node_ends_the_bench_in_one_line(tmp_path: Path) -> None:
    text = Path(mass_rig.__file__).read_text().replace('"mass"', f'"mass{os.getpid()}"').replace("def law", "def push")
    text += """

def law(t, x):
    import os, signal
    from pathlib import Path
    if t > 1.0:
        for child in Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split():
            os.kill(int(child), signal.SIGKILL)
    return push(t, x)
"""
    file = tmp_path / "mass.py"
    file.write_text(text)
    done = subprocess.run(
        [sys.executable, "-m", "servohil.hil.cli", "bench", str(file), "--duration", "5"], cwd=tmp_path,
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 1 and "the node ended" in done.stderr and "Traceback" not in done.stderr, done.stderr
