"""What `run` returns, and the compiled loop that fills it."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from servohil.estimators.arena import arena_offsets

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
    types.void(STEP_TYPE, *[types.float64[::1]] * 3, *[ROWS] * 5, types.float64[::1], types.int64[::1]),
    nogil=True,
    cache=True,
    error_model="numpy",
)
def run(
    compiled_step: Any, arena: Vector, work: Vector, p: Vector, U: Matrix, Y: Matrix,
    x: Matrix, factor: Matrix, innovation: Matrix, nis: Vector, status: NDArray[np.int64],
) -> None:  # fmt: skip
    """Call the step for every row of U and Y and record x (N, n), factor (N, n * n), innovation (N, m), nis and status.

    The step comes as a function pointer: this loop is compiled once for all models.
    """
    n = x.shape[1]
    m = Y.shape[1]
    a_x, a_factor, _, _, a_innovation, _, a_nis, _, _, _ = arena_offsets(n, m)
    for k in range(U.shape[0]):
        status[k] = compiled_step(arena, work, p, U[k], Y[k])
        for i in range(n):
            x[k, i] = arena[a_x + i]
        for i in range(n * n):
            factor[k, i] = arena[a_factor + i]
        for i in range(m):
            innovation[k, i] = arena[a_innovation + i]
        nis[k] = arena[a_nis]
