"""What people read of the diagnosis is what the diagnosis means."""

import json

import numpy as np

from servohil.estimators.leakage.changes import CHANGES, INPUT, OUTPUT
from servohil.estimators.models.cylinder import STATE_TO_SI
from servohil.hil.diagnosis_words import CHANGE_WORDS, change_name, leak_text, readable_diagnosis, verdict_text
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.publisher import to_json


def row(**fields: float) -> np.void:
    out = np.zeros(1, SNAPSHOT)
    out["verdict"] = out["leak_kind"] = out["verdict_onset_cycles"] = -1
    for name, value in fields.items():
        out[name] = value
    return out[0]


def test_the_words_are_those_of_the_changes() -> None:
    assert [(words.name, words.text) for words in CHANGE_WORDS] == [(change.name, change.text) for change in CHANGES]
    for words, change in zip(CHANGE_WORDS, CHANGES, strict=True):
        to_si = STATE_TO_SI[change.place + 1] if change.moves == OUTPUT else 1.0
        factor = change.unit * (100.0 if change.relative else 1.0) * to_si
        np.testing.assert_allclose(words.factor, factor)
        assert (words.unit == "%") == change.relative
        assert (words.unit == "V") == (change.moves == INPUT and change.place == 0)
    assert (change_name(-1), change_name(2), change_name(13)) == (None, "external_b", "unknown")


def test_a_sound_cylinder_and_one_that_leaks() -> None:
    sound = readable_diagnosis(row(cycle=7, diagnosis_mode=2, change_statistic=3.0, change_threshold=36.8))
    assert (sound["mode"], sound["verdict"], sound["leak"], sound["level"]) == ("watching", None, None, "none")
    assert sound["text"] == "nothing has changed"
    leaking = row(
        cycle=5000, diagnosis_mode=3, unclear=0b1001, verdict=0, verdicts=1, verdict_size=20.0, verdict_std=1.0,
        verdict_confidence=0.9999, verdict_onset_cycles=600, leak_kind=0, leak_alarm=2, leak_internal=2e-12,
        leak_internal_std=2e-14, leak_internal_m3ps=5e-6, residual_a_pa=np.nan,
    )  # fmt: skip
    found = readable_diagnosis(leaking)
    assert found["verdict"] == {
        "change": "internal", "size": 2e-12, "std": 1e-13, "unit": "m3/(s Pa)", "confidence": 0.9999,
        "since_cycle": 4400,
    }  # fmt: skip
    assert found["leaks"]["internal"] == {"coefficient": 2e-12, "std": 2e-14, "flow_m3ps": 5e-6}
    assert (found["leak"], found["level"], found["not_excluded"]) == ("internal", "alarm", ["internal", "valve_gain"])
    assert found["text"] == leak_text(leaking) == "internal leak, A to B: 0.30 l/min above the baseline"
    assert found["residuals_pa"] == [None, 0.0]
    assert json.loads(to_json(found)) == found


def test_what_no_single_change_explains() -> None:
    unknown = row(verdict=13, verdicts=1)
    assert verdict_text(unknown) == "something changed that no single cause explains"
    assert readable_diagnosis(unknown)["verdict"]["change"] == "unknown"
