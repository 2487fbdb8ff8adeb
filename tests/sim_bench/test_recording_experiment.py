"""The experiment on an actuator's recording: its reader, the ARX reference, parameters found where they are known."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

from servohil.hil.cli import main
from servohil.sim_bench.campaign_table import read_table
from servohil.sim_bench.experiments import p1_recording
from servohil.sim_bench.experiments.arx import arx_coefficients
from servohil.sim_bench.experiments.catalogue import chosen
from servohil.sim_bench.experiments.p1_recording import ARX, DOUBT, LEAST, OURS, SCORED, START, TRAINING
from servohil.sim_bench.experiments.recording import Recording, RecordingError, read_recording
from servohil.sim_bench.experiments.reproduce import reproduce

REAL = Path(__file__).parents[2].parent / "shared" / "data" / "actuator_sjoberg"
TRUE = START + 0.5 * DOUBT * np.array([1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1])


def steps(rng, count):
    """An opening that changes every 20 to 60 samples, both ways and often to nearly closed."""
    u = np.empty(count)
    k = 0
    while k < count:
        length = int(rng.integers(20, 60))
        u[k : k + length] = rng.choice([0.0, rng.uniform(-1.5, 1.5)])
        k += length
    return np.convolve(u, np.ones(8) / 8)[:count]


def by_solver(p, u):
    """(N, 4) states after each sample, u[k - 1] held before it: the documented equations by an adaptive solver."""
    offset, up, width_up, down, width_down, rate, stiffness, damping, quadratic, per_inertia, load = p

    def slope(_, s, opening):
        pressure, speed, _, flow = s
        wanted = up * np.tanh(opening / width_up) if opening > 0 else down * np.tanh(opening / width_down)
        force = pressure - damping * speed - quadratic * speed * abs(speed) - load
        return [stiffness * (flow - speed), per_inertia * force, speed, rate * (wanted - flow)]

    states = [np.zeros(4)]
    for held in u[:-1]:
        states.append(solve_ivp(slope, (0, 1), states[-1], args=(offset - held,), rtol=1e-8, atol=1e-10).y[:, -1])
    return np.array(states)


@pytest.fixture(scope="module")
def synthetic():
    rng = np.random.default_rng(5)
    u = steps(rng, LEAST)
    states = by_solver(TRUE, u)
    return Recording(u, states[:, 0] + 0.02 * rng.normal(size=LEAST), states[:, 2] + 0.005 * rng.normal(size=LEAST))


def written(path, recording):
    rows = [f"{u!r},{p!r},{x!r}" for u, p, x in zip(*map(np.ndarray.tolist, vars(recording).values()), strict=True)]
    path.write_text("\n".join(["u_valve,p_oil_pressure,x_position", *rows]) + "\n")
    return path


def test_a_recording_is_what_the_file_says(tmp_path, synthetic):
    file = written(tmp_path / "actuator.csv", synthetic)
    for path in (file, tmp_path):
        found = read_recording(path, LEAST)
        for name in "upx":
            np.testing.assert_array_equal(getattr(found, name), getattr(synthetic, name))
    other = tmp_path / "other.csv"
    other.write_text("x, time, p_bar, u\n3.5, 9, 2, -1\n\n4, 10, 2.5, 1e-1\n")
    found = read_recording(other, 2)
    assert (found.u.tolist(), found.p.tolist(), found.x.tolist()) == ([-1.0, 0.1], [2.0, 2.5], [3.5, 4.0])
    other.write_text("x, time, p_bar, u\n3.5, 10, 2, -1\n\n4, 9, 2.5, 1e-1\n")
    assert read_recording(other, 2).digest == found.digest  # another time is the same recording
    for changed in ("3.5, 9, 2, -1.0001", "3.5, 9, 2.0001, -1", "3.5001, 9, 2, -1"):
        other.write_text(f"x, time, p_bar, u\n{changed}\n\n4, 10, 2.5, 1e-1\n")
        assert read_recording(other, 2).digest != found.digest


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["line 1", "'u'"]),
        ("u,p,y\n1,2,3\n1,2,3\n", ["u, p, y", "'x'"]),
        ("u,u_2,p,x\n1,2,3,4\n1,2,3,4\n", ["u, u_2, p, x", "exactly one", "'u'"]),
        ("u,p,x\n1,2,3\n", ["1 rows", "at least 2"]),
        ("u,p,x\n1,2,3\n1,2\n", ["row 3", "2 values", "must be 3"]),
        ("u,p,x\n1,2,3\n1,abc,3\n", ["row 3", "column p", "'abc'", "finite"]),
        ("u,p,x\n1,2,nan\n1,2,3\n", ["row 2", "column x", "'nan'", "finite"]),
        ("u,p,x\n1,2,3\n\n-inf,2,3\n", ["row 4", "column u", "'-inf'", "finite"]),
        ("u,p,x\n1,,3\n1,2,3\n", ["row 2", "column p", "''", "finite"]),
    ],
)
def test_a_recording_that_cannot_be_used_is_refused(tmp_path, text, said):
    file = tmp_path / "some.csv"
    file.write_text(text)
    with pytest.raises(RecordingError) as refused:
        read_recording(file, 2)
    assert all(part in str(refused.value) for part in [str(file), *said]), refused.value


def test_a_file_that_is_not_there_is_named(tmp_path):
    for path, named in ((tmp_path / "no.csv", "no.csv"), (tmp_path, "actuator.csv")):
        with pytest.raises(RecordingError, match=named):
            read_recording(path, 2)
    refused = CliRunner().invoke(main, ["reproduce", "all", "--data", str(tmp_path / "no.csv")])
    assert refused.exit_code == 1 and "no.csv" in refused.output
    with pytest.raises(ValueError, match="p1-table9 needs no recording"):
        chosen("p1-table9", tmp_path)


def test_arx_finds_the_coefficients_and_predicts_by_them():
    rng = np.random.default_rng(2)
    true = np.array([1.6, -0.9, 0.1, -0.4, 0.3, 0.05])
    u, noise = rng.normal(size=LEAST), 0.01 * rng.normal(size=LEAST)
    p = rng.normal(size=LEAST)
    for k in range(3, LEAST):
        p[k] = true @ [p[k - 1], p[k - 2], p[k - 3], u[k - 1], u[k - 2], 1.0]
    np.testing.assert_allclose(arx_coefficients(u, p), true, atol=1e-9)

    p = p + noise  # now the fit is no longer exact, and both predictions err
    c = arx_coefficients(u[:TRAINING], p[:TRAINING])
    ahead, free = p.copy(), p.copy()
    for k in range(SCORED, LEAST):
        ahead[k] = c @ [p[k - 1], p[k - 2], p[k - 3], u[k - 1], u[k - 2], 1.0]
        free[k] = c @ [free[k - 1], free[k - 2], free[k - 3], u[k - 1], u[k - 2], 1.0]
    experiment = p1_recording.experiment(Recording(u, p, np.zeros(LEAST)))
    data = experiment.data(np.random.default_rng(0))
    found = experiment.track(experiment.filters[ARX](), data)
    np.testing.assert_allclose(found[SCORED:, 0], ahead[SCORED:], atol=1e-9)
    np.testing.assert_allclose(found[SCORED:, 1], free[SCORED:], atol=1e-9)
    expected = [np.sqrt(np.mean((q - p)[SCORED:] ** 2)) for q in (ahead, free)]
    np.testing.assert_allclose(experiment.metric.of(data.states, found), expected, atol=1e-9)


def test_the_joint_filter_finds_the_parameters_that_made_the_record(synthetic):
    experiment = p1_recording.experiment(synthetic)
    for seed in (0, 1):
        data = experiment.data(np.random.default_rng(seed))
        found = p1_recording.trained(p1_recording.joint(synthetic), data.start, data.inputs[:512], data.samples[:512])
        error = np.abs(found - TRUE) / DOUBT
        assert (error < 0.1).all(), (seed, error)
        assert (np.abs(data.start - TRUE) / DOUBT).max() > 1.0


def test_a_prediction_knows_nothing_of_what_it_predicts(synthetic):
    """Positions of the held-back half are not used, nor is a pressure before it was predicted."""
    later = 900
    p, x = synthetic.p.copy(), synthetic.x.copy()
    p[later:], x[TRAINING:] = 7.0, -7.0
    found = []
    for recording in (synthetic, Recording(synthetic.u, p, x)):
        experiment = p1_recording.experiment(recording)
        data = experiment.data(np.random.default_rng(0))
        found.append([experiment.track(build(), data)[SCORED:] for build in experiment.filters.values()])
    for as_it_was, changed in zip(*found, strict=True):
        np.testing.assert_array_equal(as_it_was[:, 1], changed[:, 1])
        seen = later - SCORED + 1  # from here on after a pressure that was changed
        np.testing.assert_allclose(as_it_was[:seen, 0], changed[:seen, 0], atol=1e-12)
        assert np.abs(as_it_was[seen:, 0] - changed[seen:, 0]).max() > 1.0


def test_the_page_with_and_without_a_recording(tmp_path, synthetic):
    out = tmp_path / "out"
    runner = CliRunner()
    bare = runner.invoke(main, ["reproduce", "p1-recording", "--out", str(out)], catch_exceptions=False)
    assert bare.exit_code == 0 and bare.output.count("cannot be tested") == 3
    assert "no recording given (--data PATH)" in (out / "p1-recording.md").read_text()
    file = written(tmp_path / "some.csv", synthetic)
    command = ["reproduce", "p1-recording", "--data", str(file), "--runs", "2", "--out", str(out)]
    shown = runner.invoke(main, command, catch_exceptions=False)
    assert shown.exit_code == 0 and "cannot be tested" not in shown.output
    assert "holds              ours: free run better" in shown.output
    assert "does not hold      ours: ARX(3, 2) is as reported" in shown.output  # it was of another recording
    assert f"| {OURS} |" in (out / "p1-recording.md").read_text()
    assert (out / "p1-recording.png").read_bytes().startswith(b"\x89PNG")
    table = read_table(out / "runs" / "table.parquet")
    assert set(table["data"]) == {synthetic.digest}
    # half as much pressure, half the error; a resumed folder has the other recording's runs still
    half = p1_recording.experiment(Recording(synthetic.u, 0.5 * synthetic.p, synthetic.x))
    results = reproduce([half], 1, out / "runs")["p1-recording"]
    first = table["whole"][(table["filter"] == ARX) & (table["run"] == 0)]
    np.testing.assert_allclose(results[ARX].whole[0], 0.5 * first, rtol=1e-6)


def test_the_real_recording(tmp_path):
    if not REAL.exists():
        pytest.skip(f"the recording is not there: {REAL}")
    results = reproduce(chosen("p1-recording", REAL), 3, tmp_path)["p1-recording"]
    np.testing.assert_allclose(results[ARX].medians, [0.111, 0.954], atol=5e-4)
    assert (results[OURS].whole[:, 1] < 0.7).all()
