"""The adaptive square-root filters: the papers' form against plain numpy, the limited form against what it claims."""

import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, model
from test_aukf import compare_with_print

from servohil.estimators import SRUKF
from servohil.estimators.asrukf import ASRUKF
from servohil.estimators.health import Status

NAN = float("nan")
Q, R = np.diag(PROCESS_STD**2), np.diag(MEASUREMENT_STD**2)


def adaptive(adaptation, q=Q, r=R, **options):
    return ASRUKF(model(), X0, P0, q, r, adaptation=adaptation, **options)


def test_equals_algorithm_1_of_p1():
    used = compare_with_print(adaptive("sage-husa", forgetting=0.98), 300, 1.0, False, 1e-7)
    assert used.min() > 0 and used.max() < 300


def test_off_is_the_srukf_bit_for_bit():
    inputs, samples, _ = healthy_motion(200)
    samples[50:60, 1] = NAN
    ours = adaptive("off").run(inputs, samples)
    reference = SRUKF(model(), X0, P0, Q, R).run(inputs, samples)
    assert ours.x.tobytes() == reference.x.tobytes() and ours.P.tobytes() == reference.P.tobytes()


def simulate(steps, seed, process_std, measurement_std):
    """Truth with exactly these noises."""
    rng = np.random.default_rng(seed)
    plant, x = model(), X0.copy()
    time = np.arange(steps) * 1e-3
    inputs = np.column_stack([3 * np.cos(40 * time), np.full(steps, 14e6), np.full(steps, 0.9e6)])
    states, samples = np.empty((steps, 4)), np.empty((steps, 3))
    process, measurement = rng.normal(size=(steps, 4)), rng.normal(size=(steps, 3))
    for k in range(steps):
        x = plant.advance(x, inputs[k]) + process_std * process[k]
        states[k] = x
        samples[k] = x[[0, 2, 3]] + measurement_std * measurement[k]
    return inputs, samples, states


@pytest.fixture(scope="module")
def motion():
    return simulate(6000, 3, PROCESS_STD, MEASUREMENT_STD)


def mean_nees(trajectory, states, start=3000):
    error = states[start:] - trajectory.x[start:]
    return float(np.einsum("ki,ki->", error, np.linalg.solve(trajectory.P[start:], error[:, :, None])[:, :, 0])) / len(
        error
    )


@pytest.mark.parametrize("structure", ["diagonal", "full"])
@pytest.mark.parametrize("ratio", [20.0, 1 / 20])
def test_limited_finds_r_when_q_is_known(motion, ratio, structure):
    inputs, samples, states = motion
    ours = adaptive("limited", r=ratio * R, structure=structure, forgetting=0.998)
    frozen = mean_nees(adaptive("off", r=ratio * R).run(inputs, samples), states)
    nees = mean_nees(ours.run(inputs, samples), states)
    assert (np.abs(np.diag(ours.R) / np.diag(R) - 1.0) < 0.25).all(), np.diag(ours.R) / np.diag(R)
    assert abs(nees - 4.0) < 0.5 < abs(frozen - 4.0), (nees, frozen)
    np.testing.assert_allclose(ours.Q, Q, rtol=1e-14)
    off_diagonal = ours.R[~np.eye(3, dtype=bool)]
    assert (off_diagonal == 0).all() if structure == "diagonal" else (off_diagonal != 0).all()


@pytest.mark.parametrize("ratio", [20.0, 1 / 20])
def test_limited_repairs_the_confidence_when_r_is_known(motion, ratio):
    inputs, samples, states = motion
    ours = adaptive("limited", q=ratio * Q, adapt="Q", forgetting=0.99)
    frozen = mean_nees(adaptive("off", q=ratio * Q).run(inputs, samples), states)
    nees = mean_nees(ours.run(inputs, samples), states)
    # Not as good as knowing Q: single states stay wrong by a factor, and their errors add up.
    assert abs(np.log(nees / 4.0)) < min(0.6, 0.6 * abs(np.log(frozen / 4.0))), (nees, frozen)
    np.testing.assert_allclose(ours.R, R, rtol=1e-14)


def test_limited_keeps_its_bounds_and_rests_without_a_full_correction(motion):
    inputs, samples, _ = motion
    bound = adaptive("limited", r=20.0 * R, bounds=(0.5, 2.0))
    bound.run(inputs, samples)
    np.testing.assert_allclose(np.diag(bound.R), 10.0 * np.diag(R), rtol=1e-9)
    ours = adaptive("limited", warm_up=50, gate=0.9999)
    ours.run(inputs[:50], samples[:50])
    assert ours.noise_updates == 0
    ours.run(inputs[50:100], samples[50:100])
    assert 40 < ours.noise_updates <= 50
    u, y = inputs[100], samples[100]
    gap, outlier = np.array([y[0], NAN, y[2]]), np.array([y[0] + 1.0, y[1], y[2]])
    for sample, expected in ((gap, Status.MISSING), (outlier, Status.GATED)):
        before = ours.R.tobytes()
        assert ours.step(u, sample) == expected
        assert ours.R.tobytes() == before
    ours.hold = True
    ours.run(inputs[101:], samples[101:])
    assert ours.R.tobytes() == before


@pytest.mark.parametrize("adaptation", ["limited", "sage-husa"])
def test_the_arena_is_the_whole_state(adaptation, motion):
    inputs, samples, _ = motion
    ours = adaptive(adaptation, arena=np.zeros(ASRUKF.arena_size(4, 3, adaptation)))
    ours.run(inputs[:500], samples[:500])
    saved = ours.arena.copy()
    expected = ours.run(inputs[500:1000], samples[500:1000])
    other = adaptive(adaptation, r=4 * R)
    other.arena[:] = saved
    statuses = [other.step(u, y) for u, y in zip(inputs[500:1000], samples[500:1000], strict=True)]
    assert statuses == list(expected.status) and other.arena.tobytes() == ours.arena.tobytes()
    other.reset()
    np.testing.assert_allclose(other.R, R, rtol=1e-14)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"adaptation": "none"}, "adaptation = 'none': must be one of likelihood, limited, sage-husa, off"),
        ({"r": None}, "R = None: adaptation 'limited' needs a start, only 'likelihood' finds one"),
        ({"adaptation": "sage-husa", "q": None}, "Q = None: adaptation 'sage-husa' needs a start"),
        ({"adapt": "QR"}, "adapt = 'QR': must be 'R' or 'Q'"), ({"structure": "band"}, "structure = 'band'"),
        ({"warm_up": -1}, "warm_up = -1"), ({"warm_up": 1.5}, "warm_up = 1.5"), ({"bounds": (2.0, 3.0)}, "bounds = "),
        ({"bounds": 3.0}, "bounds = 3.0: must be two ratios"), ({"bounds": (0.1, NAN)}, "bounds = "),
        ({"forgetting": 0.0}, "forgetting = 0.0"), ({"alpha": 1e-3}, "alpha = 0.001"),
    ],
)  # fmt: skip
def test_construction_errors_name_argument_value_and_rule(change, words):
    with pytest.raises(ValueError, match=words):
        adaptive(**{"adaptation": "limited", **change})
