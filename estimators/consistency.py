"""Does a filter's error have the size that the filter claims: NEES, NIS, their chi-square intervals, and whiteness.

NEES = (x_true - x)' P^-1 (x_true - x) needs the truth, so a simulation; NIS = e' S^-1 e needs only the record. A filter
can have the right NIS and a wrong P (process and sensor noise both wrong, their sum right): only NEES tells.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT
from servohil.estimators.trajectory import Trajectory

Vector = NDArray[np.float64]


class ConsistencyError(ValueError):
    """An argument was refused; the message names it, its value and the rule."""


CONSISTENT: Final = "consistent"
OVERCONFIDENT: Final = "overconfident"  # errors larger than the filter claims
PESSIMISTIC: Final = "pessimistic"  # errors smaller than the filter claims


def nees(x_true: ArrayLike, x: ArrayLike, P: ArrayLike) -> Vector:
    """Normalised estimation error squared, (...), of x_true and x (..., n) with P (..., n, n).

    For angles pass the wrapped error as x_true and zeros as x.

    Raises:
        ConsistencyError: a P is not positive definite.
    """
    error = np.asarray(x_true, dtype=np.float64) - np.asarray(x, dtype=np.float64)
    covariance = np.asarray(P, dtype=np.float64)
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    try:
        if not (variance > 0.0).all():
            raise np.linalg.LinAlgError
        # In units of the claimed standard deviations: m^2 beside MPa^2 loses no digits.
        std = np.sqrt(variance)
        factor = np.linalg.cholesky(covariance / (std[..., :, None] * std[..., None, :]))
    except np.linalg.LinAlgError:
        raise ConsistencyError("P: every covariance must be positive definite") from None
    whitened = np.linalg.solve(factor, (error / std)[..., None])[..., 0]
    return np.asarray((whitened**2).sum(axis=-1))


class NisSums(NamedTuple):
    """Per step: normalised innovation squared, and its degrees of freedom, the channels present; 0, 0 where none."""

    nis: Vector  # (N,)
    freedom: NDArray[np.int64]  # (N,)


def nis(trajectory: Trajectory) -> NisSums:
    """NIS of a run with its degrees of freedom; both 0 in steps without an innovation of their own."""
    freedom = (~np.isnan(trajectory.innovation)).sum(axis=1)
    # A step that did nothing shows the innovation of the one before; a meaningless one has nis = 0.
    idle = (trajectory.status & (NOT_FINITE_INPUT | DIVERGED)) != 0
    freedom[idle | (trajectory.nis == 0.0)] = 0
    return NisSums(np.where(freedom > 0, trajectory.nis, 0.0), freedom)


def chi2_interval(dof: float, runs: int, probability: float, family: int = 1) -> tuple[float, float]:
    """Interval for the mean of `runs` independent chi-square variables of `dof` degrees of freedom.

    Args:
        dof: degrees of freedom of each; may be a mean, where they differ.
        runs: how many are averaged.
        probability: with which all intervals of the family hold together (Bonferroni), e.g. 0.999.
        family: number of intervals that are judged.

    Raises:
        ConsistencyError: dof or runs not > 0, family < 1, or no probability.
    """
    if not (dof > 0.0 and runs >= 1):
        raise ConsistencyError(f"dof = {dof!r}, runs = {runs!r}: must be > 0")
    tail = _tail(probability, family)
    from scipy.special import gammainccinv, gammaincinv  # here: scipy would double the import time of the package

    half = 0.5 * dof * runs
    return 2.0 * float(gammaincinv(half, tail)) / runs, 2.0 * float(gammainccinv(half, tail)) / runs


@dataclass(frozen=True)
class Consistency:
    """Means at T times over the runs, each with its interval; all intervals hold together with `probability`."""

    mean: Vector  # (T,)
    low: Vector  # (T,)
    high: Vector  # (T,)
    probability: float

    @property
    def verdict(self) -> str:
        """CONSISTENT, or by the worst violation OVERCONFIDENT or PESSIMISTIC."""
        with np.errstate(divide="ignore", invalid="ignore"):
            above, below = (self.mean / self.high).max(), (self.low / self.mean).max()
        if above <= 1.0 and below <= 1.0:  # False for NaN
            return CONSISTENT
        return PESSIMISTIC if below > above else OVERCONFIDENT

    @property
    def consistent(self) -> bool:
        """Every mean inside its interval."""
        return self.verdict == CONSISTENT


def consistency(values: ArrayLike, dof: ArrayLike, probability: float = 0.999) -> Consistency:
    """Judge NEES or NIS values against chi-square intervals, family-wise over the times.

    Args:
        values: (runs, T), independent from run to run. For NIS, whose steps are independent: all steps of all runs as
            rows of (N, 1).
        dof: degrees of freedom, one number or as many as values (see `nis`); a value with 0 counts for nothing.
        probability: with which a consistent filter passes.

    Raises:
        ConsistencyError: wrong shapes, a time without any value, or no probability.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.size == 0:
        raise ConsistencyError(f"values has shape {array.shape}: must be (runs, T)")
    try:
        freedom = np.broadcast_to(np.asarray(dof, dtype=np.float64), array.shape)
    except ValueError:
        raise ConsistencyError(f"dof has shape {np.shape(dof)}: must be one number or {array.shape}") from None
    used = (freedom > 0.0).sum(axis=0)
    if not used.all():
        raise ConsistencyError(f"values: time {int(np.argmin(used))} has no value with dof > 0")
    intervals = [
        chi2_interval(float(total) / int(runs), int(runs), probability, array.shape[1])
        for total, runs in zip(freedom.sum(axis=0), used, strict=True)
    ]
    low, high = np.array(intervals).T
    return Consistency(np.where(freedom > 0.0, array, 0.0).sum(axis=0) / used, low, high, probability)


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of innovations at lags 1 .. L, by channel, with the bounds that white ones keep."""

    autocorrelation: NDArray[np.float64]  # (L, m)
    bound: NDArray[np.float64]  # (L, m); pairs of missing samples widen it
    white: bool  # all within


def whiteness(innovation: ArrayLike, lags: int = 20, probability: float = 0.999) -> Whiteness:
    """Autocorrelation of innovations (N, m), NaN = missing, and whether all of it is what white noise shows.

    Args:
        innovation: `Trajectory.innovation`; where S changes much over the record, divided by its standard deviation.
        lags: 1 .. lags are judged.
        probability: with which a white sequence passes, family-wise over lags and channels.

    Raises:
        ConsistencyError: wrong shape, too few samples for the lags, or no probability.
    """
    e = np.asarray(innovation, dtype=np.float64)
    if e.ndim != 2 or not 1 <= lags < len(e):
        raise ConsistencyError(f"innovation has shape {e.shape}, lags = {lags!r}: must be (N, m), 1 <= lags < N")
    from scipy.special import ndtri

    present = ~np.isnan(e)
    e = np.where(present, e, 0.0)
    variance = (e**2).sum(axis=0) / np.maximum(present.sum(axis=0), 1)
    pairs = np.array([(present[lag:] & present[:-lag]).sum(axis=0) for lag in range(1, lags + 1)])
    if not pairs.all() or not variance.all():
        raise ConsistencyError("innovation: a channel has no samples at some lag, or is zero throughout")
    products = np.array([(e[lag:] * e[:-lag]).sum(axis=0) for lag in range(1, lags + 1)])
    autocorrelation = products / pairs / variance
    quantile = -float(ndtri(_tail(probability, autocorrelation.size)))
    bound = quantile / np.sqrt(pairs)
    return Whiteness(autocorrelation, bound, bool((np.abs(autocorrelation) <= bound).all()))


def _tail(probability: float, family: int) -> float:
    """Probability beyond one end of one interval of the family."""
    if not 0.0 < probability < 1.0:
        raise ConsistencyError(f"probability = {probability!r}: must lie between 0 and 1")
    if family < 1:
        raise ConsistencyError(f"family = {family!r}: must be >= 1")
    return (1.0 - probability) / 2.0 / family
