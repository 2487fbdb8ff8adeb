"""The unscented filters against other libraries and a plain textbook filter, and what the subtracting forms do when
they fail."""

import math

import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, model
from other_libraries import filterpy_step, stonesoup_step
from reference_filters import rk4, unscented

from servohil.estimators import SRUKF, Model
from servohil.estimators.health import Status
from servohil.estimators.models import cylinder
from servohil.estimators.sigma_point.srukf_forms import factor_array, reduce_array
from servohil.estimators.sigma_point.srukf_vdm_step import factor_vdm, reduce_vdm
from servohil.estimators.sigma_point.ukf_step import factor_covariance, reduce_covariance
from servohil.estimators.ukf import UKF

NAN = float("nan")
Q, R = np.diag(PROCESS_STD**2), np.diag(MEASUREMENT_STD**2)
PARAMETERS = cylinder.CylinderParameters().vector()


def hydraulic(form="ukf", alpha=1.0, p0=P0, r=R, **options):
    arguments = (model(), X0, p0, Q, r, alpha)
    return UKF(*arguments, **options) if form == "ukf" else SRUKF(*arguments, variant=form, **options)


def swing(x, u, p, dx):
    """Next state of a pendulum with square drag whose pivot lags behind u."""
    dx[0] = x[0] + 0.1 * x[1]
    dx[1] = x[1] - 0.1 * (p[0] * math.sin(x[0]) + p[1] * x[1] * abs(x[1]) + x[2])
    dx[2] = x[2] + 0.2 * (u[0] - x[2])


def sight(x, u, p, y):
    y[0] = math.atan2(math.sin(x[0]), 2.0 + math.cos(x[0]))
    y[1] = x[1] * x[1] + x[2]


def pendulum(alpha, beta=2.0, kappa=0.0, spread=0.1):
    root = np.random.default_rng(1).normal(size=(3, 3))
    return UKF(
        Model(swing, sight, 3, 2, [1.2, 0.3], 0.1, "discrete"), np.array([0.5, 0.0, 0.1]),
        spread * (root @ root.T + np.eye(3)), 1e-3 * np.eye(3) + 1e-3, np.array([[0.02, 0.005], [0.005, 0.1]]),
        alpha, beta, kappa,
    )  # fmt: skip


def filled(function, size, *others):
    def plain(x):
        out = np.zeros(size)
        function(x, *others, out)
        return out

    return plain


@pytest.mark.parametrize("scaling", [(1.0, 2.0, 0.0), (0.1, 2.0, 0.5)])
def test_equals_filterpy_and_stone_soup_on_a_pendulum(scaling):
    ours = pendulum(*scaling)
    x, p, q, r = ours.x, ours.P, ours.Q, ours.R
    theirs = [(x, p), (x, p)]
    rng = np.random.default_rng(2)
    truth = x + np.linalg.cholesky(p) @ rng.normal(size=3)
    for k in range(150):
        u = np.array([math.sin(0.1 * k)])
        move, see = filled(swing, 3, u, ours.model.p), filled(sight, 2, u, ours.model.p)
        truth = move(truth) + np.linalg.cholesky(q) @ rng.normal(size=3)
        y = see(truth) + np.linalg.cholesky(r) @ rng.normal(size=2)
        assert ours.step(u, y) == Status.OK
        for i, library in enumerate((filterpy_step, stonesoup_step)):
            theirs[i] = library(move, see, q, r, *theirs[i], y, scaling)
            np.testing.assert_allclose(ours.x, theirs[i][0], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(ours.P, theirs[i][1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("form", ["ukf", "array", "vdm"])
def test_equals_filterpy_and_stone_soup_on_the_cylinder(form):
    inputs, samples, _ = healthy_motion(60)
    ours, theirs = hydraulic(form), [(X0, P0), (X0, P0)]
    for u, y in zip(inputs, samples, strict=True):
        ours.step(u, y)
        see = filled(cylinder.h, 3, u, PARAMETERS)
        for i, library in enumerate((filterpy_step, stonesoup_step)):
            theirs[i] = library(
                lambda z, u=u: rk4(cylinder.f, z, u, PARAMETERS, 1e-3), see, Q, R, *theirs[i], y, (1.0, 2.0, 0.0)
            )
            np.testing.assert_allclose(ours.x, theirs[i][0], rtol=1e-9, atol=1e-9)
            scale = np.sqrt(np.diag(theirs[i][1]))
            assert (np.abs(ours.P - theirs[i][1]) < 1e-9 * np.outer(scale, scale)).all()


@pytest.mark.parametrize(("form", "alpha"), [("ukf", 1.0), ("ukf", 1e-2), ("vdm", 0.7), ("vdm", 1e-2)])
def test_equals_the_textbook_with_missing_channels_and_a_negative_centre(form, alpha):
    inputs, samples, _ = healthy_motion(150)
    samples[20:25, 0] = NAN
    samples[30:33, 1:] = NAN
    samples[100:103] = NAN
    ours, (x, p) = hydraulic(form, alpha), (X0, P0)
    for u, y in zip(inputs, samples, strict=True):
        x, p, nis = unscented(cylinder.f, cylinder.h, PARAMETERS, 1e-3, Q, R, x, p, u, y, alpha)
        assert ours.step(u, y) == (Status.MISSING if np.isnan(y).any() else Status.OK)
        tolerance = 1e-9 if alpha > 0.1 else 1e-7  # the textbook's own sums lose digits
        np.testing.assert_allclose(ours.x, x, rtol=tolerance, atol=tolerance)
        scale = np.sqrt(np.outer(np.diag(p), np.diag(p)))
        assert (np.abs(ours.P - p) < tolerance * scale).all()
        assert ours.nis == pytest.approx(nis, rel=1e-6, abs=1e-6)
        np.testing.assert_allclose(ours.S, ours.S.T, rtol=1e-15)


@pytest.mark.parametrize("form", ["ukf", "vdm"])
def test_a_negative_centre_counts_in_the_innovation_covariance(form):
    inputs, samples, _ = healthy_motion(5)
    ours, blind = hydraulic(form, 1e-2), hydraulic(form, 1e-2)
    for u, y in zip(inputs, samples, strict=True):
        blind.arena[:] = ours.arena
        blind.step(u, np.full(3, NAN))
        ours.step(u, y)
        outputs = np.ix_([0, 2, 3], [0, 2, 3])  # of the states: h is linear, so S = H P- H' + R
        np.testing.assert_allclose(ours.S, blind.P[outputs] + R, rtol=1e-7, atol=1e-13)


def test_the_three_forms_agree_where_none_fails():
    inputs, samples, _ = healthy_motion(1000)
    samples[100:110, 0] = NAN
    samples[300:310] = NAN
    reference = hydraulic("array").run(inputs, samples)
    scale = np.sqrt(np.einsum("kii->ki", reference.P))
    for form in ("vdm", "ukf"):
        other = hydraulic(form).run(inputs, samples)
        np.testing.assert_array_equal(other.status, reference.status)
        np.testing.assert_allclose(other.x, reference.x, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(other.P, reference.P, rtol=0, atol=1e-12)
        # relative to the deviations; the points themselves are rounded to 1e-16 of x, which is 1e5 deviations
        assert (np.abs(other.P - reference.P) < 1e-10 * scale[:, :, None] * scale[:, None]).all()


def test_the_downdate_form_fails_with_small_noise_and_the_array_form_never():
    inputs, samples, _ = healthy_motion(2000)
    tiny = 1e-12 * R
    failing = {form: hydraulic(form, 1e-3, r=tiny) for form in ("vdm", "ukf")}
    array = hydraulic("array", r=tiny)
    reference = array.run(inputs, samples)
    assert (reference.status == Status.OK).all() and array.health.repaired == 0
    for form, ours in failing.items():
        trajectory = ours.run(inputs, samples)
        repaired = (trajectory.status == Status.REPAIRED).sum()
        assert repaired > 1000, form
        assert ours.health.repaired == repaired and (trajectory.status[trajectory.status != Status.REPAIRED] == 0).all()
        assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all()
        np.testing.assert_allclose(trajectory.x, reference.x, rtol=1e-3, atol=1e-3)
        assert (np.einsum("kii->ki", trajectory.P) > 0).all()


FORMS = {
    "array": (factor_array, reduce_array),
    "covariance": (factor_covariance, reduce_covariance),
    "vdm": (factor_vdm, reduce_vdm),
}


@pytest.mark.parametrize(("form", "alpha", "beta"), [
    ("array", 1.0, 2.0), ("array", 0.1, 2.0), ("array", 0.1, 0.5), ("array", 0.1, -2.0), ("covariance", 1.0, 2.0),
    ("covariance", 0.1, 2.0), ("vdm", 1.0, 2.0), ("vdm", 0.1, 2.0),
])  # fmt: skip
def test_the_forms_give_the_same_covariance_also_with_a_negative_centre(form, alpha, beta):
    """Against sums in plain numpy; the array form for beta < alpha^2 without the negative rest."""
    rng = np.random.default_rng(4)
    factor_form, reduce_form = FORMS[form]
    n, m = 3, 2
    outer, centre = 0.5 / (alpha**2 * n), 1 - 1 / alpha**2 + 1 - alpha**2 + beta
    root, rest = math.copysign(math.sqrt(abs(centre)), centre), beta - alpha**2
    points, q = rng.normal(size=(7, 3)), np.triu(rng.normal(size=(3, 3)))
    mean = points[0] + outer * (points[1:] - points[0]).sum(axis=0)
    weights = np.array([centre] + [outer] * 6)
    p = (points - mean).T @ np.diag(weights) @ (points - mean) + q.T @ q
    p += max(-rest, 0.0) * np.outer(points[0] - mean, points[0] - mean)
    stack, spare, scratch, factor = np.full((10, 5), NAN), np.full(200, NAN), np.zeros(5), np.zeros((3, 3))
    stack[:7, :3] = points - mean
    assert factor_form(n, q, root, outer, stack, spare, scratch, factor) == Status.OK
    np.testing.assert_allclose(factor.T @ factor, p, rtol=1e-9, atol=1e-9)

    drawn = np.vstack([np.zeros(3), factor, -factor]) * alpha * math.sqrt(n)
    seen, r = rng.normal(size=(7, 2)), np.triu(rng.normal(size=(2, 2)))
    mean = seen[0] + outer * (seen[1:] - seen[0]).sum(axis=0)
    deviations = seen - mean
    s = deviations.T @ np.diag(weights) @ deviations + r.T @ r
    s += max(-rest, 0.0) * np.outer(deviations[0], deviations[0])
    cross = drawn.T @ np.diag(weights) @ deviations
    stack[:] = 0.0
    stack[:7] = np.sqrt(np.abs(weights))[:, None] * np.hstack([deviations, drawn])
    stack[0] *= np.sign(centre)
    stack[7:9, :2] = r
    assert reduce_form(stack, 9, m, n, root, outer, factor, spare, scratch) == Status.OK
    block = np.triu(stack[:5])
    np.testing.assert_allclose(block[:2, :2].T @ block[:2, :2], s, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(block[:2, 2:].T @ block[:2, :2], cross, rtol=1e-9, atol=1e-9)
    posterior = factor.T @ factor - cross @ np.linalg.solve(s, cross.T)
    np.testing.assert_allclose(block[2:, 2:].T @ block[2:, 2:], posterior, rtol=1e-8, atol=1e-8)


def test_an_innovation_covariance_that_is_not_definite_is_repaired_and_reported_so():
    u, y = np.zeros(1), np.array([0.3, 0.8])
    ours, blind = pendulum(0.1, beta=-2.0, spread=3.0), pendulum(0.1, beta=-2.0, spread=3.0)
    assert ours.step(u, y) == Status.REPAIRED and ours.health.repaired == 1
    assert blind.step(u, np.full(2, NAN)) == Status.MISSING  # the prediction is sound, S is not
    x, p = blind.x, blind.P
    root, weight = 0.1 * math.sqrt(3) * np.linalg.cholesky(p).T, 0.5 / 0.03
    points = np.vstack([x, x + root, x - root])
    seen = np.array([filled(sight, 2, u, ours.model.p)(point) for point in points])
    from_centre = seen[1:] - seen[0]
    shift = weight * from_centre.sum(axis=0)
    s = weight * from_centre.T @ from_centre + ours.R
    assert np.linalg.eigvalsh(s + (-2.0 - 0.01) * np.outer(shift, shift))[0] < 0
    k = np.linalg.solve(s, weight * from_centre.T @ (points[1:] - x)).T
    np.testing.assert_allclose(ours.S, s, rtol=1e-9)
    np.testing.assert_allclose(ours.x, x + k @ (y - seen[0] - shift), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ours.P, p - k @ s @ k.T, rtol=1e-8, atol=1e-8)


FAULTS = {
    "input is not a number": (Status.NOT_FINITE_INPUT, (0, NAN), None),
    "input is huge": (Status.DIVERGED, (0, 1e300), None),
    "infinite sample": (Status.NOT_FINITE_INPUT, None, (1, -math.inf)),
    "meaningless sample": (Status.REPAIRED, None, (1, 1e300)),
    "outlier": (Status.GATED, None, (0, 0.5)),
    "missing channel": (Status.MISSING, None, (2, NAN)),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("form", ["ukf", "vdm"])
def test_faults_show_in_the_status_and_not_in_the_estimate(form, fault):
    expected, bad_input, bad_sample = FAULTS[fault]
    inputs, samples, _ = healthy_motion(30)
    ours = hydraulic(form, gate=0.9999999)
    ours.run(inputs[:-1], samples[:-1])
    before, blind = ours.arena.copy(), hydraulic(form)
    blind.arena[:] = before
    u, y = inputs[-1].copy(), samples[-1].copy()
    if bad_input:
        u[bad_input[0]] = bad_input[1]
    if bad_sample:
        y[bad_sample[0]] = bad_sample[1]
    assert ours.step(u, y) == expected
    if expected in {Status.NOT_FINITE_INPUT, Status.DIVERGED}:
        counters = slice(len(before) - 8, None)
        after = ours.arena.copy()
        before[counters] = after[counters] = 0
        assert before.tobytes() == after.tobytes()
    elif expected != Status.MISSING:  # predicted, not corrected
        blind.step(u, np.full(3, NAN))
        np.testing.assert_array_equal(ours.x, blind.x)
        np.testing.assert_array_equal(ours.P, blind.P)


@pytest.mark.parametrize("form", ["ukf", "vdm"])
def test_run_equals_the_step_loop_bit_for_bit(form):
    inputs, samples, _ = healthy_motion(300)
    inputs[40, 0], samples[60], samples[80, 0], samples[90, 2] = NAN, math.inf, 0.5, NAN
    ours, rows = hydraulic(form, 1e-3, r=1e-12 * R, gate=0.9999), []
    for u, y in zip(inputs, samples, strict=True):
        status = ours.step(u, y)
        rows.append((ours.x, ours.P, ours.innovation, ours.nis, status))
    arena = ours.arena.tobytes()
    ours.reset()
    trajectory = ours.run(inputs, samples)
    for column, field in zip(zip(*rows, strict=True), ("x", "P", "innovation", "nis", "status"), strict=True):
        np.testing.assert_array_equal(np.array(column), getattr(trajectory, field), err_msg=field)
    assert ours.arena.tobytes() == arena and ours.health.repaired > 0
    assert len(ours.arena) == type(ours).arena_size(4, 3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alpha": 0.0}, "alpha = 0.0"), ({"alpha": 1e-200}, "alpha = 1e-200"), ({"kappa": -4.0}, "kappa = -4.0"),
        ({"beta": NAN}, "beta = nan"),
    ],
)  # fmt: skip
def test_weights_are_checked(change, words):
    with pytest.raises(ValueError, match=words):
        UKF(model(), X0, P0, Q, R, **change)
    with pytest.raises(ValueError, match=words):
        SRUKF(model(), X0, P0, Q, R, variant="vdm", **change)


def test_variant_is_checked():
    with pytest.raises(ValueError, match="variant = 'qr': must be one of array, vdm"):
        SRUKF(model(), X0, P0, Q, R, variant="qr")
    with pytest.raises(ValueError, match=r"alpha = 0.001.*between"):
        SRUKF(model(), X0, P0, Q, R, alpha=1e-3)
