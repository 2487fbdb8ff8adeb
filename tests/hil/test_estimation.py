"""The filter beside its twin: what the noise figures are, when they are held, what the monitor sees."""

from pathlib import Path

import numpy as np
import pytest
from bench_rig import write_rig

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.diagnosis import DiagnosisSettings
from servohil.hil import assemble
from servohil.hil.config import load_rig
from servohil.hil.estimation import Estimation

U = np.array([0.0, 14e6, 0.9e6])
CONFIGURED = [1e-6, 1e-4, 20e3, 20e3, 40e-6, 20e3, 20e3]


def make(folder: Path, kind: str, edits: dict[str, str] | None = None) -> Estimation:
    rig = load_rig(write_rig(folder, {'filter = "srukf"': f'filter = "{kind}"', **(edits or {})}))
    sizes = assemble.filter_sizes(rig)
    return Estimation(rig, {name: np.full(size, 7.0) for name, size in sizes.items()})


def noise_of(estimation: Estimation) -> np.ndarray:
    out = np.zeros(14)
    estimation.noise(out)
    return out


def drive(estimation: Estimation, steps: int, seed: int = 0) -> None:
    """The piston to and fro, seen through the model itself: sound, and with the node's noise."""
    rng = np.random.default_rng(seed)
    model = estimation.filter.model
    x = np.array([0.2, 0.0, 2.7, 5.1])
    for k in range(steps):
        u = U.copy()
        u[0] = 2.0 * np.sin(5e-3 * k)
        x = model.advance(x, u)
        y = model.outputs(x, u) + rng.normal(size=3) * [20e-6, 0.02, 0.02]
        if k == 0:
            estimation.start(y)
        estimation.step(u, y, moving=True)


@pytest.fixture(scope="module")
def adaptive(tmp_path_factory: pytest.TempPathFactory) -> Estimation:
    return make(tmp_path_factory.mktemp("adaptive"), "asrukf")


def test_a_plain_filter_reports_the_configured_noise_whatever_the_rate(tmp_path: Path) -> None:
    for rate in (1000, 200):
        folder = tmp_path / str(rate)
        folder.mkdir()
        plain = make(folder, "srukf", {"rate_hz = 1000": f"rate_hz = {rate}"} if rate != 1000 else None)
        noise = noise_of(plain)
        np.testing.assert_allclose(noise[:7], CONFIGURED, rtol=1e-12)
        assert np.isnan(noise[7:]).all()
        plain.hold(True)
        plain.forget_noise()
        np.testing.assert_allclose(noise_of(plain)[:7], CONFIGURED, rtol=1e-12)


def test_noise_is_learned_held_and_forgotten_while_the_twin_keeps_its_own(adaptive: Estimation) -> None:
    np.testing.assert_allclose(noise_of(adaptive)[:7], CONFIGURED, rtol=1e-12)
    drive(adaptive, 1500)
    learned = noise_of(adaptive)
    np.testing.assert_allclose(learned[4:7], [20e-6, 20e3, 20e3], rtol=0.2)
    assert (learned[11:] < 0.1).all() and (learned[11:] > 0.0).all()
    variances = np.zeros((2, 2))
    adaptive.view.pressure_residuals(np.zeros(2), variances[0])
    adaptive.pressure_residuals(np.zeros(2), variances[1])
    assert (variances[0] != variances[1]).all()
    configured = adaptive.diagnosis.twin.Q, adaptive.diagnosis.twin.R
    adaptive.hold(True)
    drive(adaptive, 1500, seed=1)
    held = noise_of(adaptive)
    np.testing.assert_allclose(held[:7], CONFIGURED, rtol=1e-12)  # `drive` starts anew, and nothing is learned
    adaptive.hold(False)
    drive(adaptive, 1500)
    x, factor = adaptive.filter.x, adaptive.filter.chol_P
    adaptive.forget_noise()
    np.testing.assert_allclose(noise_of(adaptive)[:7], CONFIGURED, rtol=1e-12)
    np.testing.assert_array_equal(adaptive.filter.x, x)
    np.testing.assert_array_equal(adaptive.filter.chol_P, factor)
    np.testing.assert_array_equal(adaptive.diagnosis.twin.Q, configured[0])
    np.testing.assert_array_equal(adaptive.diagnosis.twin.R, configured[1])


def test_both_filters_predict_over_a_gap(adaptive: Estimation) -> None:
    drive(adaptive, 50)
    before = adaptive.view.x.copy(), adaptive.diagnosis.twin.x
    u = np.array([3.0, 14e6, 0.9e6])
    adaptive.predict(u, 30, moving=False)
    for after, old in zip((adaptive.view.x, adaptive.diagnosis.twin.x), before, strict=True):
        x = old
        for _ in range(30):
            x = adaptive.filter.model.advance(x, u)
        np.testing.assert_allclose(after, x, rtol=1e-3)
        assert after[0] > old[0]


def test_the_rig_file_and_the_diagnosis_have_the_same_defaults(tmp_path: Path) -> None:
    rig = load_rig(write_rig(tmp_path, {'warn_m3_per_s = "0.05 l/min"': "", 'alarm_m3_per_s = "0.3 l/min"': ""}))
    assert assemble.diagnosis_settings(rig) == DiagnosisSettings(settle_s=rig.leakage.settle_s)


def test_after_a_gap_in_which_the_valve_may_have_moved_the_diagnosis_settles_anew(tmp_path: Path) -> None:
    plain = make(tmp_path, "srukf")
    drive(plain, 3000)
    settled = plain.diagnosis.state[at.SETTLED]
    assert settled > 500
    plain.predict(U, 10, True)  # 10 ms
    assert plain.diagnosis.state[at.SETTLED] >= settled
    plain.predict(U, 11, True)
    assert plain.diagnosis.state[at.SETTLED] < settled  # not judged until the filter has forgotten
