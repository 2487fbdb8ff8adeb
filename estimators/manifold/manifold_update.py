"""Correction of the filters that steer the output error (SVSF, second-order filter), around their gain.

They remember the errors that their corrections left, e_z,k|k = z_k - h(x_k|k). A channel that is missing, or that the
gate refuses, is not corrected and is forgotten: it comes back as at the start. Hidden states are corrected only from
channels measured at both ends of the period (`luenberger.py`). Nothing is committed here.
"""

from math import isfinite, isnan
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from servohil.estimators.linear.joseph_update import correct_by_gain
from servohil.estimators.linear.linear_work import linear_work_offsets
from servohil.estimators.manifold.luenberger import hidden_errors, to_states, transform
from servohil.estimators.manifold.luenberger_work import SMOOTH_VARIABLE_STRUCTURE, luenberger_work_offsets
from servohil.estimators.manifold.second_order_gain import second_order_gain
from servohil.estimators.manifold.svsf_gain import svsf_gain

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@register_jitable
def memory_size(n: int, m: int) -> int:
    """Of e_k|k (m), e_k-1|k-1 (m), 1 where measured at k (m), hidden e_l,k-1|k-1 (n - m), 1 where those are known."""
    return 2 * m + n + 1


@njit(nogil=True, cache=True, error_model="numpy")
def steer(
    r: Matrix, memory: Vector, present: int, counters: Vector, work: Vector, innovation: Vector, s: Matrix,
    next_memory: Vector,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """Correct the prediction in `work`, and fill all of the next memory but e_k|k. Not inlined, and
    the sizes come with the arrays: compiled once for all models.

    Args:
        r: (m, m) transposed lower factor of R.
        memory: (memory_size,) left alone.
        present: channels present.
        counters: of the arena.
        work: see `luenberger_work.py`; x and factor are overwritten by the corrected ones.
        innovation: (m,) NaN where missing.
        s: (m, m) innovation covariance.
        next_memory: (memory_size,) filled.

    Returns:
        status, nis, log-likelihood, whether y was used.
    """
    m = r.shape[0]
    n = memory.shape[0] - memory_size(0, m)
    (
        w_gate, w_state, w_output, w_x, w_factor, w_roots, w_stack, w_stages, _, _, _, _, _, w_e, w_scratch, w_kind,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    (
        _, w_order, w_first, w_second, w_back, w_moved, w_phi, w_square, w_inverse, w_array, w_right, w_used, w_through,
        w_before, w_now, w_gain, w_change, w_state_gain, w_state_change, w_joseph, w_predicted, w_end,
    ) = luenberger_work_offsets(n, m)  # fmt: skip
    first = work[w_first:w_second]
    second = work[w_second:w_back]
    back = work[w_back:w_moved].reshape((n, n))
    phi = work[w_phi:w_square].reshape((n, n))
    through = work[w_through:w_before].reshape((n, m))
    before = work[w_before:w_now]
    now = work[w_now:w_gain]
    gain = work[w_gain:w_change].reshape((n, m))
    change = work[w_change:w_state_gain]
    state_gain = work[w_state_gain:w_state_change].reshape((n, m))
    state_change = work[w_state_change:w_joseph]
    for i in range(w_gain, w_joseph):
        work[i] = 0.0
    visible = False
    if transform(
        work[w_order:w_first], work[w_output:w_x].reshape((n, m)), work[w_state:w_output].reshape((n, n)), n, m,
        work[w_square:w_inverse].reshape((m, m)), work[w_inverse:w_array].reshape((m, m)), back,
        work[w_moved:w_phi].reshape((n, n)), phi,
    ):  # fmt: skip
        visible = hidden_errors(
            phi, n, m, innovation, memory[:m], memory[2 * m : 3 * m], work[w_array:w_right].reshape((m, n)),
            work[w_right:w_used].reshape((n, n)), work[w_used:w_through].reshape((n, m)), through, before, now,
        )  # fmt: skip
        if work[w_kind] == SMOOTH_VARIABLE_STRUCTURE:
            svsf_gain(first, second, phi, n, m, innovation, memory, visible, through, before, now, gain, change)
        else:
            second_order_gain(
                first, second, phi, n, m, innovation, s, memory, visible, through, before, now, gain, change
            )
        to_states(back, gain, change, n, m, state_gain, state_change)
    else:
        for j in range(n):
            state_change[j] = np.nan  # H1 is singular here: `correct_by_gain` leaves such a correction out
    status, nis, loglik, used = correct_by_gain(
        state_gain, state_change, work[w_roots:w_stack].reshape((n, m)), r,
        work[w_stack:w_stages].reshape((n + max(n, m), n + m)), work[w_joseph:w_predicted].reshape((n + m, n)),
        present, n, m, work[w_e:w_scratch], work[w_gate:w_state], counters, work[w_predicted:w_end],
        work[w_x:w_factor], work[w_factor:w_roots].reshape((n, n)), work[w_scratch:w_kind],
    )  # fmt: skip
    for c in range(m):
        next_memory[m + c] = memory[c] if memory[2 * m + c] > 0.0 else innovation[c]
    for j in range(n - m):
        next_memory[3 * m + j] = before[j] if used and visible else 0.0
    next_memory[2 * m + n] = 1.0 if used and visible else 0.0
    return status, nis, loglik, used


@njit(nogil=True, forceinline=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def remember(
    h: Any, subtract_y: Any, m: int, x: Vector, u: Vector, p: Vector, y: Vector, used: bool, outputs: Vector,
    next_memory: Vector,
) -> None:  # fmt: skip
    """Complete the next memory with e_k|k = z - h(x), and forget the channels that were not used.

    Args:
        h, subtract_y: compiled model functions.
        m: number of outputs.
        x: (n,) corrected.
        u, p: input and parameters.
        y: (m,) measurement, NaN = missing.
        used: what `steer` returned.
        outputs: (m,) scratch.
        next_memory: (memory_size,) completed.
    """
    h(x, u, p, outputs)
    subtract_y(y, outputs, next_memory[:m])
    for c in range(m):
        known = used and not isnan(y[c]) and isfinite(next_memory[c])
        next_memory[2 * m + c] = 1.0 if known else 0.0
        if not known:
            next_memory[c] = 0.0
            next_memory[m + c] = 0.0
