"""One sample period of a model, in place: Runge-Kutta 4, Euler, or a model that is discrete already.

All share one signature, so that a generated module picks one by name. `f` is a compiled function; these are compiled
together with it, never on their own. They move one state or many, one behind the other: with many, each stage is taken
by all before the next one begins, so that the processor works on several at once instead of waiting for one.
"""

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.views import vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

INTEGRATORS: Final = ("rk4", "euler", "discrete")
STAGES: Final = 5  # rows of scratch that every integrator may use


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def _slopes(f: Any, n: int, x: Vector, u: Vector, p: Vector, out: Vector) -> None:
    for i in range(x.shape[0] // n):
        f(vector_at(x, i * n, n), u, p, vector_at(out, i * n, n))


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def rk4(f: Any, n: int, dt: float, substeps: int, x: Vector, u: Vector, p: Vector, stages: Matrix) -> None:
    """Classical Runge-Kutta with u held over the period.

    Args:
        f: compiled f(x, u, p, dx).
        n: number of states.
        dt: sample period, s.
        substeps: equal steps within dt.
        x: (n,) or several (k n,), advanced in place.
        u: (n_u,) input over the period.
        p: parameters.
        stages: (STAGES, size of x) scratch.
    """
    step = dt / substeps
    size = x.shape[0]
    k1 = stages[0]
    k2 = stages[1]
    k3 = stages[2]
    k4 = stages[3]
    z = stages[4]
    for _ in range(substeps):
        _slopes(f, n, x, u, p, k1)
        for i in range(size):
            z[i] = x[i] + 0.5 * step * k1[i]
        _slopes(f, n, z, u, p, k2)
        for i in range(size):
            z[i] = x[i] + 0.5 * step * k2[i]
        _slopes(f, n, z, u, p, k3)
        for i in range(size):
            z[i] = x[i] + step * k3[i]
        _slopes(f, n, z, u, p, k4)
        for i in range(size):
            x[i] += step / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def euler(f: Any, n: int, dt: float, substeps: int, x: Vector, u: Vector, p: Vector, stages: Matrix) -> None:
    """Explicit Euler; arguments as `rk4`."""
    step = dt / substeps
    k1 = stages[0]
    for _ in range(substeps):
        _slopes(f, n, x, u, p, k1)
        for i in range(x.shape[0]):
            x[i] += step * k1[i]


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def discrete(f: Any, n: int, dt: float, substeps: int, x: Vector, u: Vector, p: Vector, stages: Matrix) -> None:
    """A model whose f fills the next state instead of the derivative, applied `substeps` times; dt is not used."""
    k1 = stages[0]
    for _ in range(substeps):
        _slopes(f, n, x, u, p, k1)
        for i in range(x.shape[0]):
            x[i] = k1[i]
