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
