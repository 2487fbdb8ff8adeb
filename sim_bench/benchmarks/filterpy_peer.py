"""filterpy's unscented filter on the same problem; a development dependency, asked for when the benchmark runs."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.models import cylinder
from servohil.sim_bench.benchmarks.c_peer import PeerUnavailableError
from servohil.sim_bench.benchmarks.estimator_cases import Case

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def _runge_kutta(f: Any, x: Any, u: Any, p: Any, dt: float) -> list[float]:
    """Lists instead of arrays: Python is several times faster with them."""
    n = range(len(x))
    k1, k2, k3, k4 = ([0.0 for _ in n] for _ in range(4))
    f(x, u, p, k1)
    f([x[i] + 0.5 * dt * k1[i] for i in n], u, p, k2)
    f([x[i] + 0.5 * dt * k2[i] for i in n], u, p, k3)
    f([x[i] + dt * k3[i] for i in n], u, p, k4)
    return [x[i] + dt / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]) for i in n]


_f = njit(cylinder.f, error_model="numpy")


@njit
def _advance(x: Vector, u: Vector, p: Vector, dt: float) -> Vector:
    k1, k2, k3, k4 = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    _f(x, u, p, k1)
    _f(x + 0.5 * dt * k1, u, p, k2)
    _f(x + 0.5 * dt * k2, u, p, k3)
    _f(x + dt * k3, u, p, k4)
    return x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


class FilterpyPeer:
    """filterpy's UnscentedKalmanFilter on the cylinder with four states.

    Args:
        case: the cylinder with its own f and h.
        steps: how many of the case's steps to run.
        compiled: one compiled function moves a point; otherwise the model is plain Python.

    Raises:
        PeerUnavailableError: filterpy is not installed.
    """

    def __init__(self, case: Case, steps: int, *, compiled: bool) -> None:
        try:
            import filterpy.kalman
        except ImportError:
            raise PeerUnavailableError("filterpy is not installed") from None
        self._library = filterpy.kalman
        self._case = case
        p, dt = case.model.p, case.model.dt
        parameters = p.tolist()
        if compiled:
            self._move = lambda x, _, u: _advance(x, u, p, dt)
            self._inputs: Any = case.inputs[:steps]
        else:
            self._move = lambda x, _, u: _runge_kutta(cylinder.f, x.tolist(), u, parameters, dt)
            self._inputs = case.inputs[:steps].tolist()
        self.estimates: Matrix = np.empty((steps, case.model.n))  # of the last run
        self.prepare()

    def prepare(self) -> None:
        """Back to the start."""
        case, library = self._case, self._library
        points = library.MerweScaledSigmaPoints(case.model.n, 1.0, 2.0, 0.0)
        self._filter = library.UnscentedKalmanFilter(
            case.model.n, case.model.m, case.model.dt, hx=lambda x: x[[0, 2, 3]], fx=self._move, points=points
        )
        self._filter.x, self._filter.P, self._filter.Q, self._filter.R = case.x0.copy(), case.p0.copy(), case.q, case.r

    def run(self) -> None:
        """All steps."""
        for k, (u, y) in enumerate(zip(self._inputs, self._case.samples, strict=False)):
            self._filter.predict(u=u)
            self._filter.update(y)
            self.estimates[k] = self._filter.x
