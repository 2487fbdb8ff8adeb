"""Robust Kalman filter for norm-bounded uncertainty (Xie, Soh & de Souza): the object around the compiled step."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter, FilterError
from servohil.estimators.linear.affine import affine_parts
from servohil.estimators.linear.linear_work import linear_work, linear_work_offsets
from servohil.estimators.linear.robust_step import ON_OUTPUT, ON_STATE, SIZE_I, SIZE_J, robust_work_offsets, step
from servohil.estimators.model import Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SMALLEST: Final = 1e-100  # epsilon; its reciprocal has to be a number


class RobustKF(Filter):
    """Robust Kalman filter, square-root array form (Xie, Soh & de Souza, IEEE TAC 39(6), 1994; recursive form).

    For x+ = (A + H1 F E) x + g(u) + w, y = (C + H2 F E) x + d(u) + v with an unknown F, F'F <= I, which may change from
    step to step. A and C come from the model, which must be affine in its state. `P` is an upper bound of the mean
    square error over all such F, proven while

        epsilon^-1 I > E X E'

    with X a bound of the second moment E[x x'] of the state, X+ = A (X^-1 - epsilon E'E)^-1 A' + epsilon^-1 H1 H1' + Q,
    and u = 0. Small values of epsilon add much noise (H1 H1' / epsilon), values near the limit much spread: the bound
    has a minimum in between. With H1 and H2 both the inequality is used twice per step, for a different F each time.
    Without uncertainty (E = 0, or H1 = H2 = 0) this is the Kalman filter.

    A motion driven by a known u is no part of the theory, but the uncertainty acts on it all the same. So in the loop X
    is taken as x x' + P from the estimate itself; where the condition fails a smaller epsilon is used for that step,
    and the step reports REPAIRED. For the bound to hold choose epsilon well below that: 0.25 / |E x|^2 of the motion to
    be covered was enough on the actuator of P2 with stiffness and damping off by 30 %.

    `S` and `nis` belong to the bound: a consistent innovation is smaller than they say.

    Args:
        H1: (n, i) how the uncertainty enters the state.
        H2: (m, i) how it enters the outputs; None: it does not.
        E: (j, n) which combinations of the state it acts on.
        epsilon: scaling parameter, > 0, in units of 1 / (E x)^2.

    Raises:
        ValueError: an argument was refused, or the model is not affine; the message names the argument or the element
            of f or h, its value and the rule.
    """

    def __init__(
        self,
        model: Model,
        x0: ArrayLike,
        P0: ArrayLike,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        *,
        H1: ArrayLike,
        E: ArrayLike,
        epsilon: float,
        H2: ArrayLike | None = None,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena)
        n, m = model.n, model.m
        on_state = _matrix("H1", H1, (n, None))
        i = on_state.shape[1]
        on_output = np.zeros((m, i)) if H2 is None else _matrix("H2", H2, (m, i))
        direction = _matrix("E", E, (None, n))
        j = len(direction)
        if not isinstance(epsilon, int | float) or not SMALLEST <= epsilon <= 1.0 / SMALLEST:
            raise FilterError(f"epsilon = {epsilon!r}: must be a number > 0, {SMALLEST} to {1.0 / SMALLEST}")
        self.epsilon = float(epsilon)
        self.F, self.H = affine_parts(model, np.linalg.norm(self._factor0, axis=1))
        w_state, w_output, w_x = linear_work_offsets(n, m, max(i, j))[1:4]
        w_epsilon, w_h1, w_h2, w_direction, w_wide, *_, size = robust_work_offsets(n, m, i, j)
        work = np.zeros(size)
        work[:w_epsilon] = linear_work(n, m, self._gate_limits, max(i, j))
        work[w_state:w_output] = self.F.T.ravel()
        work[w_output:w_x] = self.H.T.ravel()
        work[w_epsilon] = self.epsilon
        work[w_h1:w_h2] = on_state.T.ravel()
        work[w_h2:w_direction] = on_output.T.ravel()
        work[w_direction:w_wide] = direction.ravel()
        certain = not direction.any()
        work[SIZE_I], work[SIZE_J] = i, j
        work[ON_STATE] = on_state.any() and not certain
        work[ON_OUTPUT] = on_output.any() and not certain
        self._build(step, work)

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1]


def _matrix(name: str, value: ArrayLike, shape: tuple[int | None, int | None]) -> Matrix:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FilterError(f"{name} = {value!r}: must be a matrix of numbers") from error
    if (
        matrix.ndim != 2
        or 0 in matrix.shape
        or any(want not in (None, have) for have, want in zip(matrix.shape, shape, strict=True))
    ):
        rule = ", ".join("any" if want is None else str(want) for want in shape)
        raise FilterError(f"{name} has shape {matrix.shape}: must be ({rule})")
    bad = np.argwhere(~np.isfinite(matrix))
    if bad.size:
        row, column = (int(k) for k in bad[0])
        raise FilterError(f"{name}[{row}, {column}] = {matrix[row, column]!r}: must be finite")
    return matrix
