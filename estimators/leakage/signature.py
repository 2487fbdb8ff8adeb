"""What each change does to the innovations of a filter that does not know of it (Willsky and Jones 1976).

The signature of a change is how far the filter's estimate is off per unit of it: E, with E- = F(x + E, with the change)
- F(x) over a period, G = E- at the outputs (plus the change itself where it is one of a sensor), E = E- - K G. Nothing
is linearised by hand: the model runs once more per change. The filter takes part of every change for motion, and the
signature follows how it does.

Innovation and signatures come out whitened, by the Cholesky factor of the innovation covariance: z = sum_j g_j theta_j
+ white noise of unit variance, for a filter whose model and noise are right.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.integrate import STAGES
from servohil.estimators.leakage.changes import INPUT, N_CHANGES, OUTPUT, PARAMETER
from servohil.estimators.leakage.corrected import MOVES, PLACE, UNIT, WHEN, sharing
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

N: Final = 4
M: Final = 3

# `Model.specialise` compiles `advance_signatures` with the model's in place of these.
f: Any = None
integrate: Any = None
DT: float = 0.0
SUBSTEPS: int = 0

# Scratch: moved states, integrator stages, one p and one u.
POINTS: Final = N_CHANGES + 1
N_PARAMETERS: Final = 14
N_U: Final = 3
SCRATCH_SIZE: Final = POINTS * N + STAGES * N + N_PARAMETERS + N_U
SIGNATURE: Final = "i8(" + ", ".join(["f8[::1]"] * 6) + ", f8[:, ::1])"  # of the compiled function


def advance_signatures(
    signatures: Vector, out: Vector, scratch: Vector, filter_arena: Vector, last_x: Vector, pu: Vector, table: Matrix
) -> int:
    """One period: advances the signatures, returns how many channels were whitened into `out`.

    Args:
        signatures: (N_CHANGES * N,) E by rows, in place.
        out: (M + M * N_CHANGES,) filled with z (M,), then g (M, N_CHANGES); zero in missing channels.
        scratch: (SCRATCH_SIZE,).
        filter_arena: arena of the filter, after its step.
        last_x: (N,) its estimate before the step.
        pu: (14 + 3,) parameters, then input, that the step was made with.
        table: (N_CHANGES, 4) see `corrected.change_table`.
    """
    _, a_factor, _, a_r, a_innovation, a_s, _, _, _, _ = arena_offsets(N, M)
    points = matrix_at(scratch, 0, POINTS, N)
    stages = matrix_at(scratch, POINTS * N, STAGES, N)
    p = vector_at(scratch, POINTS * N + STAGES * N, N_PARAMETERS)
    u = vector_at(scratch, POINTS * N + STAGES * N + N_PARAMETERS, N_U)
    for i in range(N_PARAMETERS):
        p[i] = pu[i]
    for i in range(N_U):
        u[i] = pu[N_PARAMETERS + i]
    base = vector_at(points, N_CHANGES * N, N)
    for j in range(N_CHANGES, -1, -1):  # the model as it is comes first, the others are compared with it
        changed = j < N_CHANGES
        moved = vector_at(points, j * N, N)
        moves = int(table[j, MOVES]) if changed else OUTPUT
        place = int(table[j, PLACE]) if changed else 0
        amount = table[j, UNIT] * sharing(table[j, WHEN], last_x[1], pu[N_PARAMETERS]) if changed else 0.0
        for i in range(N):
            moved[i] = last_x[i] + (signatures[j * N + i] if changed else 0.0)
        if moves == PARAMETER:
            p[place] += amount
        elif moves == INPUT:
            u[place] += amount
        integrate(f, N, DT, SUBSTEPS, moved, u, p, stages)
        if moves == PARAMETER:
            p[place] = pu[place]
        elif moves == INPUT:
            u[place] = pu[N_PARAMETERS + place]
        if changed:
            for i in range(N):
                signatures[j * N + i] = moved[i] - base[i]
    # Whitening: S = L L', over the channels present.
    l00 = l10 = l11 = l20 = l21 = l22 = 0.0
    present = 0
    e0, e1, e2 = filter_arena[a_innovation], filter_arena[a_innovation + 1], filter_arena[a_innovation + 2]
    has0, has1, has2 = np.isfinite(e0), np.isfinite(e1), np.isfinite(e2)
    s = matrix_at(filter_arena, a_s, M, M)
    r = matrix_at(filter_arena, a_r, M, M)
    if has0:
        l00 = np.sqrt(s[0, 0])
        present += 1
    if has1:
        l10 = s[1, 0] / l00 if has0 else 0.0
        l11 = np.sqrt(s[1, 1] - l10 * l10)
        present += 1
    if has2:
        l20 = s[2, 0] / l00 if has0 else 0.0
        l21 = (s[2, 1] - l20 * l10) / l11 if has1 else 0.0
        l22 = np.sqrt(s[2, 2] - l20 * l20 - l21 * l21)
        present += 1
    z0 = e0 / l00 if has0 else 0.0
    z1 = (e1 - l10 * z0) / l11 if has1 else 0.0
    z2 = (e2 - l20 * z0 - l21 * z1) / l22 if has2 else 0.0
    if not np.isfinite(z0 + z1 + z2):
        present = 0
        z0 = z1 = z2 = 0.0
    out[0], out[1], out[2] = z0, z1, z2
    # K = P H' R^-1, by the covariance after the correction; the R of the filter is diagonal.
    factor = matrix_at(filter_arena, a_factor, N, N)
    for j in range(N_CHANGES):
        e_j = vector_at(signatures, j * N, N)
        d0 = e_j[0]
        d1 = e_j[2]
        d2 = e_j[3]
        if table[j, MOVES] > INPUT:
            place = int(table[j, PLACE])
            if place == 1:
                d1 += table[j, UNIT]
            else:
                d2 += table[j, UNIT]
        d0 = d0 if has0 else 0.0
        d1 = d1 if has1 else 0.0
        d2 = d2 if has2 else 0.0
        g0 = d0 / l00 if has0 else 0.0
        g1 = (d1 - l10 * g0) / l11 if has1 else 0.0
        g2 = (d2 - l20 * g0 - l21 * g1) / l22 if has2 else 0.0
        out[M + j] = g0
        out[M + N_CHANGES + j] = g1
        out[M + 2 * N_CHANGES + j] = g2
        w0 = d0 / (r[0, 0] * r[0, 0])
        w1 = d1 / (r[1, 1] * r[1, 1])
        w2 = d2 / (r[2, 2] * r[2, 2])
        # P H' w with P = F'F, F the transposed lower factor by rows
        for k in range(N):
            stages[0, k] = factor[k, 0] * w0 + factor[k, 2] * w1 + factor[k, 3] * w2
        for i in range(N):
            total = 0.0
            for k in range(N):
                total += factor[k, i] * stages[0, k]
            e_j[i] -= total
    return present
