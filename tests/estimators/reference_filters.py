"""Slow textbook filters in plain numpy, and the systems they are compared on. They share no code with the library."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def linear_f(x, u, p, dx):
    """Next state of x+ = A x + b u; p holds A by rows, b, C by rows."""
    n = dx.shape[0]
    for i in range(n):
        total = p[n * n + i] * u[0]
        for j in range(n):
            total += p[i * n + j] * x[j]
        dx[i] = total


def linear_h(x, u, p, y):
    n = x.shape[0]
    for i in range(y.shape[0]):
        total = 0.0
        for j in range(n):
            total += p[n * n + n + i * n + j] * x[j]
        y[i] = total


def random_linear(n: int, m: int, seed: int) -> tuple[Array, Array, Array, Array, Array, Array]:
    """A (spectral radius 0.95), b, C, Q, R, P0 of a random stable system."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(n, n))
    a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()

    def covariance(size: int) -> Array:
        root = rng.normal(size=(size, size))
        return root @ root.T / size + 0.1 * np.eye(size)

    return a, rng.normal(size=n), rng.normal(size=(m, n)), covariance(n), covariance(m), covariance(n)


def kalman(
    a: Array, b: Array, c: Array, q: Array, r: Array, x: Array, p: Array, u: Array, y: Array
) -> tuple[Array, Array, Array, float]:
    """One step of the textbook filter with the Joseph form; rows of y that are NaN are deleted. x, P, S, loglik."""
    x = a @ x + b * u[0]
    p = a @ p @ a.T + q
    s_full = c @ p @ c.T + r
    rows = ~np.isnan(y)
    if not rows.any():
        return x, p, s_full, 0.0
    c, r, e = c[rows], r[np.ix_(rows, rows)], y[rows] - c[rows] @ x
    s = c @ p @ c.T + r
    k = np.linalg.solve(s, c @ p).T
    joseph = np.eye(len(x)) - k @ c
    loglik = -0.5 * (e @ np.linalg.solve(s, e) + np.linalg.slogdet(2.0 * np.pi * s)[1])
    return x + k @ e, joseph @ p @ joseph.T + k @ r @ k.T, s_full, float(loglik)


def rk4(f: Callable[..., None], x: Array, u: Array, p: Array, dt: float) -> Array:
    def slope(z: Array) -> Array:
        out = np.zeros_like(z)
        f(z, u, p, out)
        return out

    k1 = slope(x)
    k2 = slope(x + dt / 2 * k1)
    k3 = slope(x + dt / 2 * k2)
    k4 = slope(x + dt * k3)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def unscented(
    f: Callable[..., None], h: Callable[..., None], params: Array, dt: float, q: Array, r: Array,
    x: Array, p: Array, u: Array, y: Array, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0,
) -> tuple[Array, Array, float]:  # fmt: skip
    """One step of the covariance-form UKF (scaled weights, points drawn again after the prediction). x, P, nis."""
    n, m = len(x), len(y)
    lam = alpha**2 * (n + kappa) - n
    wm = np.full(2 * n + 1, 0.5 / (n + lam))
    wc = wm.copy()
    wm[0] = lam / (n + lam)
    wc[0] = wm[0] + 1 - alpha**2 + beta

    def points(mean: Array, cov: Array) -> Array:
        root = np.linalg.cholesky((n + lam) * cov).T
        return np.vstack([mean, mean + root, mean - root])

    moved = np.array([rk4(f, point, u, params, dt) for point in points(x, p)])
    x = wm @ moved
    p = (moved - x).T @ np.diag(wc) @ (moved - x) + q
    drawn = points(x, p)
    seen = np.zeros((2 * n + 1, m))
    for point, out in zip(drawn, seen, strict=True):
        h(point, u, params, out)
    rows = ~np.isnan(y)
    if not rows.any():
        return x, p, 0.0
    seen, r, y = seen[:, rows], r[np.ix_(rows, rows)], y[rows]
    mean_y = wm @ seen
    s = (seen - mean_y).T @ np.diag(wc) @ (seen - mean_y) + r
    k = np.linalg.solve(s, (seen - mean_y).T @ np.diag(wc) @ (drawn - x)).T
    e = y - mean_y
    return x + k @ e, p - k @ s @ k.T, float(e @ np.linalg.solve(s, e))


def adaptive_unscented(
    f: Callable[..., None], h: Callable[..., None], params: Array, dt: float, q: Array, r: Array, mean_q: Array,
    mean_r: Array, x: Array, p: Array, u: Array, y: Array, gain: float, means: bool,
    alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0,
) -> tuple[Array, Array, Array, Array, Array, Array, tuple[bool, bool]]:  # fmt: skip
    """One step of P3 algorithm 2 (P1 algorithm 1 without its square roots), as printed but for the pairing of the cross
    covariance, r subtracted once, and S S' for S. x, P, Q, R, q, r, and whether eq. 19 stood in for Q, for R."""
    n, m = len(x), len(y)
    lam = alpha**2 * (n + kappa) - n
    wm = np.full(2 * n + 1, 0.5 / (n + lam))
    wc = wm.copy()
    wm[0] = lam / (n + lam)
    wc[0] = wm[0] + 1 - alpha**2 + beta

    def points(mean: Array, cov: Array) -> Array:
        root = np.linalg.cholesky((n + lam) * cov).T
        return np.vstack([mean, mean + root, mean - root])

    moved = np.array([rk4(f, point, u, params, dt) for point in points(x, p)]) + mean_q
    x_prior = wm @ moved
    spread_x = (moved - x_prior).T @ np.diag(wc) @ (moved - x_prior)
    p = spread_x + q
    drawn = points(x_prior, p)
    seen = np.zeros((2 * n + 1, m))
    for point, out in zip(drawn, seen, strict=True):
        h(point, u, params, out)
    seen = seen + mean_r
    mean_y = wm @ seen
    spread_y = (seen - mean_y).T @ np.diag(wc) @ (seen - mean_y)
    s = spread_y + r
    k = np.linalg.solve(s, (seen - mean_y).T @ np.diag(wc) @ (drawn - x_prior)).T
    xi = y - mean_y
    x = x_prior + k @ xi
    p = p - k @ s @ k.T
    new_r = (1 - gain) * r + gain * (np.outer(xi, xi) - spread_y)
    new_q = (1 - gain) * q + gain * (k @ np.outer(xi, xi) @ k.T + p - spread_x)
    indefinite = tuple(bool(np.linalg.eigvalsh(new)[0] <= 0) for new in (new_q, new_r))
    if indefinite[0]:
        new_q = q + gain * spread_x
    if indefinite[1]:
        new_r = r + gain * spread_y
    if means:
        mean_r = (1 - gain) * mean_r + gain * (y - wm @ (seen - mean_r))
        mean_q = (1 - gain) * mean_q + gain * (x - wm @ (moved - mean_q))
    return x, p, new_q, new_r, mean_q, mean_r, (indefinite[0], indefinite[1])


def robust_kalman(
    a: Array, b: Array, c: Array, q: Array, r: Array, h1: Array, h2: Array, e: Array, epsilon: float,
    x: Array, p: Array, u: Array, y: Array,
) -> tuple[Array, Array, list[Array]]:  # fmt: skip
    """One step of the robust Kalman filter of Xie, Soh and de Souza by inverses. x, P, and its gains: what multiplies
    the estimate before the prediction, and before the correction, and the innovation."""
    unit = np.eye(len(x))
    gains = [unit, unit, np.zeros((len(x), len(y)))]
    if h1.any():
        gains[0] = np.linalg.inv(unit - epsilon * p @ e.T @ e)
        p = np.linalg.inv(np.linalg.inv(p) - epsilon * e.T @ e)
        q = q + h1 @ h1.T / epsilon
    x, p = a @ gains[0] @ x + b * u[0], a @ p @ a.T + q
    rows = ~np.isnan(y)
    if not rows.any():
        return x, p, gains
    if h2.any():
        gains[1] = np.linalg.inv(unit - epsilon * p @ e.T @ e)
        p = np.linalg.inv(np.linalg.inv(p) - epsilon * e.T @ e)
        r = r + h2 @ h2.T / epsilon
    x = gains[1] @ x
    c, r = c[rows], r[np.ix_(rows, rows)]
    k = np.linalg.solve(c @ p @ c.T + r, c @ p).T
    gains[2][:, rows] = k
    joseph = unit - k @ c
    return x + k @ (y[rows] - c @ x), joseph @ p @ joseph.T + k @ r @ k.T, gains


def cylinder_slope(x: Array, u: Array, p: Array) -> Array:
    """Derivative of `cylinder.f` by hand, for positions within the stroke."""
    m, b, aa, ab, va0, vb0, stroke, bulk, cs, ki, kea, keb = p[:12]
    va, vb, ps, pt = va0 + aa * x[0], vb0 + ab * (stroke - x[0]), u[1] / 1e6, u[2] / 1e6

    def root(drop: float) -> tuple[float, float]:
        """drop / (drop^2 + s^2)^(1/4) and its derivative."""
        square = drop**2 + 1e-6
        return drop / square**0.25, square**-0.25 - 0.5 * drop**2 * square**-1.25

    c = cs * 1e3 * u[0]
    (ra, da), (rb, db) = (root(ps - x[2]), root(x[3] - pt)) if u[0] >= 0 else (root(x[2] - pt), root(ps - x[3]))
    da, db = (-da, db) if u[0] >= 0 else (da, -db)
    rate_a = c * ra - aa * x[1] - 1e6 * (ki * (x[2] - x[3]) + kea * (x[2] - p[12] / 1e6))
    rate_b = -c * rb + ab * x[1] + 1e6 * (ki * (x[2] - x[3]) - keb * (x[3] - p[12] / 1e6))
    slope = np.zeros((4, 4))
    slope[0, 1] = 1.0
    slope[1, 1:] = -b / m, aa * 1e6 / m, -ab * 1e6 / m
    slope[2] = bulk / 1e6 / va * np.array([-rate_a * aa / va, -aa, c * da - 1e6 * (ki + kea), 1e6 * ki])
    slope[3] = bulk / 1e6 / vb * np.array([rate_b * ab / vb, ab, 1e6 * ki, -c * db - 1e6 * (ki + keb)])
    return slope


def rk4_slope(f: Callable[..., None], slope: Callable[..., Array], x: Array, u: Array, p: Array, dt: float) -> Array:
    """Jacobian of `rk4` by the chain rule, from the Jacobian of f."""
    unit, k, dk = np.eye(len(x)), np.zeros(len(x)), np.zeros((len(x), len(x)))
    total = np.zeros_like(dk)
    for weight, share in ((1, 0.0), (2, 0.5), (2, 0.5), (1, 1.0)):
        z = x + share * dt * k
        dk = slope(z, u, p) @ (unit + share * dt * dk)
        f(z, u, p, k)
        total += weight * dk
    return unit + dt / 6 * total


def extended(
    move: Callable[[Array], tuple[Array, Array]], see: Callable[[Array], tuple[Array, Array]], q: Array, r: Array,
    x: Array, p: Array, y: Array, gain: float = 0.0,
) -> tuple[Array, Array, Array, Array, tuple[bool, bool]]:  # fmt: skip
    """One step of the textbook extended Kalman filter; `move` and `see` return value and Jacobian. With a gain, Q and R
    move by Sage and Husa's formulas as P1 and P3 print them. x, P, Q, R, and whether eq. 19 stood in for Q, for R."""
    x, slope = move(x)
    spread = slope @ p @ slope.T
    p = spread + q
    seen, c = see(x)
    rows = ~np.isnan(y)
    if not rows.any():
        return x, p, q, r, (False, False)
    e, c_all, r_all = y[rows] - seen[rows], c, r
    c, r = c[rows], r[np.ix_(rows, rows)]
    s = c @ p @ c.T + r
    k = np.linalg.solve(s, c @ p).T
    spread_y = c @ p @ c.T
    joseph = np.eye(len(x)) - k @ c
    x, p = x + k @ e, joseph @ p @ joseph.T + k @ r @ k.T
    if gain == 0.0 or not rows.all():
        return x, p, q, r_all, (False, False)
    new_r = (1 - gain) * r + gain * (np.outer(e, e) - spread_y)
    new_q = (1 - gain) * q + gain * (k @ np.outer(e, e) @ k.T + p - spread)
    failed = tuple(bool(np.linalg.eigvalsh(new)[0] <= 0) for new in (new_q, new_r))
    if failed[0]:
        new_q = q + gain * spread
    if failed[1]:
        new_r = r + gain * (c_all @ (spread + q) @ c_all.T)
    return x, p, new_q, new_r, (failed[0], failed[1])
