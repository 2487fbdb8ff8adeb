"""What all filters share: arguments and their checks, the arena, fields to read, step, run and reset.

A filter is a compiled step with one signature, (arena, work, p, u, y) -> status, and this object around it.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.covariance import checked_factor, lower_factor
from servohil.estimators.gate import gate_limits
from servohil.estimators.health import DIVERGED, Health
from servohil.estimators.model import VECTOR, Model
from servohil.estimators.trajectory import Trajectory, noise_factors, run

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class FilterError(ValueError):
    """A filter was refused; the message names the argument, its value and the rule."""


SIGNATURE: Final = f"i8({', '.join([VECTOR] * 5)})"


class Filter:
    """A filter with additive noise around a model; not for use by itself.

    One `step` predicts from the last estimate with u over the past period and corrects with y at its end; (x0, P0) is
    the estimate before the first prediction. Q and R are covariances per step. A subclass calls `_build` once.

    Args:
        model: the process model.
        x0: (n,) estimate.
        P0: (n, n) its covariance, positive definite.
        Q: (n, n) process noise per step, positive semidefinite.
        R: (m, m) measurement noise, positive semidefinite.
        chol_Q: any factor F (n, q) with F F' = Q, instead of Q.
        chol_R: any factor of R (m, any), instead of R.
        gate: probability with which a consistent innovation passes the chi-square gate, e.g. 0.9999; None: no gate.
        arena: float64 array to live in, e.g. a view of a larger one; it is overwritten.
        own_size: float64 words that the filter keeps behind the common part of the arena.

    Raises:
        ValueError: an argument was refused; the message names it, its value and the rule.
    """

    def __init__(
        self,
        model: Model,
        x0: ArrayLike,
        P0: ArrayLike,
        Q: ArrayLike | None,
        R: ArrayLike | None,
        *,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
        own_size: int = 0,
    ) -> None:
        if not isinstance(model, Model):
            raise FilterError(f"model = {model!r}: must be a Model")
        n, m = model.n, model.m
        self.model = model
        self.gate = gate
        self._gate_limits = gate_limits(gate, m)
        self._x0 = state_vector("x0", x0, n)
        self._factor0 = lower_factor("P0", P0, n, definite=True)
        factor_q = noise_factor("Q", Q, chol_Q, n)
        factor_r = noise_factor("R", R, chol_R, m)
        start = arena_offsets(n, m)
        size = start[-1] + own_size
        self.arena = np.zeros(size) if arena is None else _arena(arena, size)
        self._x = self.arena[start[0] : start[1]]
        self._factor = self.arena[start[1] : start[2]].reshape(n, n)
        self._q = self.arena[start[2] : start[3]].reshape(n, n)
        self._r = self.arena[start[3] : start[4]].reshape(m, m)
        self._innovation = self.arena[start[4] : start[5]]
        self._s = self.arena[start[5] : start[6]].reshape(m, m)
        self._scores = self.arena[start[6] : start[8]]
        self._counters = self.arena[start[8] : start[8] + COUNTERS]
        self._own = self.arena[start[9] :]
        self._q[:] = factor_q.T
        self._r[:] = factor_r.T

    def _build(self, kernel: Callable[..., int], work: Vector, **values: Any) -> None:
        """Compile the kernel for the model (`Model.specialise`), and start from (x0, P0)."""
        self._work = work
        self._step = self.model.specialise(kernel, SIGNATURE, **values)
        self.reset()

    def step(self, u: Vector, y: Vector) -> int:
        """Predict with u (n_u,) over the past period, correct with y (m,), NaN = missing. Returns `Status` bits.

        Never raises for values; float64 C-contiguous arrays are fastest, others are converted.

        Raises:
            FilterError: u or y has the wrong length (a programming error, not bad data).
        """
        try:
            status: int = self._step(self.arena, self._work, self.model.p, u, y)
        except Exception as error:
            status = self._step_slowly(u, y, error)
        if status < 0:
            raise FilterError(
                f"u has shape {np.shape(u)}, y has shape {np.shape(y)}: must be ({self.model.n_u},), ({self.model.m},)"
            )
        return status

    def _step_slowly(self, u: ArrayLike, y: ArrayLike, error: Exception) -> int:
        """After an exception: arrays of another type, or a model function that raised."""
        u, y = np.array(u, dtype=np.float64), np.array(y, dtype=np.float64)
        if u.ndim != 1 or y.ndim != 1:
            return -1
        if isinstance(error, TypeError):
            try:
                return int(self._step(self.arena, self._work, self.model.p, u, y))
            except Exception:
                pass
        # The step commits at its end: an exception on the way has left the estimate alone.
        self._counters[N_DIVERGED] += 1.0
        return DIVERGED

    def run(self, U: ArrayLike, Y: ArrayLike, Q: ArrayLike | None = None, R: ArrayLike | None = None) -> Trajectory:
        """`step` for every row of U (N, n_u) and Y (N, m), looping in compiled code.

        Q (N, n, n) and R (N, m, m), if given, are set before each step; the last ones stay.

        Raises:
            ValueError: wrong shape of U, Y, Q or R, or a matrix among them that is not positive semidefinite.
        """
        inputs = np.array(U, dtype=np.float64, order="C", ndmin=1)
        outputs = np.array(Y, dtype=np.float64, order="C", ndmin=1)
        count, n, m = len(inputs), self.model.n, self.model.m
        if inputs.shape != (count, self.model.n_u) or outputs.shape != (count, m):
            raise FilterError(
                f"U has shape {inputs.shape}, Y has shape {outputs.shape}: must be (N, {self.model.n_u}), (N, {m})"
            )
        q, r = noise_factors("Q", Q, count, n), noise_factors("R", R, count, m)
        x, factor, innovation = np.empty((count, n)), np.empty((count, n * n)), np.empty((count, m))
        nis, status = np.empty(count), np.empty(count, dtype=np.int64)
        before = self.arena.copy()
        try:
            p, arena = self.model.p, self.arena
            run(self._step, arena, self._work, p, inputs, outputs, q, r, x, factor, innovation, nis, status)
        except Exception:  # a model function raised somewhere: `step` knows what to do with it
            self.arena[:] = before
            for k in range(count):
                if len(q):
                    self._q[:] = q[k].reshape(n, n)
                if len(r):
                    self._r[:] = r[k].reshape(m, m)
                status[k] = self.step(inputs[k], outputs[k])
                x[k], factor[k], innovation[k], nis[k] = self._x, self._factor.ravel(), self._innovation, self.nis
        upper = factor.reshape(count, n, n)
        return Trajectory(x, upper.transpose(0, 2, 1) @ upper, innovation, nis, status)

    def reset(self, x0: ArrayLike | None = None, P0: ArrayLike | None = None) -> None:
        """Start again from x0 and P0, or from those of the constructor; Q, R and all settings stay.

        Raises:
            ValueError: as the constructor.
        """
        x = self._x0 if x0 is None else state_vector("x0", x0, self.model.n)
        factor = self._factor0 if P0 is None else lower_factor("P0", P0, self.model.n, definite=True)
        self._x[:] = x
        self._factor[:] = factor.T
        self._innovation[:] = 0.0
        self._s[:] = 0.0
        self._scores[:] = 0.0
        self._counters[:] = 0.0
        self._reset_own()

    def _reset_own(self) -> None:
        """Bring `_own` to its start."""
        self._own[:] = 0.0

    @property
    def x(self) -> Vector:
        """(n,) estimate. A copy, as all fields."""
        return self._x.copy()

    @property
    def chol_P(self) -> Matrix:
        """(n, n) lower factor of P, diagonal >= 0."""
        return self._factor.T.copy()

    @property
    def P(self) -> Matrix:
        """(n, n) covariance of the estimate."""
        return self._factor.T @ self._factor

    @property
    def S(self) -> Matrix:
        """(m, m) innovation covariance of the last step, all channels, also missing ones."""
        return self._s.copy()

    @property
    def innovation(self) -> Vector:
        """(m,) measured - predicted of the last step, NaN where the channel was missing."""
        return self._innovation.copy()

    @property
    def nis(self) -> float:
        """Normalised innovation squared over the channels present; 0 with none and where it is meaningless."""
        return float(self._scores[0])

    @property
    def loglik(self) -> float:
        """Log-likelihood of the last measurement."""
        return float(self._scores[1])

    @property
    def health(self) -> Health:
        """Counters since the last reset."""
        return Health(*(int(c) for c in self._counters))

    @property
    def Q(self) -> Matrix:
        """(n, n) process noise per step; settable."""
        return self._q.T @ self._q

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        self._q[:] = lower_factor("Q", value, self.model.n, definite=False).T

    @property
    def R(self) -> Matrix:
        """(m, m) measurement noise; settable."""
        return self._r.T @ self._r

    @R.setter
    def R(self, value: ArrayLike) -> None:
        self._r[:] = lower_factor("R", value, self.model.m, definite=False).T


def state_vector(name: str, value: ArrayLike, n: int) -> Vector:
    """(n,) finite float64 copy.

    Raises:
        FilterError: wrong shape or not finite; names the argument.
    """
    try:
        vector = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FilterError(f"{name} = {value!r}: must be ({n},) numbers") from error
    if vector.shape != (n,):
        raise FilterError(f"{name} has shape {vector.shape}: must be ({n},)")
    if not np.isfinite(vector).all():
        raise FilterError(f"{name} = {vector}: must be finite")
    return vector


def noise_factor(name: str, value: ArrayLike | None, factor: ArrayLike | None, size: int) -> Matrix:
    """(size, size) lower factor of a noise covariance given as itself or by a factor.

    Raises:
        ValueError: both or neither given, or the one given is refused.
    """
    if (value is None) == (factor is None):
        given = "neither" if value is None else "both"
        raise FilterError(f"{name} and chol_{name}: {given} given, exactly one is needed")
    if factor is not None:
        return checked_factor(f"chol_{name}", factor, size)
    assert value is not None
    return lower_factor(name, value, size, definite=False)


def _arena(arena: Vector, size: int) -> Vector:
    if (
        not isinstance(arena, np.ndarray)
        or arena.dtype != np.float64
        or arena.shape != (size,)
        or not (arena.flags.c_contiguous and arena.flags.writeable and arena.flags.aligned)
    ):
        what = f"{arena.dtype} {arena.shape}" if isinstance(arena, np.ndarray) else repr(arena)
        raise FilterError(f"arena = {what}: must be a contiguous, writable, aligned float64 array of shape ({size},)")
    return arena
