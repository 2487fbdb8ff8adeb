"""What `run` returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Trajectory:
    """The filter after each of N steps."""

    x: NDArray[np.float64]  # (N, n)
    P: NDArray[np.float64]  # (N, n, n)
    innovation: NDArray[np.float64]  # (N, m), NaN where the channel was missing
    nis: NDArray[np.float64]  # (N,), degrees of freedom = channels present
    status: NDArray[np.int64]  # (N,), `health.Status` bits
