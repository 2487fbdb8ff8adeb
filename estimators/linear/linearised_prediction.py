"""Predict with both Jacobians of the model, up to the innovation: the first half of the filters of P2."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear.linear_update import predict_factor, stack_correction
from servohil.estimators.linear.linear_work import linear_work_offsets
from servohil.estimators.linear.linearise import output_jacobian, state_jacobian
from servohil.estimators.measurement_update import within

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, forceinline=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def predict_linearised(
    f: Any, h: Any, integrate: Any, subtract_x: Any, subtract_y: Any, n: int, m: int, dt: float, substeps: int,
    last_x: Vector, last_factor: Matrix, q: Matrix, r: Matrix, u: Vector, p: Vector, y: Vector, present: int,
    work: Vector, innovation: Vector, s: Matrix,
) -> bool:  # fmt: skip
    """Fill, in `work`, predicted x and factor, Jacobians, roots, stack and innovation. False: not finite.

    Args:
        f, h, integrate, subtract_x, subtract_y: compiled model functions.
        n, m, dt, substeps: of the model.
        last_x, last_factor: (n,), (n, n) estimate before.
        q, r: (n, n), (m, m) transposed lower factors of the noise.
        u, p: input and parameters.
        y: (m,) measurement, NaN = missing.
        present: channels present.
        work: see `linear_work.py`.
        innovation: (m,) filled, NaN where missing.
        s: (m, m) filled with the innovation covariance.
    """
    (
        _, w_state, w_output, w_x, w_factor, w_roots, w_stack, w_stages, w_steps, w_trial, w_outputs, w_difference,
        w_y, w_e, w_scratch, w_end,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    x = work[w_x:w_factor]
    factor = work[w_factor:w_roots].reshape((n, n))
    stack = work[w_stack:w_stages].reshape((n + max(n, m), n + m))
    stages = work[w_stages:w_steps].reshape((5, n))
    steps = work[w_steps:w_trial]
    trial = work[w_trial:w_outputs]
    difference = work[w_difference:w_y]
    predicted_y = work[w_y:w_e]
    jacobian = work[w_state:w_output].reshape((n, n))
    slopes = work[w_output:w_x].reshape((n, m))
    for i in range(n):
        x[i] = last_x[i]
    integrate(f, n, dt, substeps, x, u, p, stages)
    state_jacobian(
        f, integrate, subtract_x, n, dt, substeps, last_x, x, last_factor, u, p, jacobian, steps, trial, difference,
        stages,
    )  # fmt: skip
    good = predict_factor(last_factor, jacobian, q, n, n, stack, work[w_scratch:w_end], factor)
    if not (good and within(x)):
        return False
    h(x, u, p, predicted_y)
    output_jacobian(
        h, subtract_x, subtract_y, n, m, x, predicted_y, factor, u, p, slopes, steps, trial,
        work[w_outputs:w_difference], difference,
    )  # fmt: skip
    subtract_y(y, predicted_y, innovation)
    stack_correction(
        factor, slopes, r, m, n, m, y, innovation, present, work[w_roots:w_stack].reshape((n, m)), stack, s,
        work[w_e:w_scratch],
    )  # fmt: skip
    return True
