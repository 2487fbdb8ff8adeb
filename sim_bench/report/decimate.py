"""Fewer points for a plot without losing a peak."""

import numpy as np
from numpy.typing import NDArray


def min_max(
    t: NDArray[np.float64], y: NDArray[np.float64], buckets: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The least and the largest sample of each of `buckets` equal runs of samples, in the order in which they came.

    Samples that are not finite are passed over; a bucket with none left becomes one NaN, a gap in the line.

    Args:
        t: (N,) ascending.
        y: (N,).
        buckets: > 0; up to 2 * buckets samples pass unchanged.

    Returns:
        (t, y) of at most 2 * buckets points each.
    """
    if len(y) <= 2 * buckets:
        return t, np.where(np.isfinite(y), y, np.nan)
    size = -(-len(y) // buckets)
    padding = -len(y) % size
    padded = np.concatenate((np.where(np.isfinite(y), y, np.nan), np.full(padding, np.nan))).reshape(-1, size)
    low = np.argmin(np.where(np.isnan(padded), np.inf, padded), axis=1)
    high = np.argmax(np.where(np.isnan(padded), -np.inf, padded), axis=1)
    first = np.arange(len(padded)) * size
    rows = np.column_stack((first + np.minimum(low, high), first + np.maximum(low, high))).ravel()
    rows = rows[np.concatenate(([True], np.diff(rows) > 0))]  # least and largest are one sample where y is constant
    return t[rows], padded.ravel()[rows]


def log_edges(values: NDArray[np.float64], per_decade: int) -> NDArray[np.float64]:
    """Edges of histogram bins of equal width on a logarithmic axis, whole decades divided into `per_decade`.

    Args:
        values: (N,) > 0, N >= 1.
        per_decade: bins per decade.

    Returns:
        Ascending edges that enclose all values; at least two.
    """
    low = int(np.floor(np.log10(np.min(values)) * per_decade))
    high = int(np.ceil(np.log10(np.max(values)) * per_decade))
    edges: NDArray[np.float64] = 10.0 ** (np.arange(low - 1, high + 2) / per_decade)  # one spare bin: rounding
    return edges
