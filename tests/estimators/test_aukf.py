"""The adaptive filter of the papers against plain numpy, with the paper's own weights; its state and its limits."""

import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, model
from numba.core.runtime import _nrt_python, rtsys
from reference_filters import adaptive_unscented

from servohil.estimators.aukf import AUKF
from servohil.estimators.health import Status
from servohil.estimators.models import cylinder
from servohil.estimators.noise.sage_husa import fading_gain
from servohil.estimators.ukf import UKF

NAN = float("nan")
Q, R = np.diag(PROCESS_STD**2), np.diag(MEASUREMENT_STD**2)
PARAMETERS = cylinder.CylinderParameters().vector()


def adaptive(q=Q, r=R, **options):
    return AUKF(model(), X0, P0, q, r, **options)


def compare_with_print(ours, steps, alpha, means, tolerance):
    """Step by step against the printed algorithm; how often eq. 19 stood in for Q and for R."""
    inputs, samples, _ = healthy_motion(steps)
    x, p, q, r = X0, P0, ours.Q, ours.R
    mean_q, mean_r = np.zeros(4), np.zeros(3)
    used = np.zeros(2)
    for k, (u, y) in enumerate(zip(inputs, samples, strict=True)):
        gain = fading_gain(k + 1.0, 0.98)
        x, p, q, r, mean_q, mean_r, fallbacks = adaptive_unscented(
            cylinder.f, cylinder.h, PARAMETERS, 1e-3, q, r, mean_q, mean_r, x, p, u, y, gain, means, alpha
        )
        used += fallbacks
        assert ours.step(u, y) == Status.OK
        for name, mine, theirs in (("P", ours.P, p), ("Q", ours.Q, q), ("R", ours.R, r)):
            scale = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
            assert (np.abs(mine - theirs) < tolerance * scale).all(), (k, name)
        np.testing.assert_allclose(ours.x, x, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(ours.noise_means[0], mean_q, rtol=tolerance, atol=tolerance)
        np.testing.assert_allclose(ours.noise_means[1], mean_r, rtol=tolerance, atol=tolerance)
        assert ours.noise_fallbacks == tuple(used)
    assert ours.noise_updates == steps
    return used


@pytest.mark.parametrize(("alpha", "means"), [(1.0, False), (0.1, True)])
def test_equals_algorithm_2_of_p3(alpha, means):
    ours = adaptive(alpha=alpha, means=means, forgetting=0.98)
    used = compare_with_print(ours, 300, alpha, means, 1e-7)
    assert used.min() > 0 and used.max() < 300  # both the formula and eq. 19


def test_off_is_the_ukf_bit_for_bit():
    inputs, samples, _ = healthy_motion(200)
    samples[50:60, 1] = NAN
    off, ukf = adaptive(adaptation="off"), UKF(model(), X0, P0, Q, R)
    ours, reference = off.run(inputs, samples), ukf.run(inputs, samples)
    assert ours.x.tobytes() == reference.x.tobytes() and ours.P.tobytes() == reference.P.tobytes()
    np.testing.assert_array_equal(off.Q, ukf.Q)


def test_the_estimate_rests_while_held_or_without_a_full_correction():
    inputs, samples, _ = healthy_motion(100)
    ours = adaptive(gate=0.999)
    ours.run(inputs[:-1], samples[:-1])
    u, y = inputs[-1], samples[-1]
    outlier, gap, infinite = y + np.array([1.0, 0.0, 0.0]), np.array([y[0], NAN, y[2]]), np.array([y[0], np.inf, y[2]])
    for sample, expected in ((gap, Status.MISSING), (outlier, Status.GATED), (infinite, Status.NOT_FINITE_INPUT)):
        before, updates = (ours.Q.tobytes(), ours.R.tobytes()), ours.noise_updates
        assert ours.step(u, sample) == expected
        assert (ours.Q.tobytes(), ours.R.tobytes()) == before and ours.noise_updates == updates
    held = adaptive()
    held.hold = True
    held.run(inputs, samples)
    np.testing.assert_allclose(held.Q, Q, rtol=1e-14)
    assert held.hold and held.noise_updates == 0
    held.reset()
    assert held.hold
    held.hold = False
    held.run(inputs, samples)
    assert held.noise_updates == 100


def test_the_arena_is_the_whole_state_and_reset_returns_to_the_given_noise():
    inputs, samples, _ = healthy_motion(300)
    ours = adaptive(means=True, arena=np.zeros(AUKF.arena_size(4, 3)))
    ours.run(inputs[:100], samples[:100])
    saved = ours.arena.copy()
    expected = ours.run(inputs[100:], samples[100:])
    other = adaptive(means=True, r=4 * R)
    other.arena[:] = saved
    again = other.run(inputs[100:], samples[100:])
    assert again.x.tobytes() == expected.x.tobytes() and other.arena.tobytes() == ours.arena.tobytes()
    other.reset()  # to what the arena remembers, not to its own
    np.testing.assert_allclose(other.R, R, rtol=1e-14)
    assert other.noise_updates == 0 and (np.concatenate(other.noise_means) == 0).all()
    np.testing.assert_array_equal(other.x, X0)
    other.Q, other.R = 3 * Q, 2 * R
    other.run(inputs, samples)
    assert np.abs(np.diag(other.R) / np.diag(R) - 2.0).max() > 0.1
    other.reset()
    np.testing.assert_allclose(other.Q, 3 * Q, rtol=1e-14)
    np.testing.assert_allclose(other.R, 2 * R, rtol=1e-14)
    with pytest.raises(ValueError, match=r"R = .*semidefinite"):
        other.R = np.diag([1.0, 1.0, -1.0])


def test_run_equals_the_step_loop_without_allocating():
    inputs, samples, _ = healthy_motion(2000)
    ours = adaptive(gate=0.9999)
    statuses = [ours.step(u, y) for u, y in zip(inputs, samples, strict=True)]
    arena = ours.arena.tobytes()
    ours.reset()
    _nrt_python.memsys_enable_stats()
    assert list(ours.run(inputs, samples).status) == statuses
    assert ours.arena.tobytes() == arena

    def allocations(steps):
        before = rtsys.get_allocation_stats().mi_alloc
        ours.run(inputs[:steps], samples[:steps])
        return rtsys.get_allocation_stats().mi_alloc - before

    assert allocations(1000) == allocations(2000)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"adaptation": "likelihood"}, "adaptation = 'likelihood': must be one of sage-husa, off"),
        ({"forgetting": 1.0}, "forgetting = 1.0: must lie between 0 and 1"), ({"forgetting": NAN}, "forgetting = nan"),
        ({"forgetting": "0.9"}, "forgetting = '0.9'"), ({"q": None}, "Q and chol_Q: neither given"),
    ],
)  # fmt: skip
def test_construction_errors_name_argument_value_and_rule(change, words):
    with pytest.raises(ValueError, match=words):
        adaptive(**change)
