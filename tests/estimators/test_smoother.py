import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, model, srukf
from reference_filters import kalman, linear_f, linear_h, random_linear

from servohil.estimators import SRUKF, Model, smoother
from servohil.estimators.consistency import consistency, nees
from servohil.estimators.smoother import rts_smooth

NAN = float("nan")


def linear(a, b, c):
    return Model(linear_f, linear_h, 5, 3, np.concatenate([a.ravel(), b, c.ravel()]), 1.0, "discrete")


def record(steps, seed):
    rng = np.random.default_rng(seed)
    inputs, samples = rng.normal(size=(steps, 1)), 3 * rng.normal(size=(steps, 3))
    samples[rng.random((steps, 3)) < 0.2] = NAN
    samples[4] = NAN
    return inputs, samples


def rts(a, b, c, q, r, p0, inputs, samples):
    """Rauch, Tung and Striebel 1965, as printed in every book; q by steps."""
    x, p, filtered, predicted = np.zeros(len(a)), p0, [], []
    for u, y, noise in zip(inputs, samples, q, strict=True):
        predicted.append((a @ x + b * u[0], a @ p @ a.T + noise))
        x, p, _, _ = kalman(a, b, c, noise, r, x, p, u, y)
        filtered.append((x, p))
    smoothed = [filtered[-1]]
    for k in range(len(inputs) - 2, -1, -1):
        (x, p), (x_next, p_next) = filtered[k], predicted[k + 1]
        gain = np.linalg.solve(p_next, a @ p).T
        smoothed.append((x + gain @ (smoothed[-1][0] - x_next), p + gain @ (smoothed[-1][1] - p_next) @ gain.T))
    return [np.array(column) for column in zip(*smoothed[::-1], strict=True)]


def given_all_samples(a, b, c, q, r, p0, inputs, samples):
    """Batch least squares: the states x1 .. xN as one Gaussian vector, conditioned on all samples at once."""
    n, count = len(a), len(inputs)
    mean, blocks = np.zeros(n), []
    # each state is a linear function of x0 and of the noises w1 .. wk
    maps = np.zeros((count, n, (count + 1) * n))
    last = np.eye(n, (count + 1) * n)
    for k in range(count):
        last = a @ last
        last[:, (k + 1) * n : (k + 2) * n] += np.eye(n)
        mean = a @ mean + b * inputs[k, 0]
        maps[k] = last
        blocks.append(mean)
    prior = np.zeros(((count + 1) * n,) * 2)
    prior[:n, :n] = p0
    for k in range(count):
        prior[(k + 1) * n : (k + 2) * n, (k + 1) * n : (k + 2) * n] = q
    state = maps.reshape(count * n, -1)
    mean, covariance = np.concatenate(blocks), state @ prior @ state.T
    seen = ~np.isnan(samples.ravel())
    see = np.kron(np.eye(count), c)[seen]
    noise = np.kron(np.eye(count), r)[np.ix_(seen, seen)]
    gain = np.linalg.solve(see @ covariance @ see.T + noise, see @ covariance).T
    mean = mean + gain @ (samples.ravel()[seen] - see @ mean)
    covariance = covariance - gain @ see @ covariance
    return mean.reshape(count, n), np.array([covariance[i : i + n, i : i + n] for i in range(0, count * n, n)])


@pytest.mark.parametrize("scaling", [(1.0, 2.0, 0.0), (0.7, 2.0, 1.0)])
def test_equals_the_textbook_smoother_on_a_linear_system(scaling):
    a, b, c, q, r, p0 = random_linear(5, 3, 5)
    inputs, samples = record(300, 1)
    smoothed = rts_smooth(SRUKF(linear(a, b, c), np.zeros(5), p0, q, r, *scaling), inputs, samples, *scaling)
    x, p = rts(a, b, c, [q] * 300, r, p0, inputs, samples)
    np.testing.assert_allclose(smoothed.x, x, atol=1e-9)
    np.testing.assert_allclose(smoothed.P, p, atol=1e-9)


def test_equals_batch_least_squares():
    a, b, c, q, r, p0 = random_linear(5, 3, 5)
    inputs, samples = record(12, 2)
    smoothed = rts_smooth(SRUKF(linear(a, b, c), np.zeros(5), p0, q, r), inputs, samples)
    x, p = given_all_samples(a, b, c, q, r, p0, inputs, samples)
    np.testing.assert_allclose(smoothed.x, x, atol=1e-9)
    np.testing.assert_allclose(smoothed.P, p, atol=1e-9)


def test_each_step_is_smoothed_with_the_q_that_it_had(monkeypatch):
    """A filter whose Q grows by a tenth in each of its steps, as an adaptive one's may."""
    a, b, c, q, r, p0 = random_linear(5, 3, 5)
    inputs, samples = record(40, 6)
    ukf = SRUKF(linear(a, b, c), np.zeros(5), p0, q, r)

    def grows(*arguments):
        status = ukf._step(*arguments)
        ukf._q[:] *= np.sqrt(1.1)
        return status

    monkeypatch.setattr(smoother, "_compiled_collect", lambda: lambda step, *rest: smoother._collect(grows, *rest))
    smoothed = rts_smooth(ukf, inputs, samples)
    x, p = rts(a, b, c, q * 1.1 ** np.arange(40)[:, None, None], r, p0, inputs, samples)
    np.testing.assert_allclose(smoothed.x, x, atol=1e-9)
    np.testing.assert_allclose(smoothed.P, p, atol=1e-9)


def test_a_singular_prediction_has_the_gain_of_the_pseudo_inverse():
    """A shift register: three states are the same number, one is known exactly, and Q has rank 1."""
    a = np.array([[0.9, 0, 0, 0, 0.3], [1, 0, 0, 0, 0], [1, 0, 0, 0, 0], [2, 0, 0, 0, 0], [0, 0, 0, 0, 0]], dtype=float)
    b, c = np.array([1.0, 0, 0, 0, 0]), np.array([[0, 1.0, 0, 0, 0], [0, 0, 1.0, 0, 0], [0, 0, 0, 0.5, 0]])
    q, r, p0 = np.diag([0.3, 0, 0, 0, 0]), np.diag([1.0, 2.0, 3.0]), np.eye(5)
    inputs, samples = record(12, 3)
    smoothed = rts_smooth(SRUKF(linear(a, b, c), np.zeros(5), p0, q, r), inputs, samples)
    x, p = given_all_samples(a, b, c, q, r, p0, inputs, samples)
    np.testing.assert_allclose(smoothed.x, x, atol=1e-7)
    np.testing.assert_allclose(smoothed.P, p, atol=1e-7)
    np.testing.assert_array_equal(smoothed.P, smoothed.P.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(smoothed.P).min() > -1e-15


def test_on_the_cylinder_the_error_is_smaller_and_has_the_size_that_is_claimed():
    """NEES of the smoothed states at four times, 100 runs, inside a family-wise 99.9 % interval."""
    runs, steps, times = 100, 120, [0, 20, 60, 110]
    rng = np.random.default_rng(4)
    plant, ukf = model(), srukf()
    inputs = np.column_stack([3 * np.cos(0.04 * np.arange(steps)), np.full(steps, 14e6), np.full(steps, 0.9e6)])
    values, errors = np.zeros((runs, len(times))), np.zeros((2, steps, 4))
    for run in range(runs):
        x = X0 + np.sqrt(np.diag(P0)) * rng.normal(size=4)
        states, samples = np.empty((steps, 4)), np.empty((steps, 3))
        for k in range(steps):
            x = plant.advance(x, inputs[k]) + PROCESS_STD * rng.normal(size=4)
            states[k] = x
            samples[k] = x[[0, 2, 3]] + MEASUREMENT_STD * rng.normal(size=3)
        smoothed, filtered = rts_smooth(ukf, inputs, samples), ukf.run(inputs, samples)
        ukf.reset()
        values[run] = nees(states[times], smoothed.x[times], smoothed.P[times])
        errors += np.square([states - filtered.x, states - smoothed.x])
        claimed = np.diagonal(smoothed.P, axis1=1, axis2=2) / np.diagonal(filtered.P, axis1=1, axis2=2)
        assert claimed.max() < 1 + 1e-6 and claimed[:-20].max() < 0.95
    assert consistency(values, 4).consistent, values.mean(axis=0)
    rms = np.sqrt(errors.mean(axis=1))
    assert (rms[1] < [0.8, 0.6, 0.8, 0.8] * rms[0]).all(), rms[1] / rms[0]


def test_steps_that_the_filter_left_out_have_the_estimate_before_and_the_filter_stays_as_it_was():
    inputs, samples, _ = healthy_motion(60)
    ukf, kept = srukf(), np.delete(np.arange(60), [20, 21, 40])
    ukf.run(inputs[:10], samples[:10])
    before = ukf.arena.tobytes()
    expected = rts_smooth(ukf, inputs[kept], samples[kept])
    inputs[20, 0], samples[21, 1], inputs[40, 0] = NAN, np.inf, 1e300
    smoothed = rts_smooth(ukf, inputs, samples)
    np.testing.assert_array_equal(smoothed.x[kept], expected.x)
    np.testing.assert_array_equal(smoothed.P[kept], expected.P)
    np.testing.assert_array_equal(smoothed.x[[20, 21, 40]], smoothed.x[[19, 19, 39]])
    assert ukf.arena.tobytes() == before


def test_a_model_that_raises_in_the_filter_is_left_to_its_step(monkeypatch):
    inputs, samples, _ = healthy_motion(30)
    ukf = srukf()
    expected = rts_smooth(ukf, inputs, samples)
    collect, before = smoother._compiled_collect(), ukf.arena.tobytes()

    def raises_half_way(step, arena, work, p, u, y, *kept):
        collect(step, arena, work, p, u[:15], y[:15], *kept)
        raise ValueError

    monkeypatch.setattr(smoother, "_compiled_collect", lambda: raises_half_way)
    again = rts_smooth(ukf, inputs, samples)
    assert again.x.tobytes() == expected.x.tobytes() and again.P.tobytes() == expected.P.tobytes()
    assert ukf.arena.tobytes() == before


def test_wrong_shapes_are_refused():
    inputs, samples, _ = healthy_motion(10)
    for u, y in ((inputs[:9], samples), (inputs, samples[:, :2]), (inputs.ravel(), samples)):
        with pytest.raises(ValueError, match=r"must be \(N, 3\), \(N, 3\)"):
            rts_smooth(srukf(), u, y)
    with pytest.raises(ValueError, match=r"alpha = 0.01"):
        rts_smooth(srukf(), inputs, samples, alpha=0.01)
    assert rts_smooth(srukf(), np.zeros((0, 3)), np.zeros((0, 3))).x.shape == (0, 4)
