"""One compiled step of the square-root unscented Kalman filter, array form.

Two QR decompositions per step, no Cholesky update or downdate (P1 algorithm 1 in the form of Arasaratnam & Haykin):

    S-  = tria [ sqrt(w) (X - x-)   S_q ]
    tria [ sqrt(w) (Y - y)   S_r ]  =  [ S_y       0  ]
         [ sqrt(w) (X - x-)   0  ]     [ K S_y     S+ ]

with the points X drawn again from (x-, S-), and each output Y paired with the point it was computed from
(docs/errata.md). Everything is computed in scratch and committed at the end, so that a step that fails leaves the
estimate as it was. The sizes are constants of the compiled step,
so that the compiler unrolls the loops.
"""

from math import isfinite, isinf, isnan, log, pi, sqrt
from typing import Any, Final

import numpy as np
from numba import njit, types
from numba.extending import register_jitable
from numpy.typing import NDArray

from servohil.estimators.health import (
    DIVERGED,
    GATE_PATIENCE,
    GATED,
    MISSING,
    NOT_FINITE_INPUT,
    OK,
    REPAIRED,
    WRONG_SIZE,
)
from servohil.estimators.sigma_points import draw, mean
from servohil.estimators.srukf_layout import COUNTERS, arena_offsets, work_offsets
from servohil.estimators.triangularise import solve_transposed, triangularise

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Above this an entry of the factor would overflow when squared.
LARGEST: Final = 1e150
# Innovations beyond 1e15 standard deviations: x + K e would keep no digit of x.
LARGEST_NIS: Final = 1e30
# Below this a standard deviation of an innovation is no number to divide by.
SMALLEST_STD: Final = 1e-150


@register_jitable
def _within(vector: Vector) -> bool:
    good = True
    for value in vector:
        good = good and abs(value) < LARGEST  # False for NaN
    return good


# The model: `Model.specialise` compiles `step` with its functions and sizes in place of these.
f: Any = None
h: Any = None
integrate: Any = None
N: int = 0
M: int = 0
N_U: int = 0
DT: float = 0.0
SUBSTEPS: int = 0


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, then correct with y; NaN in y deletes the channel. Returns the status.

    Args:
        arena, work: see `srukf_layout.py`.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = N
    m = M
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, a_loglik, a_counters, _ = arena_offsets(n, m)
    w_constants, w_gate, w_x, w_factor, w_points, w_outputs, w_stack, w_stages, w_y, w_e, w_scratch, w_end = (
        work_offsets(n, m)
    )
    counters = arena[a_counters : a_counters + COUNTERS]
    counters[0] += 1.0
    counters[6] += 1.0
    usable = True
    for value in u:
        usable = usable and isfinite(value)
    present = 0
    for value in y:
        usable = usable and not isinf(value)
        if not isnan(value):
            present += 1
    if not usable:
        counters[4] += 1.0
        return NOT_FINITE_INPUT

    points_n = 2 * n + 1
    spread = work[w_constants]
    root_centre = work[w_constants + 1]
    outer = work[w_constants + 2]
    root_outer = sqrt(outer)
    x = work[w_x : w_x + n]
    factor = work[w_factor:w_points].reshape((n, n))
    points = work[w_points:w_outputs].reshape((points_n, n))
    outputs = work[w_outputs:w_stack].reshape((points_n, m))
    stack = work[w_stack:w_stages].reshape((points_n + max(n, m), n + m))
    stages = work[w_stages:w_y].reshape((5, n))
    mean_y = work[w_y:w_e]
    e = work[w_e:w_scratch]
    scratch = work[w_scratch:w_end]
    last_factor = arena[a_factor:a_q].reshape((n, n))
    q = arena[a_q:a_r].reshape((n, n))
    r = arena[a_r:a_innovation].reshape((m, m))

    # Predict.
    draw(arena[a_x : a_x + n], last_factor, spread, n, points)
    for i in range(points_n):
        integrate(f, n, DT, SUBSTEPS, points[i], u, p, stages)
    mean(points, points_n, n, outer, x)
    for i in range(points_n):
        root = root_centre if i == 0 else root_outer
        for j in range(n):
            stack[i, j] = root * (points[i, j] - x[j])
    for i in range(n):
        for j in range(n):
            stack[points_n + i, j] = q[i, j]
    triangularise(stack, points_n + n, n, scratch)
    for i in range(n):
        for j in range(n):
            factor[i, j] = stack[i, j] if j >= i else 0.0
    if not (_within(x) and _within(work[w_factor:w_points])):
        counters[5] += 1.0
        return DIVERGED

    # Predict the measurement, with its covariance for all channels: a monitor wants it for the missing ones too.
    draw(x, factor, spread, n, points)
    for i in range(points_n):
        h(points[i], u, p, outputs[i])
    mean(outputs, points_n, m, outer, mean_y)
    s = arena[a_s:a_nis].reshape((m, m))
    columns = 0
    for c in range(m):
        for d in range(c + 1):
            total = 0.0
            for i in range(1, points_n):
                total += (outputs[i, c] - mean_y[c]) * (outputs[i, d] - mean_y[d])
            total *= outer
            total += root_centre * root_centre * (outputs[0, c] - mean_y[c]) * (outputs[0, d] - mean_y[d])
            for i in range(m):
                total += r[i, c] * r[i, d]
            s[c, d] = total
            s[d, c] = total
        arena[a_innovation + c] = y[c] - mean_y[c]
        if not isnan(y[c]):
            e[columns] = y[c] - mean_y[c]
            for i in range(points_n):
                stack[i, columns] = (root_centre if i == 0 else root_outer) * (outputs[i, c] - mean_y[c])
            for i in range(m):
                stack[points_n + i, columns] = r[i, c]
            columns += 1

    # Correct.
    for i in range(points_n):
        root = root_centre if i == 0 else root_outer
        for j in range(n):
            stack[i, present + j] = root * (points[i, j] - x[j])
    for i in range(m):
        for j in range(n):
            stack[points_n + i, present + j] = 0.0
    status = OK
    nis = 0.0
    loglik = 0.0
    if present < m:
        status |= MISSING
        counters[1] += 1.0
    if present > 0:
        triangularise(stack, points_n + m, present + n, scratch)
        solvable = True
        for c in range(present):
            solvable = solvable and stack[c, c] > SMALLEST_STD
            loglik -= log(max(stack[c, c], SMALLEST_STD))
        solve_transposed(stack, present, e)
        for c in range(present):
            nis += e[c] * e[c]
        loglik -= 0.5 * (nis + present * log(2.0 * pi))
        for j in range(n):
            scratch[j] = x[j]
            for c in range(present):
                scratch[j] += stack[c, present + j] * e[c]
        solvable = solvable and nis < LARGEST_NIS and _within(scratch[:n])
        for i in range(n):
            solvable = solvable and _within(stack[present + i, present + i : present + n])
        if not solvable:
            status |= REPAIRED
            counters[3] += 1.0
            nis = 0.0
            loglik = 0.0
        shut = solvable and nis > work[w_gate + present - 1]
        counters[7] = counters[7] + 1.0 if shut else (counters[7] if not solvable else 0.0)
        if shut and counters[7] <= GATE_PATIENCE:
            status |= GATED
            counters[2] += 1.0
        elif solvable:
            if shut:  # refused for so long that the estimate must be wrong, not the sensors
                status |= REPAIRED
                counters[3] += 1.0
            for i in range(n):
                x[i] = scratch[i]
                for j in range(n):
                    factor[i, j] = stack[present + i, present + j] if j >= i else 0.0
            if present == m and not shut:
                counters[6] = 0.0

    for i in range(n):
        arena[a_x + i] = x[i]
    for i in range(n * n):
        arena[a_factor + i] = work[w_factor + i]
    arena[a_nis] = nis
    arena[a_loglik] = loglik
    return status


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
