"""The window pass against a plain Kalman filter, its gradient against finite differences."""

import numpy as np
import pytest

from servohil.estimators.noise.noise_window import lane_count, regress, window_step

N, M, STEPS = 4, 3, 60


@pytest.fixture(scope="module")
def window():
    rng = np.random.default_rng(0)
    F = np.eye(N) + 0.1 * rng.normal(size=(STEPS, N, N))
    nu = rng.normal(size=(STEPS, M))
    nu[7, 1] = nu[20:23] = np.nan
    return F, rng.normal(size=(STEPS, M, N)), nu, 0.1 * rng.normal(size=(STEPS, N))


def plain(window, theta):
    """Log-likelihood without its constant, d and P by textbook matrices; innovations taken channel by channel."""
    q, r = np.diag(np.exp(theta[:N])), np.diag(np.exp(theta[N:]))
    d, P, loglik = np.zeros(N), np.eye(N), 0.0
    innovations = []
    for F, H_all, nu, c in zip(*window, strict=True):
        d, P = F @ d, F @ P @ F.T + q
        rows = ~np.isnan(nu)
        H, e = H_all[rows], nu[rows] - H_all[rows] @ d
        S = H @ P @ H.T + r[np.ix_(rows, rows)]
        loglik -= 0.5 * (np.linalg.slogdet(S)[1] + e @ np.linalg.solve(S, e))
        lower = np.linalg.cholesky(S)  # channel by channel: whitened, each divided by its own conditional deviation
        scale = np.diag(lower)
        innovations += list(zip(np.linalg.solve(lower, e) * scale, scale**2, strict=True))
        K = P @ H.T @ np.linalg.inv(S)
        d, P = d + K @ e - c, P - K @ S @ K.T
    return loglik, d, P, np.array(innovations)


def compiled(window, theta):
    lanes = lane_count(N, M)
    d, P = np.zeros((N, lanes)), np.zeros((N, N, lanes))
    P[:, :, 0] = np.eye(N)
    gradient, information, totals = np.zeros(lanes), np.zeros((lanes, lanes)), np.zeros(3)
    q, r = np.exp(theta[:N]), np.exp(theta[N:])
    for F, H, nu, c in zip(*window, strict=True):
        room = np.full((N + 3, lanes), np.nan)
        assert window_step(N, M, F, H, nu, c, q, r, d, P, gradient, information, totals, room)
    used = slice(1, 1 + N + M)
    return totals, d, P, gradient[used], information[used, used]


THETA = np.random.default_rng(3).normal(size=N + M)


def test_value_equals_the_kalman_filter(window):
    totals, d, P, _, _ = compiled(window, THETA)
    loglik, d_plain, P_plain, innovations = plain(window, THETA)
    assert totals[0] == pytest.approx(loglik, rel=1e-12)
    np.testing.assert_allclose(d[:, 0], d_plain, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(P[:, :, 0], P_plain, rtol=1e-11, atol=1e-12)
    assert totals[1] == pytest.approx((innovations[:, 0] ** 2 / innovations[:, 1]).sum(), rel=1e-11)
    assert totals[2] == len(innovations) == M * STEPS - 10


def test_derivatives_equal_central_differences(window):
    _, d, P, gradient, information = compiled(window, THETA)
    h = 1e-5
    for j in range(N + M):
        ends = [plain(window, THETA + sign * h * np.eye(N + M)[j]) for sign in (1, -1)]
        slope = [(a - b) / (2 * h) for a, b in zip(ends[0][:3], ends[1][:3], strict=True)]
        assert gradient[j] == pytest.approx(slope[0], rel=1e-6, abs=1e-7)
        np.testing.assert_allclose(d[:, 1 + j], slope[1], rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(P[:, :, 1 + j], slope[2], rtol=1e-6, atol=1e-8)
    # Fisher information of independent Gaussians: 1/2 s_i s_j / s^2 + e_i e_j / s
    s = plain(window, THETA)[3][:, 1]
    sides = [np.array([plain(window, THETA + sign * h * unit)[3] for unit in np.eye(N + M)]) for sign in (1, -1)]
    de, ds = np.moveaxis((sides[0] - sides[1]) / (2 * h), 2, 0)
    expected = 0.5 * (ds / s) @ (ds / s).T + (de / s) @ de.T
    np.testing.assert_allclose(information, expected, rtol=1e-5, atol=1e-6)


def test_regression_returns_a_linear_map_and_refuses_a_flat_factor():
    rng = np.random.default_rng(1)
    A, upper = rng.normal(size=(M, N)), np.triu(rng.normal(size=(N, N))) + 3.0 * np.eye(N)
    spread = 1.7
    points = np.vstack([np.zeros(N), spread * upper, -spread * upper]) @ A.T + rng.normal(size=M)
    out = np.empty((M, N))
    assert regress(points, upper, spread, N, M, out)
    np.testing.assert_allclose(out, A, rtol=1e-12, atol=1e-13)
    upper[2, 2] = 0.0
    assert not regress(points, upper, spread, N, M, out)


@pytest.mark.parametrize("broken", ["F", "nu", "r"])
def test_numbers_that_overflow_end_the_pass(window, broken):
    lanes = lane_count(N, M)
    F, H, nu, c = (part[0].copy() for part in window)
    q, r = np.ones(N), np.ones(M)
    if broken == "F":
        F[0, 0] = 1e200
    elif broken == "nu":
        nu[0] = 1e200
    else:
        r[:] = -1e9
    d, P = np.zeros((N, lanes)), np.zeros((N, N, lanes))
    P[:, :, 0] = np.eye(N)
    room = np.zeros((N + 3, lanes))
    assert not window_step(N, M, F, H, nu, c, q, r, d, P, np.zeros(lanes), np.zeros((lanes, lanes)), np.zeros(3), room)
