"""One cycle of the diagnosis: the twin filter, the signatures of all changes, and what follows from them.

LEARNING: how far everything is off, from healthy data. CALIBRATING: how white the innovations are. WATCHING: has
anything changed? PENDING: something has; what?
Work that belongs to a block is done at its end, the rest is spread over its cycles.
"""

from typing import Any, Final

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT
from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.corrected import correct
from servohil.estimators.leakage.episode import judge
from servohil.estimators.leakage.information import CYCLES, INFORMATION_SIZE, complete, observe
from servohil.estimators.leakage.learning import calibrate, learn
from servohil.estimators.leakage.levels import update_levels
from servohil.estimators.leakage.model_update import restart
from servohil.estimators.leakage.signature import N_PARAMETERS, N_U, SCRATCH_SIZE, M, N
from servohil.estimators.leakage.watching import keep, scan
from servohil.estimators.linear_algebra.views import vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
C = at.C

SIGNATURE: Final = f"i8({'f8[::1], ' * 8}f8[:, ::1], b1)"
STEP_TYPE: Final = types.FunctionType(types.int64(*[types.float64[::1]] * 8, types.float64[:, ::1], types.boolean))

# `Model.specialise` compiles `step` with the twin's step and `advance_signatures` of the same model in place of these.
twin_step: Any = None
signature_step: Any = None


def step(
    arena: Vector, work: Vector, settings: Vector, twin: Vector, twin_work: Vector, p: Vector, u: Vector, y: Vector,
    table: Matrix, judging: bool,
) -> int:  # fmt: skip
    """One cycle; returns the status of the twin's step.

    Args:
        arena, work, settings: see `layout`.
        twin, twin_work: arena and work of the filter.
        p: (14,) configured parameters.
        u: (3,) valve V, supply Pa, tank Pa.
        y: (3,) position m, pressures A and B MPa; NaN = missing.
        table: of `corrected.change_table`.
        judging: whether a law moves the piston; what is seen otherwise is not used.
    """
    effective_p = vector_at(work, at.W_PU, N_PARAMETERS)
    effective_u = vector_at(work, at.W_PU + N_PARAMETERS, N_U)
    effective_y = vector_at(work, at.W_Y, M)
    last_x = vector_at(work, at.W_LAST_X, N)
    white = vector_at(work, at.W_WHITE, M + M * C)
    x = vector_at(twin, arena_offsets(N, M)[0], N)
    for i in range(N_PARAMETERS):
        effective_p[i] = p[i]
    for i in range(M):
        effective_u[i], effective_y[i] = u[i], y[i]
    for i in range(N):
        last_x[i] = x[i]
    correct(table, vector_at(arena, at.KNOWN, C), last_x[1], effective_p, effective_u, effective_y)
    status = int(twin_step(twin, twin_work, effective_p, effective_u, effective_y))
    arena[at.CYCLES] += 1.0
    if status & NOT_FINITE_INPUT:
        arena[at.LAG_S] += settings[at.DT_S]
        return status
    channels = signature_step(
        vector_at(arena, at.SIGNATURES, C * N), white, vector_at(work, at.W_SIGNATURE, SCRATCH_SIZE), twin, last_x,
        vector_at(work, at.W_PU, N_PARAMETERS + N_U), table,
    )  # fmt: skip
    if status & DIVERGED or not _finite(arena, white):
        restart(arena)
        return status
    if not judging:
        arena[at.SETTLED] = 0.0
        arena[at.LAG_S] += settings[at.DT_S]  # things drift on while nobody looks
        return status
    if arena[at.SETTLED] < settings[at.SETTLE_STEPS]:
        arena[at.SETTLED] += 1.0
        arena[at.LAG_S] += settings[at.DT_S]
        return status
    block = vector_at(arena, at.BLOCK, INFORMATION_SIZE)
    observe(block, white, channels)
    arena[at.BLOCK_CYCLES] += 1.0
    if arena[at.BLOCK_CYCLES] >= settings[at.BLOCK_STEPS]:
        _end_block(arena, work, settings, twin, block)
        update_levels(arena, settings, p, x)
        for i in range(INFORMATION_SIZE):
            block[i] = 0.0
        arena[at.BLOCK_CYCLES] = 0.0
    elif arena[at.SCAN_AGE] >= 0.0:
        scan(arena, work, settings)
    return status


@njit(nogil=True, cache=True, error_model="numpy")
def _end_block(arena: Vector, work: Vector, settings: Vector, twin: Vector, block: Vector) -> None:
    complete(block)
    for i in range(CYCLES):  # noise is larger or smaller than configured: information is less or more
        block[i] /= arena[at.SCALE]
    if arena[at.MODE] == at.LEARNING:
        learn(arena, work, settings, twin)
    elif arena[at.MODE] == at.CALIBRATING:
        keep(arena, work, settings, twin)
        calibrate(arena, settings)
    elif arena[at.MODE] == at.WATCHING:
        keep(arena, work, settings, twin)
    else:
        judge(arena, work, settings, twin)


@njit(nogil=True, cache=True, error_model="numpy")
def _finite(arena: Vector, white: Vector) -> bool:
    """Whether signatures and whitened numbers are: a sum is not as soon as one of its terms is not."""
    total = 0.0
    for i in range(C * N):
        total += arena[at.SIGNATURES + i]
    for i in range(white.shape[0]):
        total += white[i] * white[i]
    return bool(np.isfinite(total))
