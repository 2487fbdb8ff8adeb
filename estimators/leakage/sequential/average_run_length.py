"""Average run length of the one-sided CUSUM on white Gaussian residuals of variance 1.

The sum is s <- max(s + z - k, 0) with reference value k, the alarm s >= h, the mean of z is `shift`; the run starts at
0. Siegmund's formula (Sequential Analysis, 1985, with his correction of the boundary) is within 1 % for long runs and k
up to 0.5; the Markov chain of Brook and Evans (Biometrika 1972) is exact but for its cells. Wald's sequential test that
starts again at 0 whenever it has accepted "no fault" is the same chain with a lower bound below 0.
"""

from math import ceil, exp, expm1, inf, log1p, sqrt
from typing import Final

import numpy as np

OVERSHOOT: Final = 1.166  # both boundaries: twice the mean overshoot 0.583 of a Gaussian walk without drift
LONGEST: Final = 1e34  # samples; beyond, what is cut off from the band shows, and Siegmund's formula stands in
BAND: Final = 12.5  # standard deviations of one sample; beyond is 4e-36
CELL: Final = 0.2  # width of the finer chain's cells, in standard deviations; see `markov_run_length`


def siegmund_run_length(shift: float, reference: float, threshold: float) -> float:
    """Siegmund's approximation of the average run length, samples; inf where it exceeds the numbers.

    Args:
        shift: mean of the residual.
        reference: k.
        threshold: h.
    """
    drift = shift - reference
    b = threshold + OVERSHOOT
    exponent = -2.0 * drift * b
    if exponent > 700.0:
        return inf
    if abs(exponent) < 1e-4:  # the limit, and its first term: the formula loses its digits
        return b * b * (1.0 + exponent / 3.0)
    return (exp(exponent) - 1.0 - exponent) / (2.0 * drift * drift)


def siegmund_threshold(samples: float, reference: float) -> float:
    """Threshold h of the one-sided CUSUM for an average run length without a shift, by Siegmund's formula."""
    from scipy.optimize import brentq  # here: scipy would double the import time of the package

    # e^y - 1 - y = 2 k^2 samples, y = 2 k b
    target = 2.0 * reference * reference * samples
    y = brentq(lambda y: expm1(y) - y - target, 0.0, min(sqrt(2.0 * target), log1p(target) + 2.0))
    return max(float(y) / (2.0 * reference) - OVERSHOOT, 0.0)


def markov_run_length(shift: float, reference: float, threshold: float, lower: float = 0.0) -> float:
    """Average run length by the Markov chain, samples.

    Two chains, one with cells twice as wide, are extrapolated: the error of either falls with the square of the width.

    Args:
        shift: mean of the residual.
        reference: k > 0.
        threshold: h > 0.
        lower: <= 0; the sum that falls below it goes on at 0. 0 is the CUSUM.
    """
    rough = siegmund_run_length(shift, reference, threshold)
    if rough > LONGEST:
        return rough
    cells = 2 * max(ceil((threshold - lower) / CELL / 2.0), 4)
    coarse, fine = (np.log(_chain(shift - reference, threshold, lower, n)) for n in (cells // 2, cells))
    return float(np.exp(fine + (fine - coarse) / 3.0))


def _chain(drift: float, threshold: float, lower: float, cells: int) -> float:
    """Mean steps to the alarm of the chain of 0 itself, where runs begin, and of equal cells of lower .. threshold.

    A cycle from 0 ends at 0 again or in an alarm (Page's and Wald's renewal argument): mean length of a cycle over the
    probability that it ends in an alarm. Nothing cancels, however rare the alarm.
    """
    from scipy.linalg import solve_banded
    from scipy.special import ndtr

    width = (threshold - lower) / cells
    middle = lower + width * (np.arange(cells) + 0.5)
    n = min(ceil((BAND + abs(drift)) / width), cells - 1)
    offset = np.arange(-n, n + 1)  # of the next cell from this one
    step = ndtr((offset + 0.5) * width - drift) - ndtr((offset - 0.5) * width - drift)
    # Row n + i - j of solve_banded holds entry (i, j): the offset j - i falls with the row.
    band = np.repeat(-step[::-1, None], cells, axis=1)
    band[n] += 1.0
    length, alarm = solve_banded((n, n), band, np.stack([np.ones(cells), ndtr(middle + drift - threshold)], axis=1)).T
    edges = lower + width * np.arange(cells + 1)
    first = np.diff(ndtr(edges - drift))
    return float((1.0 + first @ length) / (ndtr(drift - threshold) + first @ alarm))
