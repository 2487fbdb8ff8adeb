"""The diagnosis as its users see it: what is refused, what it says of a leak, and of a sound cylinder nothing."""

import numpy as np
import pytest
from hydraulic_bench import HEALTHY, model, sine_motion

from servohil.estimators import Model
from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.changes import CHANGES, N_CHANGES, NAMES
from servohil.estimators.leakage.diagnosis import (
    Diagnosis,
    DiagnosisError,
    DiagnosisSettings,
    expected_ratio,
)
from servohil.estimators.leakage.levels import update_levels
from servohil.estimators.models import cylinder

Q = np.diag(np.square([1e-8, 3e-5, 2e-3, 2e-3]))
R = np.diag(np.square([20e-6, 0.02, 0.02]))


def make(**settings: float) -> Diagnosis:
    return Diagnosis(model(), Q, R, DiagnosisSettings(**settings))


def watch(diagnosis: Diagnosis, faulty: np.ndarray, steps: int, fault_step: int, missing: int | None = None) -> None:
    inputs, samples, _ = sine_motion(steps, 5, HEALTHY.vector(), faulty, fault_step, 0, 0.0)
    if missing is not None:
        samples[:, missing] = np.nan
    diagnosis.start(np.array([0.3, 3.6, 5.75]))
    for u, y in zip(inputs, samples, strict=True):
        diagnosis.step(u, y, True)


def leaking(kind: str, coefficient: float) -> np.ndarray:
    p = HEALTHY.vector()
    p[{"internal": cylinder.K_I, "external_a": cylinder.K_EA, "external_b": cylinder.K_EB}[kind]] = coefficient
    return p


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"hours_between_false_suspicions": 1e7}, "hours_between_false_suspicions = 10000000.0: must be 0.01 to 1e+06"),
        ({"hours_between_false_suspicions": 1e-3}, "0.01 to 1e+06 can be attained"),
        ({"warn_m3_per_s": 1e-9}, "warn_m3_per_s = 1e-09: must be at least 3.33e-07"),
        ({"alarm_m3_per_s": 5e-7}, "alarm_m3_per_s = 5e-07: must be >= warn_m3_per_s"),
        ({"learn_s": 5.0}, "learn_s = 5.0: must be 0, or at least 20"),
        ({"judge_s": 0.1}, "judge_s = 0.1: must be >= 0.25"),
        ({"give_up_s": 0.3}, "give_up_s = 0.3: must be > judge_s = 0.5"),
        ({"confidence": 1.0}, "confidence = 1.0: must be between 0.5 and 1"),
        ({"settle_s": float("nan")}, "settle_s = nan"),
    ],
)
def test_what_cannot_be_attained_is_refused_with_what_can(settings: dict[str, float], said: str) -> None:
    with pytest.raises(DiagnosisError) as caught:
        DiagnosisSettings(**settings)
    assert said in str(caught.value)


def test_a_model_that_is_no_cylinder_and_a_wrong_arena_are_refused() -> None:
    other = Model(cylinder.f, cylinder.h, 4, 3, np.zeros(15), 1e-3, n_u=3)
    with pytest.raises(DiagnosisError, match="must be that of the cylinder"):
        Diagnosis(other, Q, R, DiagnosisSettings())
    with pytest.raises(DiagnosisError, match="arena"):
        Diagnosis(model(), Q, R, DiagnosisSettings(), np.zeros(3))


def test_the_threshold_grows_with_the_time_between_false_suspicions() -> None:
    thresholds = [DiagnosisSettings(hours_between_false_suspicions=h).threshold for h in (0.1, 10.0, 1000.0)]
    np.testing.assert_allclose(np.diff(thresholds), 2.0 * np.log(100.0))
    assert expected_ratio(1.0) == pytest.approx(thresholds[1] - 2.0 * np.log(10.0))


@pytest.mark.parametrize(("kind", "coefficient"), [("internal", 4e-12), ("external_a", 4e-12), ("external_b", 2e-12)])
def test_a_leak_is_found_named_and_sized(kind: str, coefficient: float) -> None:
    diagnosis = make(alarm_m3_per_s=2e-6)
    watch(diagnosis, leaking(kind, coefficient), 6000, 4000)
    assert diagnosis.verdict == kind and diagnosis.state[at.VERDICTS] == 1.0
    size, std = diagnosis.leaks[kind]
    assert size == pytest.approx(coefficient, rel=0.1) and 0.0 < std < 0.05 * coefficient
    for other in diagnosis.leaks.keys() - {kind}:
        assert abs(diagnosis.leaks[other][0]) < 0.1 * coefficient
    detected, onset = diagnosis.state[at.DETECTED] - 4000, diagnosis.state[at.VERDICT_ONSET] - 4000
    assert 0 < detected < 300 and -100 < onset <= detected
    integers, numbers = np.zeros(7, dtype=np.int64), np.zeros(14)
    diagnosis.report(integers, numbers)
    assert integers[3] == integers[6] == NAMES.index(kind) and integers[4] == 1
    assert integers[5] == 6000 - diagnosis.state[at.VERDICT_ONSET]
    assert numbers[4] > 0.999
    assert numbers[5 + NAMES.index(kind)] == size
    assert diagnosis.alarm == 2
    diagnosis.acknowledge()
    assert diagnosis.alarm == 2  # it still leaks as much


def test_a_sound_cylinder_is_left_in_peace_and_a_gain_is_no_leak() -> None:
    diagnosis = make()
    watch(diagnosis, HEALTHY.vector(), 6000, 10**9)
    assert diagnosis.verdict is None and diagnosis.alarm == 0 and not diagnosis.pending
    assert 0.0 <= diagnosis.state[at.RATIO] < DiagnosisSettings().threshold
    changed = HEALTHY.vector()
    changed[cylinder.CS] *= 1.05
    diagnosis = make()
    watch(diagnosis, changed, 6000, 4000)
    assert diagnosis.verdict == "valve_gain" and diagnosis.alarm == 0
    unit = CHANGES[NAMES.index("valve_gain")].unit
    assert diagnosis.state[at.VERDICT_SIZE] * unit == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("missing", [1, 2])
def test_without_a_pressure_it_goes_on_and_says_what_cannot_be_excluded(missing: int) -> None:
    diagnosis = make(give_up_s=1.0)
    watch(diagnosis, leaking("external_b", 2e-12), 4600, 4000, missing)
    assert diagnosis.pending or diagnosis.verdict is not None
    assert np.isfinite(diagnosis.state).all()
    if diagnosis.verdict is None:
        assert bin(int(diagnosis.state[at.UNCLEAR])).count("1") >= 1


def test_what_is_missing_or_infinite_never_makes_a_number_that_is_none() -> None:
    diagnosis = make()
    rng = np.random.default_rng(0)
    diagnosis.start(np.array([0.3, 3.6, 5.75]))
    for k in range(3000):
        u, y = np.array([1.0, 14e6, 0.9e6]), np.array([0.3, 3.6, 5.75]) + rng.normal(size=3)
        if k % 3 == 0:
            y[k % 9 // 3] = [np.nan, np.inf, -1e300][k % 5 % 3]
        if k % 100 == 7:
            u[k % 3] = np.nan
        diagnosis.step(u, y, k % 1000 > 100)
        assert np.isfinite(diagnosis.state).all(), k


def levels(diagnosis: Diagnosis, flow_m3_per_s: float, sure: bool = True) -> int:
    """A block ends with so large an external leak at A, at 4 MPa."""
    state = diagnosis.state
    state[at.MODE], state[at.BLOCK_CYCLES] = at.WATCHING, 32
    state[at.KNOWN + 1] = flow_m3_per_s / 4e6 / 1e-13
    state[at.COVARIANCE + at.C + 1] = 0.01 if sure else 1e4
    update_levels(state, diagnosis._settings, HEALTHY.vector(), np.array([0.3, 0.0, 4.0, 6.0]))
    return diagnosis.alarm


def test_levels_have_hysteresis_and_an_alarm_is_latched() -> None:
    diagnosis = make(warn_m3_per_s=1e-6, alarm_m3_per_s=4e-6)
    assert levels(diagnosis, 0.9e-6) == 0
    assert levels(diagnosis, 1.1e-6) == 1
    assert levels(diagnosis, 0.8e-6) == 1  # hysteresis
    assert levels(diagnosis, 0.6e-6) == 0  # a warning goes with its cause
    assert levels(diagnosis, 4.1e-6) == 2
    assert levels(diagnosis, 0.5e-6) == 2  # latched
    diagnosis.acknowledge()
    assert diagnosis.alarm == 0
    assert levels(diagnosis, 5e-6, sure=True) == 2
    assert diagnosis.state[at.LEAK] == 1


def test_a_flow_that_may_be_chance_is_no_warning() -> None:
    diagnosis = make(warn_m3_per_s=1e-6, alarm_m3_per_s=4e-6)
    assert levels(diagnosis, 5e-6, sure=False) == 0
    assert diagnosis.state[at.LEAK] == -1


def test_one_set_of_changes() -> None:
    assert len(set(NAMES)) == N_CHANGES == 13
    assert NAMES[:3] == ("internal", "external_a", "external_b")
    assert all(c.unit > 0 and c.unknown > 0 and c.configured > 0 and c.drift > 0 and c.step > 0 for c in CHANGES)
