"""Sensitivities of the whole filter against differences of independent filters, parameters found, faults survived."""

import numpy as np
import one_link_arm as arm
import pytest
from hydraulic_bench import DT, HEALTHY, MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, srukf

from servohil.estimators import SRUKF, Model
from servohil.estimators.models import cylinder
from servohil.estimators.sensitivity_srukf import SensitivitySRUKF

pytestmark = pytest.mark.nightly

NAN = float("nan")
ARM_X0, ARM_P0 = np.array([1.5, 0.0]), np.diag([0.01, 0.04])
START = arm.TRUE * [1.3, 0.8, 1.2, 0.9, 1.0, 1.0]
CYLINDER_Q, CYLINDER_R = np.diag(PROCESS_STD**2), np.diag(MEASUREMENT_STD**2)


def arm_filter(p=START, **changes):
    options = {"parameters": (0, 1, 2, 3), "Q_entries": (1,), "R_entries": (1,), "Q": arm.Q, "R": arm.R}
    options |= {"P0_parameters": np.concatenate([0.5 * START[:4], [1.0, 1.0]]), "x0": ARM_X0, "P0": ARM_P0}
    return SensitivitySRUKF(arm.model(p), **{**options, **changes})


def cylinder_filter(p=None, q=CYLINDER_Q, r=CYLINDER_R, **changes):
    model = Model(cylinder.f, cylinder.h, 4, 3, HEALTHY.vector() if p is None else p, DT, n_u=3)
    options = {"parameters": (cylinder.BULK, cylinder.FRICTION), "Q_entries": (2,), "R_entries": (1,)}
    options |= {"P0_parameters": [7e7, 40.0, 1.0, 1.0]}
    return SensitivitySRUKF(model, X0, P0, q, r, **{**options, **changes})


def arm_motion(steps):
    return arm.experiment(steps, steps, steps, arm.TRUE, arm.TRUE, 3)


def covariance_form(p, q, r, inputs, samples, limit, scale, weights):
    """The filter in plain numpy, covariance form: x, P, y, K, log-likelihood of every step, as rows."""
    x, cov, rows = ARM_X0.copy(), ARM_P0.copy(), []
    wm, wc = weights

    def points():
        root = np.linalg.cholesky(scale * cov).T
        return np.vstack([x, x + root, x - root])

    def each(function, drawn, u):
        out = np.zeros_like(drawn)
        for point, filled in zip(drawn, out, strict=True):
            function(point, u, p, filled)
        return out

    for u, y in zip(inputs, samples, strict=True):
        drawn = points()
        moved = drawn + arm.DT * each(arm.f, drawn, u)
        x = wm @ moved
        cov = (moved - x).T @ (wc[:, None] * (moved - x)) + q
        drawn = points()
        seen = each(arm.h, drawn, u)
        predicted = wm @ seen
        keep = ~np.isnan(y)
        gain, loglik = np.zeros((2, 2)), 0.0
        if keep.any():
            s = ((seen - predicted).T @ (wc[:, None] * (seen - predicted)) + r)[np.ix_(keep, keep)]
            k = np.linalg.solve(s, (seen - predicted)[:, keep].T @ (wc[:, None] * (drawn - x))).T
            e = (y - predicted)[keep]
            nis = e @ np.linalg.solve(s, e)
            loglik = -0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * s)[1])
            if nis < limit:
                gain[:, keep] = k
                x, cov = x + k @ e, cov - k @ s @ k.T
            else:
                loglik = NAN
        rows.append(np.concatenate([x, cov.ravel(), predicted, gain.ravel(), [loglik]]))
    return np.array(rows)


def sensitivities(ukf, inputs, samples):
    """(N, fields, k) in the order of `covariance_form`, and the fields themselves (N, fields)."""
    found, fields = [], []
    k = len(ukf.parameters)
    for u, y in zip(inputs, samples, strict=True):
        ukf.step(u, y)
        parts = [
            ukf.sensitivity_x, ukf.sensitivity_P.reshape(k, -1).T, ukf.sensitivity_y,
            ukf.sensitivity_gain.reshape(k, -1).T, ukf.sensitivity_loglik[None],
        ]  # fmt: skip
        found.append(np.concatenate(parts))
        fields.append(np.concatenate([ukf.x, ukf.P.ravel(), ukf.gain.ravel(), [ukf.loglik]]))
    return np.array(found), np.array(fields)


def difference(function, steps):
    """Fourth-order central differences of function(j, t), one step per j; (..., k)."""
    return np.stack(
        [
            (8.0 * (function(j, t) - function(j, -t)) - (function(j, 2 * t) - function(j, -2 * t))) / (12.0 * t)
            for j, t in enumerate(steps)
        ],
        axis=-1,
    )


def worst(found, expected):
    """Largest deviation over time of every field and parameter, in parts of the largest value over time."""
    gap = np.nanmax(np.abs(found - expected), axis=0)
    return gap / np.maximum(np.nanmax(np.abs(expected), axis=0), 1e-300)


@pytest.mark.parametrize("transform", ["scaled", "paper"])
def test_sensitivities_equal_differences_of_a_filter_in_plain_numpy(transform):
    # P4's alpha is no good for the scaled transform in array form, but for its own
    alpha, beta, kappa = (0.9, 2.0, 0.5) if transform == "scaled" else (0.08, 2.0, 1.0)
    scale = alpha**2 * (2 + kappa) + (2.0 if transform == "paper" else 0.0)
    outer = 0.5 / scale
    wm = np.array([1.0 - 4 * outer, *[outer] * 4])
    weights = wm, wm + np.array([1.0 - alpha**2 + beta, 0, 0, 0, 0])
    count = 300 if transform == "scaled" else 40
    inputs, samples, _ = arm_motion(count)
    samples[10:14, 1] = NAN
    samples[17:20, 0] = NAN
    samples[25:27] = NAN
    samples[30] += [0.5, 0.0]  # behind the gate
    gate = 1.0 - 1e-9
    limit = -2.0 * np.log(1e-9)  # chi-square quantile for two degrees of freedom
    q, r = np.array([[1e-9, 2e-8], [2e-8, 5e-5]]), np.array([[5e-7, 3e-4], [3e-4, 5.0]])
    ukf = arm_filter(Q=q, R=r, gate=gate, alpha=alpha, beta=beta, kappa=kappa, transform=transform)
    ukf.adapting = False
    start = ukf.parameters
    np.testing.assert_allclose(start, [*START[:4], np.log(5e-5), np.log(5.0)])

    def shifted(j, t):
        p, f = START.copy(), [np.eye(2), np.eye(2)]
        if j < 4:
            p[j] += t
        else:
            f[j - 4][1, 1] = np.exp(0.5 * t)  # correlations stay
        return covariance_form(p, f[0] @ q @ f[0], f[1] @ r @ f[1], inputs, samples, limit, scale, weights)

    found, fields = sensitivities(ukf, inputs, samples)
    nominal = shifted(0, 0.0)
    np.testing.assert_allclose(fields[:, :6], nominal[:, :6], rtol=1e-8, atol=1e-11)
    np.testing.assert_allclose(fields[:, 6:10], nominal[:, 8:12], rtol=1e-7, atol=1e-9)
    assert ukf.health.gated == np.isnan(nominal[:, 12]).sum() == 1 and ukf.health.missing == 9
    np.testing.assert_allclose(fields[~np.isnan(nominal[:, 12]), 10], nominal[~np.isnan(nominal[:, 12]), 12], rtol=1e-8)
    steps = np.concatenate([2e-3 * START[:4], [1e-2, 1e-2]])
    if transform == "paper":
        steps = steps[:2]
    expected = difference(shifted, steps)
    found = found[:, :, : len(steps)]
    found[30, 12], expected[30, 12] = 0.0, 0.0  # no correction, no likelihood of it
    assert (found[25:27, 8:] == 0.0).all()  # nothing measured: no gain
    error = worst(found, expected)
    assert (error < 1e-6).all(), error.max(axis=1)
    np.testing.assert_array_equal(ukf.parameters, start)


def test_sensitivities_on_the_cylinder_equal_differences_of_the_filter():
    inputs, samples, _ = healthy_motion(200)
    samples[50:60, 1] = NAN
    samples[100] = NAN
    ukf = cylinder_filter()
    ukf.adapting = False
    found, fields = sensitivities(ukf, inputs, samples)
    plain = srukf()
    plain.run(inputs, samples)
    assert plain.x.tobytes() == ukf.x.tobytes() and plain.P.tobytes() == ukf.P.tobytes()

    def shifted(j, t):
        p, q, r = HEALTHY.vector(), CYLINDER_Q.copy(), CYLINDER_R.copy()
        if j < 2:
            p[(cylinder.BULK, cylinder.FRICTION)[j]] += t
        else:
            (q, r)[j - 2][j - (0, 0, 0, 2)[j], j - (0, 0, 0, 2)[j]] *= np.exp(t)
        other = SRUKF(Model(cylinder.f, cylinder.h, 4, 3, p, DT, n_u=3), X0, P0, q, r)
        like = cylinder_filter(p, q, r)
        like.adapting = False
        rows = []
        for u, y in zip(inputs, samples, strict=True):
            other.step(u, y)
            like.step(u, y)
            predicted = y - other.innovation
            rows.append(np.concatenate([other.x, other.P.ravel(), predicted, like.gain.ravel(), [other.loglik]]))
        return np.array(rows)

    expected = difference(shifted, [3e-3 * 7e8, 0.2 * 418.0, 1e-2, 1e-2])
    found[np.isnan(expected)] = NAN
    error = worst(found, expected)
    assert (error < 1e-6).all(), error.max(axis=1)
    # the gain of the undisturbed filter: P+ = (I - K H) P- with H picking x, pA, pB, so K R = P+ H'
    np.testing.assert_allclose(fields[-1, 20:32].reshape(4, 3) @ CYLINDER_R, ukf.P[:, [0, 2, 3]], rtol=1e-6, atol=1e-15)


def one_link(before, after, steps=40_000, hold=(10_000, 25_000)):
    return arm.experiment(steps, *hold, before, after, 0)


def p4(**changes):
    """P4's experiment: starts wrong by factors, with one process variance and R of the accelerometer wrong as well."""
    start = arm.TRUE * [1.5, 3.0, 8.0, 0.25, 1.0, 1.0]
    options = {"Q": np.diag([2e-8, 5e-5]), "R": np.diag([5e-7, 20.0]), "Q_entries": (0,), "forgetting": 0.9995}
    options |= {"x0": [np.pi / 2, 0.0], "P0": 0.01 * np.eye(2)}
    options |= {"P0_parameters": np.concatenate([start[:4], [2.0, 1.0]])}
    options |= {"lower": [1.0, 0.0, 0.0, 0.0, -40.0, -5.0], "upper": [100.0, 5.0, 5.0, 5.0, 0.0, 10.0]}
    return arm_filter(start, **{**options, **changes})


def test_one_link_robot_holds_still_and_changes_its_parameters():
    """P4 section 4.1: the arm is held, friction and mass are four times as large from then on, and it moves again."""
    after = arm.TRUE * [1.0, 4.0, 4.0, 4.0, 1.0, 1.0]
    inputs, samples, _ = one_link(arm.TRUE, after)
    ukf = p4()
    ukf.run(inputs[:10_000], samples[:10_000])
    np.testing.assert_allclose(ukf.parameters[:4], arm.TRUE[:4], rtol=0.1)
    ukf.run(inputs[10_000:], samples[10_000:])
    np.testing.assert_allclose(ukf.parameters[:4], after[:4], rtol=0.05)
    np.testing.assert_allclose(ukf.R[1, 1], 5.0, rtol=0.15)
    assert (np.abs(ukf.parameters[:4] - after[:4]) < 5.0 * ukf.parameter_std[:4]).all()
    assert ukf.health.diverged == ukf.health.repaired == 0


def test_what_is_not_excited_does_not_drift():
    inputs, samples, _ = one_link(arm.TRUE, arm.TRUE)
    gated, free = p4(), p4(threshold=0.0, least_excitation=0.0)
    for ukf in (gated, free):
        ukf.run(inputs[:12_000], samples[:12_000])
    before, loose = gated.parameters, free.parameters
    std = gated.parameter_std
    np.testing.assert_array_equal(gated.held[:4], [True, True, True, False])  # gravity still tells of the mass
    np.testing.assert_array_equal(free.held, False)
    for ukf in (gated, free):
        ukf.run(inputs[12_000:25_000], samples[12_000:25_000])
    np.testing.assert_array_equal(gated.parameters[:3], before[:3])
    np.testing.assert_array_equal(gated.parameter_std[:3], std[:3])
    np.testing.assert_allclose(gated.parameters[3], arm.TRUE[3], rtol=0.05)
    drift = np.abs(free.parameters[1:3] / loose[1:3] - 1.0)
    assert (drift > 0.3).all(), drift
    np.testing.assert_allclose(gated.parameters[:3], arm.TRUE[:3], rtol=0.15)


def test_prediction_error_form_of_the_paper_finds_the_parameters():
    inputs, samples, _ = one_link(arm.TRUE, arm.TRUE, 15_000, (15_000, 15_000))
    ukf = p4(
        criterion="prediction-error", R=arm.R, R_entries=(), lower=None, upper=None,
        P0_parameters=[27.0, 0.15, 2.0, 0.03, 1.0],
    )  # fmt: skip
    ukf.run(inputs, samples)
    np.testing.assert_allclose(ukf.parameters[:4], arm.TRUE[:4], rtol=0.1)


def test_likelihood_tells_the_size_of_both_noises():
    inputs, samples, _ = one_link(arm.TRUE, arm.TRUE, 15_000, (15_000, 15_000))
    options = {"parameters": (), "Q": 100.0 * arm.Q, "R": arm.R / 10.0, "P0_parameters": [2.0, 1.0], "R_entries": (0,)}
    ukf = arm_filter(arm.TRUE, **options, forgetting=0.9998)
    ukf.run(inputs, samples)
    np.testing.assert_allclose(np.diag(ukf.Q), [1e-9, 5e-5], rtol=0.3)
    np.testing.assert_allclose(np.diag(ukf.R), [5e-7, 0.5], rtol=0.15)


def arm_data(steps=400):
    inputs, samples, _ = arm_motion(steps)
    samples[50:60, 1] = NAN
    samples[70] = np.inf
    samples[80] = NAN
    samples[90] = [3.0, 0.0]
    return inputs, samples


def moving(**changes):
    return arm_filter(window=20, least_excitation=0.1, gate=0.999999, **changes)


def state(ukf):
    return [
        ukf.x, ukf.P, ukf.Q, ukf.R, ukf.parameters, ukf.parameter_covariance, ukf.held, ukf.excitation,
        ukf.sensitivity_x, ukf.sensitivity_P, ukf.sensitivity_y, ukf.gain, ukf.sensitivity_gain,
        ukf.sensitivity_loglik,
    ]  # fmt: skip


def test_run_equals_the_step_loop_and_the_arena_is_the_whole_state():
    inputs, samples = arm_data()
    ukf, looped = moving(), moving()
    trajectory = ukf.run(inputs, samples)
    status = [looped.step(u, y) for u, y in zip(inputs, samples, strict=True)]
    np.testing.assert_array_equal(trajectory.status, status)
    assert ukf.arena.tobytes() == looped.arena.tobytes()
    assert ukf.health.gated == ukf.health.not_finite_input == 1
    assert (ukf.parameters != moving().parameters).all()
    memory = np.zeros(SensitivitySRUKF.arena_size(2, 2, 6, 4) + 20)
    first, other = moving(arena=memory[10:-10]), moving(Q=4.0 * arm.Q, P0=4.0 * ARM_P0)
    first.run(inputs[:200], samples[:200])
    other.run(inputs[:50], samples[:50])
    other.arena[:] = memory[10:-10]
    other.run(inputs[200:], samples[200:])
    assert other.arena.tobytes() == ukf.arena.tobytes()
    for found, expected in zip(state(other), state(ukf), strict=True):
        np.testing.assert_array_equal(found, expected)
    assert (memory[:10] == 0.0).all() and (memory[-10:] == 0.0).all()


def test_reset_starts_the_estimates_again_and_keeps_the_configuration():
    inputs, samples = arm_data()
    ukf = moving()
    ukf.run(inputs, samples)
    first = ukf.arena.tobytes()
    ukf.adapting = False
    ukf.reset()
    assert not ukf.adapting and ukf.health.steps == 0 and ukf.held.all()
    np.testing.assert_allclose(ukf.Q, arm.Q, rtol=1e-14)
    np.testing.assert_allclose(ukf.R, arm.R, rtol=1e-14)
    np.testing.assert_allclose(ukf.parameters, [*START[:4], np.log(5e-5), np.log(5.0)], rtol=1e-14)
    np.testing.assert_allclose(ukf.parameter_std, [*(0.5 * START[:4]), 1.0, 1.0])
    assert not ukf.sensitivity_x.any() and not ukf.excitation.any()
    ukf.adapting = True
    ukf.Q, ukf.R = np.diag([1e-11, 0.0]), 9.0 * arm.R  # also a variance that was set to zero comes back
    ukf.reset()
    ukf.run(inputs, samples)
    np.testing.assert_allclose(np.frombuffer(first)[:2], ukf.x, rtol=1e-6)
    np.testing.assert_allclose(ukf.R[0, 0], 9.0 * 5e-7)  # not among the estimated entries: configuration


def test_a_variance_set_to_zero_is_left_alone():
    inputs, samples = arm_data()
    ukf = moving()
    ukf.Q = np.diag([1e-11, 0.0])
    ukf.run(inputs, samples)
    assert ukf.Q[1, 1] == 0.0 and ukf.parameters[4] == -np.inf
    assert np.isfinite(ukf.arena[: -1 - len(ukf.innovation)]).any() and np.isfinite(ukf.x).all()


def test_adaptation_off_leaves_the_parameters_and_the_model_its_own():
    inputs, samples = arm_data()
    ukf = moving()
    ukf.adapting = False
    before = ukf.parameters
    ukf.run(inputs, samples)
    np.testing.assert_array_equal(ukf.parameters, before)
    np.testing.assert_array_equal(ukf.model.p, START)
    assert ukf.sensitivity_x.all() and not ukf.held[:4].all()


def test_bounds_hold():
    inputs, samples, _ = arm_motion(3000)
    lower, upper = [0.9, 0.9, 0.9, 0.9], [1.1, 1.1, 1.1, 1.1]
    limits = {
        "lower": np.concatenate([START[:4] * lower, np.log([5e-5, 5.0]) - 0.01]),
        "upper": np.concatenate([START[:4] * upper, np.log([5e-5, 5.0]) + 0.01]),
    }
    ukf, touched = moving(**limits), np.zeros(6, dtype=bool)
    for k in range(0, 3000, 50):
        ukf.run(inputs[k : k + 50], samples[k : k + 50])
        assert (ukf.parameters >= limits["lower"] - 1e-12).all() and (ukf.parameters <= limits["upper"] + 1e-12).all()
        touched |= np.isclose(ukf.parameters, limits["lower"], atol=1e-9, rtol=0)
        touched |= np.isclose(ukf.parameters, limits["upper"], atol=1e-9, rtol=0)
    assert touched.sum() >= 3


def test_bad_input_changes_nothing_but_status_and_counters():
    inputs, samples = arm_data(60)
    ukf = moving()
    ukf.run(inputs, samples)
    before = state(ukf)
    u, y = inputs[-1], samples[0]
    for bad_u, bad_y in ((np.array([NAN]), y), (np.array([np.inf]), y), (u, np.array([-np.inf, 0.0]))):
        assert ukf.step(bad_u, bad_y) == Status.NOT_FINITE_INPUT
    assert ukf.step(np.array([1e300]), y) == Status.DIVERGED
    for found, expected in zip(state(ukf), before, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert ukf.health.not_finite_input == 3 and ukf.health.diverged == 1


def test_survives_gaps_infinities_and_huge_numbers_and_recovers():
    inputs, samples, states = one_link(arm.TRUE, arm.TRUE, 30_000, (30_000, 30_000))
    clean = samples.copy()
    rng = np.random.default_rng(5)
    for value, share in ((NAN, 0.2), (np.inf, 0.01), (-np.inf, 0.01), (1e300, 0.01), (-1e300, 0.005), (1e12, 0.001)):
        samples[rng.random(samples.shape) < share] = value
    for value, share in ((NAN, 0.01), (np.inf, 0.01), (1e300, 0.01)):
        inputs[rng.random(inputs.shape) < share] = value
    good, _, _ = one_link(arm.TRUE, arm.TRUE, 30_000, (30_000, 30_000))
    inputs[20_000:], samples[20_000:] = good[20_000:], clean[20_000:]
    ukf = p4(gate=0.999999)
    trajectory = ukf.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all() and np.isfinite(trajectory.nis).all()
    assert np.linalg.eigvalsh(trajectory.P[::97]).min() > 0.0
    for values in state(ukf):
        assert np.isfinite(values).all()
    assert np.linalg.eigvalsh(ukf.parameter_covariance / np.outer(ukf.parameter_std, ukf.parameter_std)).min() > 0.0
    assert (np.abs(trajectory.x[-5000:] - states[-5000:]).max(axis=0) < [5e-3, 0.5]).all()
    np.testing.assert_allclose(ukf.parameters[:4], arm.TRUE[:4], rtol=0.1)
    health = ukf.health
    assert min(health.missing, health.gated, health.not_finite_input, health.diverged) > 0


def test_without_a_gate_an_outlier_is_survived_too():
    inputs, samples = arm_data()
    samples[90] = [1e12, 0.0]
    samples[95] = [1e300, 0.0]
    ukf = arm_filter(window=20, least_excitation=0.1)
    trajectory = ukf.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and all(np.isfinite(values).all() for values in state(ukf))
    assert trajectory.status[95] & Status.REPAIRED


def test_memory_allocations_do_not_grow_with_the_steps():
    inputs, samples, _ = arm_motion(2000)
    ukf = moving()
    ukf.run(inputs[:10], samples[:10])
    _nrt_python.memsys_enable_stats()

    def allocations(steps):
        before = rtsys.get_allocation_stats().mi_alloc
        ukf.run(inputs[:steps], samples[:steps])
        return rtsys.get_allocation_stats().mi_alloc - before

    assert allocations(1000) == allocations(2000)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"parameters": (6,)}, r"parameters = \(6,\).*index >= 0 and < 6"),
        ({"parameters": (1, 1, 2, 3)}, "every index once"),
        ({"Q_entries": (2,)}, r"Q_entries = \(2,\)"),
        ({"R_entries": (-1,)}, r"R_entries = \(-1,\)"),
        ({"parameters": (), "Q_entries": (), "R_entries": ()}, "nothing to estimate"),
        ({"P0_parameters": np.ones(5)}, r"P0_parameters has shape \(5,\): must be \(6,\)"),
        ({"P0_parameters": np.zeros(6)}, "P0_parameters = .*must be > 0"),
        ({"P0_parameters": -np.eye(6)}, "P0_parameters = .*positive definite"),
        ({"Q": np.diag([1e-11, 0.0])}, r"Q\[1, 1\] = 0"),
        ({"forgetting": 0.0}, "forgetting = 0.0"),
        ({"forgetting": 1.1}, "forgetting = 1.1"),
        ({"criterion": "rpem"}, "criterion = 'rpem': must be one of likelihood, prediction-error"),
        ({"transform": "p4"}, "transform = 'p4': must be one of scaled, paper"),
        ({"transform": "paper", "alpha": NAN}, "alpha = nan"),
        ({"alpha": 0.08}, "alpha = 0.08.*between"),
        ({"threshold": [0.1, 0.2]}, "threshold = .*one number or"),
        ({"threshold": -0.1}, "threshold = -0.1"),
        ({"least_excitation": NAN}, "least_excitation = nan"),
        ({"window": 0}, "window = 0"),
        ({"memory": 0.0}, "memory = 0.0"),
        ({"scale": [1.0, 1.0, 0.0, 1.0]}, "scale = .*must be > 0"),
        ({"lower": np.full(6, 1.0)}, "start .* must lie within"),
        ({"upper": np.full(6, np.inf)}, "must be finite for the logarithm"),
        ({"arena": np.zeros(7)}, r"arena = float64 \(7,\)"),
    ],
)
def test_refusals_name_argument_value_and_rule(changes, words):
    with pytest.raises(ValueError, match=words):
        arm_filter(**changes)
