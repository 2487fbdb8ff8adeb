"""The septic blend from 0 to 1, its integrals, and the way from a measured position into a profile."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# The head of every profile vector: [kind, blend_s, numbers of the kind].
KIND, BLEND = 0, 1

SEPTIC_PEAK_SLOPE: Final = 35.0 / 16.0  # greatest d beta / d tau, at tau = 1/2
SEPTIC_PEAK_BEND: Final = 16.8 / 5.0**0.5  # greatest d2 beta / d tau2, at tau = (1 - 1 / sqrt 5) / 2


@njit(cache=True, nogil=True, error_model="numpy")
def septic(tau: float, duration_s: float) -> tuple[float, float, float, float]:
    """The blend 0 -> 1 at tau = t / duration_s and its three time derivatives (1/s, 1/s2, 1/s3)."""
    if tau <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if tau >= 1.0:
        return 1.0, 0.0, 0.0, 0.0
    rest = 1.0 - tau
    both = tau * rest
    value = tau**4 * (35.0 + tau * (-84.0 + tau * (70.0 - 20.0 * tau)))
    slope = 140.0 * both**3 / duration_s
    bend = 420.0 * both**2 * (1.0 - 2.0 * tau) / duration_s**2
    jerk = 840.0 * both * (1.0 - 5.0 * both) / duration_s**3
    return value, slope, bend, jerk


@njit(cache=True, nogil=True, error_model="numpy")
def septic_integrals(tau: float) -> tuple[float, float]:
    """The integral of the blend over tau from 0, and the integral of that; 0 <= tau <= 1. At 1: 1/2 and 5/36."""
    once = tau**5 * (7.0 + tau * (-14.0 + tau * (10.0 - 2.5 * tau)))
    twice = tau**6 * (7.0 / 6.0 + tau * (-2.0 + tau * (1.25 - tau * (2.5 / 9.0))))
    return once, twice


@njit(cache=True, nogil=True, error_model="numpy")
def blend_in(t_s: float, blend_s: float, start_m: float, out: Vector) -> None:
    """Turn out (4,), a profile g and its derivatives at t_s, into the reference entered at rest from `start_m`."""
    tau = t_s / blend_s
    if tau >= 1.0:
        return
    beta = septic(tau, blend_s)
    g0 = out[0] - start_m
    g1, g2, g3 = out[1], out[2], out[3]
    # Leibniz: (beta g)''' = beta g''' + 3 beta' g'' + 3 beta'' g' + beta''' g
    out[0] = start_m + beta[0] * g0
    out[1] = beta[0] * g1 + beta[1] * g0
    out[2] = beta[0] * g2 + 2.0 * beta[1] * g1 + beta[2] * g0
    out[3] = beta[0] * g3 + 3.0 * (beta[1] * g2 + beta[2] * g1) + beta[3] * g0
