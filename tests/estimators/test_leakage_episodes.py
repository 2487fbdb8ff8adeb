"""What becomes of a suspicion, and of what was learnt: into the model, the state, the scale; and a second look."""

import numpy as np
import pytest
from hydraulic_bench import HEALTHY, model, sine_motion

from servohil.estimators.arena import arena_offsets
from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.changes import NAMES
from servohil.estimators.leakage.diagnosis import Diagnosis, DiagnosisSettings
from servohil.estimators.leakage.learning import calibrate
from servohil.estimators.leakage.model_update import fold
from servohil.estimators.models import cylinder

Q = np.diag(np.square([1e-8, 3e-5, 2e-3, 2e-3]))
R = np.diag(np.square([20e-6, 0.02, 0.02]))
C = at.C


def test_what_is_put_into_the_model_moves_the_state_to_where_it_would_have_been() -> None:
    rng = np.random.default_rng(1)
    arena, settings, twin = np.zeros(at.ARENA_SIZE), np.zeros(at.SETTINGS_SIZE), np.zeros(arena_offsets(4, 3)[-1])
    signatures, theta, known, x = rng.normal(size=(C, 4)), rng.normal(size=C), rng.normal(size=C), rng.normal(size=4)
    arena[at.SIGNATURES : at.SIGNATURES + 4 * C] = signatures.ravel()
    arena[at.THETA : at.THETA + C], arena[at.KNOWN : at.KNOWN + C] = theta, known
    twin[:4] = x
    settings[at.SETTLE_STEPS], settings[at.GUARD_STEPS] = 500.0, 20.0
    fold(arena, settings, twin)
    np.testing.assert_allclose(twin[:4], x + signatures.T @ theta, rtol=1e-12)
    np.testing.assert_allclose(arena[at.KNOWN : at.KNOWN + C], known + theta, rtol=1e-12)
    assert (arena[at.THETA : at.THETA + C] == 0.0).all() and arena[at.SETTLED] == 480.0


@pytest.mark.parametrize(("worst", "factor"), [(3.0, 3.0), (0.5, 1.0)])
def test_a_ratio_larger_than_that_of_white_innovations_makes_all_of_them_say_less(worst: float, factor: float) -> None:
    arena, settings = np.zeros(at.ARENA_SIZE), np.zeros(at.SETTINGS_SIZE)
    arena[at.MODE], arena[at.SCALE], arena[at.COVARIANCE] = at.CALIBRATING, 2.0, 5.0
    arena[at.LEARNT], arena[at.BLOCK_CYCLES], settings[at.LEARN_STEPS] = 968.0, 32.0, 1000.0
    settings[at.EXPECTED_RATIO], arena[at.WORST_RATIO] = 8.0, 8.0 * worst
    arena[at.KNOWN], arena[at.THETA] = 3.0, 0.5
    calibrate(arena, settings)
    assert (arena[at.SCALE], arena[at.COVARIANCE]) == (2.0 * factor, 5.0 * factor)
    assert arena[at.MODE] == at.WATCHING and arena[at.BASELINE] == 3.5


def test_a_second_change_during_the_judgement_of_the_first_is_looked_at_alone() -> None:
    """A leak, and 0.3 s later the offset of a sensor: no single change explains what followed the leak's onset."""
    faulty = HEALTHY.vector()
    faulty[cylinder.K_I] = 4e-12
    inputs, samples, _ = sine_motion(9000, 5, HEALTHY.vector(), faulty, 4000, 0, 0.0)
    samples[4300:, 1] += 0.1
    diagnosis = Diagnosis(model(), Q, R, DiagnosisSettings())
    diagnosis.start(np.array([0.3, 3.6, 5.75]))
    found = []
    for u, y in zip(inputs, samples, strict=True):
        diagnosis.step(u, y, True)
        if diagnosis.state[at.VERDICTS] > len(found):
            found.append(diagnosis.verdict)
    assert found and set(found) <= {"internal", "sensor_a"} and not diagnosis.pending
    amounts = diagnosis.state[at.KNOWN : at.KNOWN + C] + diagnosis.state[at.THETA : at.THETA + C]
    assert diagnosis.leaks["internal"][0] == pytest.approx(4e-12, rel=0.2)
    assert amounts[NAMES.index("sensor_a")] != 0.0
