"""The robust Kalman filter against its equations by inverses, and its bound against exact mean square errors."""

import math

import numpy as np
import pytest
from linear_bench import EHA_A, EHA_B, EHA_C, actuator, as_model, random_system
from reference_filters import robust_kalman
from scipy.linalg import solve_discrete_are

from servohil.estimators.health import Status
from servohil.estimators.kf import KF
from servohil.estimators.robust_kf import RobustKF

NAN = float("nan")
# Example of Xie, Soh & de Souza: x2 grows by (1 + delta), |delta| <= 0.3; an independent third state beside it, so
# that one compilation serves all of these tests.
XIE_A = np.array([[0.0, -0.5, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.5]])
XIE_C = np.array([[-100.0, 10.0, 0.0]])
XIE_Q = np.array([[36.0, -6.0, 0.0], [-6.0, 1.0, 0.0], [0.0, 0.0, 1e-3]])
XIE_H1 = np.array([[0.0], [0.3], [0.0]])
XIE_E = np.array([[0.0, 1.0, 0.0]])
XIE_R = np.eye(1)
XIE_EPSILON = 1e-3


def xie(h1=XIE_H1, epsilon=XIE_EPSILON, h2=None, **options):
    arguments = {"P0": np.eye(3), "E": XIE_E, **options}
    return RobustKF(
        as_model(XIE_A, np.zeros(3), XIE_C), np.zeros(3), Q=XIE_Q, R=XIE_R, H1=h1, H2=h2, epsilon=epsilon, **arguments
    )


def settled(ours, steps=400):
    """The bound P after `steps` steps without data that would move the estimate."""
    return ours.run(np.zeros((steps, 1)), np.zeros((steps, 1))).P


def is_below(smaller, larger, tolerance=1e-9):
    scale = np.sqrt(np.diag(larger))
    return np.linalg.eigvalsh((larger - smaller) / np.outer(scale, scale))[0] > -tolerance


@pytest.mark.parametrize("outputs_too", [False, True])
def test_equals_the_equations_by_inverses(outputs_too):
    system, a, b, c, q, r, p0 = random_system(3, 1)
    rng = np.random.default_rng(4)
    h1, e = 0.3 * rng.normal(size=(3, 2)), 0.5 * rng.normal(size=(2, 3))
    h2 = 0.3 * rng.normal(size=(1, 2)) if outputs_too else np.zeros((1, 2))
    x, p = np.zeros(3), p0
    ours = RobustKF(system, x, p0, q, r, H1=h1, H2=h2, E=e, epsilon=0.01)
    for k in range(300):
        u, y = rng.normal(size=1), rng.normal(size=1)
        if k % 7 == 3:
            y[:] = NAN
        x, p, _ = robust_kalman(a, b, c, q, r, h1, h2, e, 0.01, x, p, u, y)
        assert ours.step(u, y) == (Status.MISSING if np.isnan(y[0]) else Status.OK)
        np.testing.assert_allclose(ours.x, x, atol=1e-10)
        np.testing.assert_allclose(ours.P, p, atol=1e-10)


@pytest.mark.parametrize("nothing", ["H1", "E"])
def test_without_uncertainty_it_is_the_kalman_filter(nothing):
    system, *_, q, r, p0 = random_system(3, 1)
    shapes = {"H1": np.ones((3, 2)), "E": np.ones((4, 3)), "H2": None if nothing == "H1" else np.ones((1, 2))}
    shapes[nothing] = 0.0 * shapes[nothing]
    rng = np.random.default_rng(0)
    inputs, outputs = rng.normal(size=(200, 1)), rng.normal(size=(200, 1))
    robust = RobustKF(system, np.zeros(3), p0, q, r, epsilon=0.1, **shapes).run(inputs, outputs)
    kalman = KF(system, np.zeros(3), p0, q, r).run(inputs, outputs)
    for field in ("x", "P", "innovation", "nis", "status"):
        np.testing.assert_allclose(getattr(robust, field), getattr(kalman, field), rtol=1e-12, atol=1e-12)


def gains_of(a, c, q, h1, h2, epsilon, steps):
    """P and the gains of every step, and whether the bound is proven: epsilon^-1 > E X E' for the state's own bound."""
    x, p, bound, rows = np.zeros(3), np.eye(3), np.eye(3), []
    for _ in range(steps):
        for h in (h1, h2):
            if h.any():
                assert 1 / epsilon > (XIE_E @ bound @ XIE_E.T)[0, 0]
                bound = np.linalg.inv(np.linalg.inv(bound) - epsilon * XIE_E.T @ XIE_E)
            if h is h1:
                bound = a @ bound @ a.T + h1 @ h1.T / epsilon + q
        none = np.zeros(3)
        x, p, gains = robust_kalman(a, none, c, q, XIE_R, h1, h2, XIE_E, epsilon, x, p, np.zeros(1), np.zeros(1))
        rows.append((p, *gains))
    return rows


@pytest.mark.parametrize(("share", "h2", "epsilon"), [(1.0, 0.0, XIE_EPSILON), (1.0, 0.0, 2e-4), (0.3, 10.0, 1e-3)])
def test_the_bound_holds_for_every_uncertainty_exactly(share, h2, epsilon):
    """State and estimate are linear in the noise for given F: their second moments follow exactly, no Monte Carlo."""
    steps = 120
    h1, h2 = share * XIE_H1, np.array([[h2]])
    rows = gains_of(XIE_A, XIE_C, XIE_Q, h1, h2, epsilon, steps)
    bounds = settled(xie(h1, epsilon, h2), steps)
    np.testing.assert_allclose(bounds, [row[0] for row in rows], rtol=1e-6, atol=1e-9)
    rng = np.random.default_rng(0)
    sequences = [np.full((steps, 2), delta) for delta in np.linspace(-1.0, 1.0, 9)]
    sequences += [rng.choice([-1.0, 1.0], size=(steps, 2)) for _ in range(20)]
    sequences += [np.sign(np.sin(w * np.arange(steps) + 0.1))[:, None] * [1.0, -1.0] for w in (0.3, 1.0, 2.0, 3.0)]
    tightest = np.inf
    for sequence in sequences:
        moment = np.zeros((6, 6))  # of (x, estimate)
        moment[:3, :3] = np.eye(3)
        for (f1, f2), (p, before, between, k) in zip(sequence, rows, strict=True):
            move = XIE_A + f1 * h1 @ XIE_E
            see = XIE_C + f2 * h2 @ XIE_E
            guess = between @ XIE_A @ before
            top = np.hstack([move, np.zeros((3, 3))])
            whole = np.vstack([top, np.hstack([k @ see @ move, guess - k @ XIE_C @ guess])])
            noise = np.vstack([np.eye(3), k @ see])
            gain = np.vstack([np.zeros((3, 1)), k])
            moment = whole @ moment @ whole.T + noise @ XIE_Q @ noise.T + gain @ XIE_R @ gain.T
            error = moment[:3, :3] - moment[:3, 3:] - moment[3:, :3] + moment[3:, 3:]
            assert is_below(error, p)
            tightest = min(tightest, (p[0, 0] - error[0, 0]) / p[0, 0])
    assert tightest < 0.9  # the bound says something


def costs(filter_gains):
    """Mean square of the error of x1 one step ahead, for delta = 0, -0.3, 0.3: what the paper tabulates."""
    before, k = filter_gains
    two = slice(0, 2)
    a, c, before, k = XIE_A[two, two], XIE_C[:, two], before[two, two], k[two]
    out = []
    for delta in (0.0, -1.0, 1.0):
        move = a + delta * (XIE_H1 @ XIE_E)[two, two]
        guess = a @ before
        whole = np.block([[move, np.zeros((2, 2))], [guess @ k @ c, guess @ (np.eye(2) - k @ c)]])
        noise = np.vstack([np.hstack([np.eye(2), np.zeros((2, 1))]), np.hstack([np.zeros((2, 2)), guess @ k])])
        source = noise @ np.block([[XIE_Q[two, two], np.zeros((2, 1))], [np.zeros((1, 2)), XIE_R]]) @ noise.T
        moment = source
        for _ in range(14):  # doubling: sum of whole^i source whole'^i
            moment, whole = moment + whole @ moment @ whole.T, whole @ whole
        error = np.array([[1.0, 0.0, -1.0, 0.0]])
        out.append((error @ moment @ error.T)[0, 0])
    return out


def test_the_example_of_the_paper():
    """The standard filter's costs are the paper's (36.0, 551.2, 8352.8); the robust filter's hardly depend on delta."""
    two = slice(0, 2)
    p = solve_discrete_are(XIE_A[two, two].T, XIE_C[:, two].T, XIE_Q[two, two], XIE_R)
    k = np.vstack([p @ XIE_C[:, two].T / (XIE_C[:, two] @ p @ XIE_C[:, two].T + XIE_R), [[0.0]]])
    np.testing.assert_allclose(costs((np.eye(3), k)), [36.0, 551.2, 8352.8], atol=0.05)
    last = gains_of(XIE_A, XIE_C, XIE_Q, XIE_H1, np.zeros((1, 1)), XIE_EPSILON, 400)[-1]
    assert max(costs((last[1], last[3]))) < 56.0


def test_larger_uncertainty_gives_a_larger_bound():
    before = settled(KF(as_model(XIE_A, np.zeros(3), XIE_C), np.zeros(3), np.eye(3), XIE_Q, XIE_R))
    for size in (1e-3, 0.1, 0.5, 1.0):
        bound = settled(xie(size * XIE_H1))
        assert all(is_below(a, b) for a, b in zip(before, bound, strict=True))
        before = bound
    wider = settled(xie(h2=np.array([[10.0]])))
    assert is_below(before[-1], wider[-1]) and wider[-1, 0, 0] > 1.1 * before[-1, 0, 0]


def test_the_bound_has_its_minimum_between_too_small_and_too_large_an_epsilon():
    traces = [np.trace(settled(xie(epsilon=epsilon))[-1]) for epsilon in (1e-5, 1e-4, 1e-3, 2e-3)]
    assert traces[0] > traces[1] > 1.5 * traces[2]
    closer = 0.985 / settled(xie(epsilon=1e-3))[-1, 1, 1]
    assert closer > 2e-3


@pytest.mark.parametrize("where", ["estimate", "covariance"])
def test_an_epsilon_too_large_for_the_state_is_made_smaller(where):
    """E (x x' + P) E' takes half of what the smaller epsilon leaves; the rest is the filter with that epsilon."""
    x0, p0 = (np.array([0.0, 100.0, 0.0]), np.eye(3)) if where == "estimate" else (np.zeros(3), 1e4 * np.eye(3))
    ours = xie(P0=p0)
    ours.reset(x0, p0)
    y = XIE_C @ XIE_A @ x0
    assert ours.step(np.zeros(1), y) == Status.REPAIRED and ours.health.repaired == 1
    seen = 1e4 + 1.0 if where == "estimate" else 1e4
    x, p, _ = robust_kalman(
        XIE_A, np.zeros(3), XIE_C, XIE_Q, XIE_R, XIE_H1, np.zeros((1, 1)), XIE_E, 0.5 / seen, x0, p0, np.zeros(1), y
    )
    np.testing.assert_allclose(ours.x, x, rtol=1e-9)
    np.testing.assert_allclose(ours.P, p, rtol=1e-7, atol=1e-9)


def stiff_actuator(delta):
    """The actuator of P2 with its stiffness and damping off by the same share delta of 30 %."""
    change = np.zeros((3, 3))
    change[2, 1:] = 0.3 * (EHA_A[2, 1:] - [0.0, 1.0])
    return EHA_A + delta * change


EHA_Q, EHA_R, EHA_P0 = np.diag([1e-16, 1e-8, 1e-2]), np.array([[1e-10]]), np.diag([1e-6, 1e-4, 1.0])
EHA_H1 = np.array([[0.0], [0.0], [1.0]])
EHA_E = 0.3 * (EHA_A[2:] - [[0.0, 0.0, 1.0]])


def actuator_nees(kind, delta, **options):
    """Mean e' P^-1 e over runs and times of a driven actuator whose parameters are off by delta, and its statuses."""
    runs, steps = 40, 400
    rng = np.random.default_rng(7)
    inputs = 1e-5 * np.sin(0.05 * np.arange(steps))[:, None]
    move = stiff_actuator(delta)
    x = rng.multivariate_normal(np.zeros(3), EHA_P0, size=runs)
    states = np.empty((steps, runs, 3))
    for k in range(steps):
        x = x @ move.T + EHA_B * inputs[k, 0] + np.sqrt(np.diag(EHA_Q)) * rng.normal(size=(runs, 3))
        states[k] = x
    samples = states[..., :1] + math.sqrt(EHA_R[0, 0]) * rng.normal(size=(steps, runs, 1))
    ours = kind(actuator(), np.zeros(3), EHA_P0, EHA_Q, EHA_R, **options)
    nees, statuses = [], []
    for run in range(runs):
        ours.reset()
        trajectory = ours.run(inputs, samples[:, run])
        error = states[:, run] - trajectory.x
        nees.append(np.einsum("ki,ki->k", error, np.linalg.solve(trajectory.P, error[..., None])[..., 0]))
        statuses.append(trajectory.status)
    return np.mean(nees), np.concatenate(statuses)


def test_a_driven_actuator_stays_within_the_bound_where_the_kalman_filter_does_not():
    """Stiffness and damping off by 30 %, a known flow that moves the state to |E x| = 0.12. The input is no part of the
    theory: the bound holds up to epsilon = 0.3 / |E x|^2, beyond that it is exceeded by a third."""
    deltas = (-1.0, -0.5, 0.0, 0.5, 1.0)
    kalman = [actuator_nees(KF, delta)[0] for delta in deltas]
    assert kalman[2] == pytest.approx(3.0, rel=0.05) and min(kalman[0], kalman[4]) > 6.0
    for epsilon, limit in ((1.0, 3.0), (20.0, 3.0), (200.0, 4.5)):
        for delta in deltas:
            nees, status = actuator_nees(RobustKF, delta, H1=EHA_H1, E=EHA_E, epsilon=epsilon)
            assert nees < limit, (epsilon, delta)
            share = (status == Status.REPAIRED).mean()
            assert share < 0.01 if epsilon < 50.0 else share > 0.5


def test_survives_gaps_infinities_and_huge_numbers():
    rng = np.random.default_rng(5)
    inputs, outputs = 1e-5 * rng.normal(size=(20_000, 1)), 1e-3 * rng.normal(size=(20_000, 1))
    for value, share in ((NAN, 0.2), (np.inf, 0.01), (1e300, 0.01), (-1e300, 0.01), (1e140, 0.01), (1e12, 0.001)):
        outputs[rng.random((20_000, 1)) < share] = value
    for value, share in ((NAN, 0.01), (np.inf, 0.01), (1e300, 0.01), (1e140, 0.01)):
        inputs[rng.random((20_000, 1)) < share] = value
    for h2 in (None, [[1e-3]]):
        ours = RobustKF(
            actuator(), np.zeros(3), EHA_P0, EHA_Q, EHA_R, H1=EHA_H1, H2=h2, E=EHA_E, epsilon=1.0, gate=0.999
        )
        trajectory = ours.run(inputs, outputs)
        assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all() and np.isfinite(trajectory.nis).all()
        deviations = np.sqrt(np.einsum("kii->ki", trajectory.P))
        assert (deviations > 0).all()
        health = ours.health
        assert min(health.missing, health.gated, health.repaired, health.not_finite_input, health.diverged) > 0


def test_run_equals_the_step_loop_and_the_arena_is_the_whole_state():
    rng = np.random.default_rng(2)
    inputs, outputs = np.zeros((200, 1)), 10 * rng.normal(size=(200, 1))
    outputs[50:60] = NAN
    outputs[70] = np.inf
    ours = xie(h2=[[5.0]], gate=0.99)
    statuses = [ours.step(u, y) for u, y in zip(inputs, outputs, strict=True)]
    arena = ours.arena.tobytes()
    ours.reset()
    half = ours.run(inputs[:100], outputs[:100])
    other = xie(h2=[[5.0]], gate=0.99, P0=2 * np.eye(3))
    other.arena[:] = ours.arena
    rest = other.run(inputs[100:], outputs[100:])
    assert [*half.status, *rest.status] == statuses and other.arena.tobytes() == arena
    assert len(ours.arena) == RobustKF.arena_size(3, 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"H1": np.ones((2, 1))}, r"H1 has shape \(2, 1\): must be \(3, any\)"),
        ({"E": np.ones(3)}, r"E has shape \(3,\): must be \(any, 3\)"),
        ({"E": np.zeros((0, 3))}, r"E has shape \(0, 3\)"),
        ({"H2": np.ones((1, 2))}, r"H2 has shape \(1, 2\): must be \(1, 1\)"),
        ({"H1": [[0.0], [NAN], [0.0]]}, r"H1\[1, 0\] = .*nan.*finite"),
        ({"E": "abc"}, "E = 'abc'"),
        ({"epsilon": 0.0}, "epsilon = 0.0"),
        ({"epsilon": NAN}, "epsilon = nan"),
        ({"epsilon": math.inf}, "epsilon = inf"),
        ({"epsilon": "1"}, "epsilon = '1'"),
        ({"R": None}, "R and chol_R"),
    ],
)
def test_construction_errors_name_argument_value_and_rule(change, words):
    arguments = {
        "model": as_model(XIE_A, np.zeros(3), XIE_C), "x0": np.zeros(3), "P0": np.eye(3), "Q": XIE_Q, "R": XIE_R,
        "H1": XIE_H1, "E": XIE_E, "epsilon": 0.1, **change,
    }  # fmt: skip
    with pytest.raises(ValueError, match=words):
        RobustKF(**arguments)
    assert EHA_C.shape == XIE_C.shape
