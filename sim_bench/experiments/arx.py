"""ARX(3, 2) with a constant, the linear reference of a recording, as a filter: both models predict by the same code."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import EKF, Model

Vector = NDArray[np.float64]

LAGS: Final = 3


def arx_coefficients(u: Vector, p: Vector) -> Vector:
    """(6,) a1, a2, a3, b1, b2, c of p[k] = a1 p[k-1] + a2 p[k-2] + a3 p[k-3] + b1 u[k-1] + b2 u[k-2] + c, by least
    squares from a record u, p (N,)."""
    rows = np.column_stack([p[2:-1], p[1:-2], p[:-3], u[2:-1], u[1:-2], np.ones(len(p) - LAGS)])
    return np.asarray(np.linalg.lstsq(rows, p[LAGS:], rcond=None)[0])


def _next(s: Vector, u: Vector, p: Vector, after: Vector) -> None:
    after[0] = p[0] * s[0] + p[1] * s[1] + p[2] * s[2] + p[3] * u[0] + p[4] * s[3] + p[5]
    after[1] = s[0]
    after[2] = s[1]
    after[3] = u[0]


def _newest(s: Vector, u: Vector, p: Vector, y: Vector) -> None:
    y[0] = s[0]


def arx(u: Vector, p: Vector) -> EKF:
    """The model fitted to a record u, p (N,), as a filter of (p[k], p[k-1], p[k-2], u[k-1]) whose input for sample k is
    u[k-1], and which believes every sample."""
    linear = Model(_next, _newest, 4, 1, arx_coefficients(u, p), 1.0, "discrete")
    return EKF(linear, np.zeros(4), np.eye(4), np.diag([1.0, 0.0, 0.0, 0.0]), [[0.0]])
