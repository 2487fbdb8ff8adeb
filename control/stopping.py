"""Come to rest smoothly: the reference of HOLD, from the position and velocity measured when it is entered.

The velocity falls by the septic blend of `references`: v = v0 (1 - beta(t / T)), so that acceleration and jerk begin
and end at zero; the way is v0 T / 2. A valve that is simply shut on a moving mass cavitates one chamber and overloads
the other.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.references.blend import septic

Vector = NDArray[np.float64]


@njit(cache=True, nogil=True)
def come_to_rest(t_s: float, start_m: float, start_mps: float, duration_s: float, out: Vector) -> None:
    """Fill out (4,) with position m, velocity m/s, acceleration m/s2 and jerk m/s3 at `t_s` after the start."""
    tau = min(max(t_s / duration_s, 0.0), 1.0)
    beta, slope, curvature, _ = septic(tau, duration_s)
    # The integral of beta over tau: 7 tau^5 - 14 tau^6 + 10 tau^7 - 2.5 tau^8.
    way = tau - tau**5 * (7.0 + tau * (-14.0 + tau * (10.0 - 2.5 * tau)))
    out[0] = start_m + start_mps * duration_s * way
    out[1] = start_mps * (1.0 - beta)
    out[2] = -start_mps * slope
    out[3] = -start_mps * curvature
