import numpy as np
import pytest
from linear_bench import as_model
from reference_filters import kalman
from second_order_bench import four_states, linear_motion, two_states

from servohil.estimators.health import Status
from servohil.estimators.optimal_second_order import OptimalSecondOrderFilter

NAN = float("nan")


def optimal(system, **options):
    a, b, c, q, r, x, p = system
    return OptimalSecondOrderFilter(as_model(a, b, c), x, p, q, r, **options)


def mixed():
    """`four_states` seen through four outputs would be square; two suffice for the gain, and for Lambda (2, 2)."""
    return four_states()


def test_is_the_kalman_filter():
    system = mixed()
    a, b, c, q, r, x, p = system
    inputs, outputs, _ = linear_motion(system, 1000, 3, missing=0.1)
    filter_ = optimal(system)
    for u, y in zip(inputs, outputs, strict=True):
        x, p, s, loglik = kalman(a, b, c, q, r, x, p, u, y)
        assert filter_.step(u, y) == (Status.MISSING if np.isnan(y).any() else Status.OK)
        np.testing.assert_allclose(filter_.x, x, atol=1e-10)
        np.testing.assert_allclose(filter_.P, p, atol=1e-10)
        np.testing.assert_allclose(filter_.S, s, atol=1e-10)
        assert filter_.loglik == pytest.approx(loglik, abs=1e-9)


def test_reported_cutoff_turns_the_second_order_gain_into_the_kalman_gain():
    """P2 eq. 55 with the reported Lambda: the gain whose K e corrects the outputs as the Kalman filter does."""
    system = mixed()
    a, b, c, q, r, x, p = system
    gamma = np.array([0.3, 0.6])
    inputs, outputs, _ = linear_motion(system, 60, 5)
    filter_ = optimal(system, convergence=[*gamma, 0.1, 0.1])
    last = earlier = np.full(2, NAN)
    checked = 0
    for u, y in zip(inputs, outputs, strict=True):
        prior = a @ p @ a.T + q
        wanted = c @ prior @ c.T @ np.linalg.inv(c @ prior @ c.T + r)
        e = y - c @ (a @ x + b * u[0])
        x, p, _, _ = kalman(a, b, c, q, r, x, p, u, y)
        filter_.step(u, y)
        cutoff = filter_.cutoff
        if not np.isnan(earlier).any():
            bracket = np.diag(e) - np.diag(gamma * last)
            bracket -= cutoff * (last[None, :] - gamma[:, None] * earlier[None, :])
            np.testing.assert_allclose(bracket / e[None, :], wanted, atol=1e-8)
            checked += 1
        else:
            assert np.isnan(cutoff).all()
        earlier, last = last, y - c @ x
    assert checked == 58


def test_cutoff_is_undefined_where_its_divisor_vanishes_and_the_estimate_is_not():
    system = mixed()
    a, c = system[0], system[2]
    filter_ = optimal(system)
    u = np.zeros(1)
    for _ in range(4):  # perfect predictions: innovations and errors are zero
        assert filter_.step(u, c @ a @ filter_.x) == Status.OK
    with np.errstate(all="raise"):
        assert np.isnan(filter_.cutoff).all()
    filter_.step(u, np.array([1.0, NAN]))
    filter_.step(u, np.array([1.0, 2.0]))
    filter_.step(u, np.array([1.5, 2.0]))
    cutoff = filter_.cutoff
    np.testing.assert_array_equal(np.isnan(cutoff), [[False, True], [False, True]])  # output 1 was missing at k - 1
    assert np.isfinite(filter_.x).all()


def test_a_copied_arena_and_reset_restore_the_memory():
    system = mixed()
    inputs, outputs, _ = linear_motion(system, 60, 5, missing=0.1)
    filter_, other = optimal(system), optimal(system, arena=np.zeros(OptimalSecondOrderFilter.arena_size(4, 2)))
    filter_.run(inputs[:30], outputs[:30])
    other.arena[:] = filter_.arena
    rest = filter_.run(inputs[30:], outputs[30:])
    for u, y in zip(inputs[30:], outputs[30:], strict=True):
        other.step(u, y)
    assert other.arena.tobytes() == filter_.arena.tobytes()
    np.testing.assert_array_equal(rest.x[-1], other.x)
    np.testing.assert_array_equal(other.cutoff, filter_.cutoff)
    filter_.reset()
    assert np.isnan(filter_.cutoff).all()


def test_survives_what_is_no_number():
    system = mixed()
    inputs, outputs, _ = linear_motion(system, 3000, 9, missing=0.2)
    rng = np.random.default_rng(1)
    clean = outputs.copy()
    for value, share in ((np.inf, 0.01), (1e300, 0.02), (1e15, 0.01)):
        outputs[:2900][rng.random((2900, 2)) < share] = value
    inputs[:2900][rng.random((2900, 1)) < 0.02] = 1e300
    inputs[:2900][rng.random((2900, 1)) < 0.02] = NAN
    filter_ = optimal(system, gate=0.99999)
    trajectory = filter_.run(inputs, outputs)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all()
    assert np.linalg.eigvalsh(trajectory.P).min() > 0
    reference = optimal(system).run(inputs[2900:], clean[2900:])
    assert np.abs(trajectory.x[-20:] - reference.x[-20:]).max() < 0.05
    health = filter_.health
    assert min(health.gated, health.repaired, health.diverged, health.not_finite_input, health.missing) > 0


@pytest.mark.parametrize(
    ("change", "words"), [({"convergence": 0.0}, "convergence = 0.0"), ({"gate": 2.0}, "gate = 2.0")]
)
def test_construction_errors_name_argument_value_and_rule(change, words):
    with pytest.raises(ValueError, match=words):
        optimal(two_states(), **change)
