"""Predict and correct of the filters that steer the output error (SVSF, second-order filter), around their gain.

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

from servohil.estimators.joseph_update import correct_by_gain
from servohil.estimators.linear_work import linear_work_offsets
from servohil.estimators.linearised_prediction import predict_linearised
from servohil.estimators.luenberger import hidden_errors, to_states, transform
from servohil.estimators.luenberger_work import luenberger_work_offsets

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@register_jitable
def memory_size(n: int, m: int) -> int:
    """Of e_k|k (m), e_k-1|k-1 (m), 1 where measured at k (m), hidden e_l,k-1|k-1 (n - m), 1 where those are known."""
    return 2 * m + n + 1


@njit(nogil=True, forceinline=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def predict_and_steer(
    f: Any, h: Any, integrate: Any, subtract_x: Any, subtract_y: Any, fill_gain: Any, n: int, m: int, dt: float,
    substeps: int, last_x: Vector, last_factor: Matrix, q: Matrix, r: Matrix, memory: Vector, u: Vector, p: Vector,
    y: Vector, present: int, counters: Vector, work: Vector, innovation: Vector, s: Matrix, next_memory: Vector,
) -> tuple[bool, int, float, float, bool]:  # fmt: skip
    """Fill, in `work`, the corrected x and factor (`linear_work.py`), and the next memory.

    Args:
        f, h, integrate, subtract_x, subtract_y: compiled model functions.
        fill_gain: `svsf_gain` or `second_order_gain`.
        n, m, dt, substeps: of the model.
        last_x, last_factor: (n,), (n, n) estimate before.
        q, r: (n, n), (m, m) transposed lower factors of the noise.
        memory: (memory_size,) left alone.
        u, p: input and parameters.
        y: (m,) measurement, NaN = missing.
        present: channels present.
        counters: of the arena.
        work: see `luenberger_work.py`.
        innovation: (m,) filled, NaN where missing.
        s: (m, m) filled with the innovation covariance.
        next_memory: (memory_size,) filled.

    Returns:
        whether the prediction is finite (else nothing else is filled), status, nis, log-likelihood, whether y was used.
    """
    (
        w_gate, w_state, w_output, w_x, w_factor, w_roots, w_stack, w_stages, _, _, _, _, w_y, w_e, w_scratch, w_order,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    (
        _, w_first, w_second, w_back, w_moved, w_phi, w_square, w_inverse, w_array, w_right, w_used, w_through,
        w_before, w_now, w_gain, w_change, w_state_gain, w_state_change, w_joseph, w_predicted, w_end,
    ) = luenberger_work_offsets(n, m)  # fmt: skip
    if not predict_linearised(
        f, h, integrate, subtract_x, subtract_y, n, m, dt, substeps, last_x, last_factor, q, r, u, p, y, present, work,
        innovation, s,
    ):  # fmt: skip
        return False, 0, 0.0, 0.0, False
    x = work[w_x:w_factor]
    factor = work[w_factor:w_roots].reshape((n, n))
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
        fill_gain(
            work[w_first:w_second], work[w_second:w_back], phi, n, m, innovation, s, memory, visible, through, before,
            now, gain, change,
        )  # fmt: skip
        to_states(back, gain, change, n, m, state_gain, state_change)
    else:
        for j in range(n):
            state_change[j] = np.nan  # H1 is singular here: `correct_by_gain` leaves such a correction out
    status, nis, loglik, used = correct_by_gain(
        state_gain, state_change, work[w_roots:w_stack].reshape((n, m)), r,
        work[w_stack:w_stages].reshape((n + max(n, m), n + m)), work[w_joseph:w_predicted].reshape((n + m, n)),
        present, n, m, work[w_e:w_scratch], work[w_gate:w_state], counters, work[w_predicted:w_end], x, factor,
        work[w_scratch:w_order],
    )  # fmt: skip
    outputs = work[w_y:w_e]
    h(x, u, p, outputs)
    subtract_y(y, outputs, next_memory[:m])
    for c in range(m):
        known = used and not isnan(y[c]) and isfinite(next_memory[c])
        if not known:
            next_memory[c] = 0.0
        restarted = memory[2 * m + c] == 0.0
        next_memory[m + c] = (innovation[c] if restarted else memory[c]) if known else 0.0
        next_memory[2 * m + c] = 1.0 if known else 0.0
    for j in range(n - m):
        next_memory[3 * m + j] = before[j] if used and visible else 0.0
    next_memory[2 * m + n] = 1.0 if used and visible else 0.0
    return True, status, nis, loglik, used
