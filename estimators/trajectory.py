"""What `run` returns, the compiled loop that fills it, and noise that changes from step to step."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit, types
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.covariance import CovarianceError, lower_factor

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """The filter after each of N steps."""

    x: NDArray[np.float64]  # (N, n)
    P: NDArray[np.float64]  # (N, n, n)
    innovation: NDArray[np.float64]  # (N, m), NaN where the channel was missing
    nis: NDArray[np.float64]  # (N,), degrees of freedom = channels present
    status: NDArray[np.int64]  # (N,), `health.Status` bits


STEP_TYPE: Final = types.FunctionType(types.int64(*[types.float64[::1]] * 5))
ROWS: Final = types.float64[:, ::1]


@njit(
    types.void(STEP_TYPE, *[types.float64[::1]] * 3, *[ROWS] * 7, types.float64[::1], types.int64[::1]),
    nogil=True,
    cache=True,
    error_model="numpy",
)
def run(
    compiled_step: Any, arena: Vector, work: Vector, p: Vector, U: Matrix, Y: Matrix, q: Matrix, r: Matrix,
    x: Matrix, factor: Matrix, innovation: Matrix, nis: Vector, status: NDArray[np.int64],
) -> None:  # fmt: skip
    """Call the step for every row of U and Y and record x (N, n), factor (N, n * n), innovation (N, m), nis and status.

    Before each step the rows of q (N, n * n) and r (N, m * m) become the factors of Q and R; without rows they stay.
    The step comes as a function pointer: this loop is compiled once for all models.
    """
    n = x.shape[1]
    m = Y.shape[1]
    a_x, a_factor, a_q, a_r, a_innovation, _, a_nis, _, _, _ = arena_offsets(n, m)
    for k in range(U.shape[0]):
        if q.shape[0] > 0:
            for i in range(n * n):
                arena[a_q + i] = q[k, i]
        if r.shape[0] > 0:
            for i in range(m * m):
                arena[a_r + i] = r[k, i]
        status[k] = compiled_step(arena, work, p, U[k], Y[k])
        for i in range(n):
            x[k, i] = arena[a_x + i]
        for i in range(n * n):
            factor[k, i] = arena[a_factor + i]
        for i in range(m):
            innovation[k, i] = arena[a_innovation + i]
        nis[k] = arena[a_nis]


def noise_factors(name: str, value: ArrayLike | None, count: int, size: int) -> Matrix:
    """(count, size * size) transposed lower factors of a stack of covariances (count, size, size); no rows for None.

    Raises:
        CovarianceError: wrong shape, or a matrix that is not positive semidefinite; names it by its step.
    """
    if value is None:
        return np.empty((0, size * size))
    stack = np.array(value, dtype=np.float64)
    if stack.shape != (count, size, size):
        raise CovarianceError(f"{name} has shape {stack.shape}: must be ({count}, {size}, {size}), one for each step")
    factors = np.empty((count, size * size))
    for k in range(count):
        same = k > 0 and np.array_equal(stack[k], stack[k - 1])
        factors[k] = factors[k - 1] if same else lower_factor(f"{name}[{k}]", stack[k], size, definite=False).T.ravel()
    return factors
