"""Noise and sensor faults for experiments, as functions of whole records: rows are steps, columns are channels.

Every function returns a new array, float64, and takes its random numbers from the generator given. Noise comes alone,
for the caller to add to states or samples; the faults change a record of samples. Values are in the unit of their
channel, variances in its square. A real sensor's order is noise, bias, quantisation, delay, loss.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]
Change = tuple[float, float, ArrayLike]  # from, to in s, both inclusive; variances (m,)


def scheduled(steps: int, dt_s: float, base: ArrayLike, changes: Sequence[Change] = ()) -> Matrix:
    """Variances (steps, m) of every step: `base`, and those of `changes` within their times (as P1, 3.1.3 and 3.2.3).

    Args:
        steps: N; step k is at k dt_s.
        dt_s: step size, s.
        base: variances (m,).
        changes: (from, to, variances), times in s and inclusive; where two overlap, the later in the list counts.

    Raises:
        ValueError: a variance is negative or not finite, a change has another size or ends before it begins.
    """
    if steps < 1 or not (np.isfinite(dt_s) and dt_s > 0.0):
        raise ValueError(f"steps = {steps}, dt_s = {dt_s}: both must be finite and > 0")
    usual = _at_least_zero("base", base, 1)
    variances = np.tile(usual, (steps, 1))
    for start_s, end_s, values in changes:
        where = f"change from {start_s} s to {end_s} s"
        if not 0.0 <= start_s <= end_s:
            raise ValueError(f"{where}: expected 0 <= from <= to")
        changed = _at_least_zero(where, values, 1)
        if changed.shape != usual.shape:
            raise ValueError(f"{where}: {changed.size} variances, base has {usual.size}")
        step = np.arange(steps)
        tolerance = 1e-6  # steps; 0.3 s / 0.1 s is a little less than 3
        variances[(step >= start_s / dt_s - tolerance) & (step <= end_s / dt_s + tolerance)] = changed
    return variances


def gaussian(rng: np.random.Generator, variances: ArrayLike) -> Matrix:
    """White Gaussian noise (N, m) without mean; `variances` (N, m), see `scheduled`.

    Raises:
        ValueError: a variance is negative or not finite.
    """
    spread = np.sqrt(_at_least_zero("variances", variances, 2))
    return np.asarray(spread * rng.standard_normal(spread.shape))


def truncated_gaussian(rng: np.random.Generator, variances: ArrayLike, bound: ArrayLike) -> Matrix:
    """White Gaussian noise (N, m) without mean, conditioned on |value| <= bound (P2, assumption 1 and equation 3).

    P2 gives no number for the bound. By the inverse distribution, so that every value takes one random number however
    tight the bound is.

    Args:
        rng: one uniform number per value.
        variances: (N, m), before truncation; what is left is `truncated_variance`.
        bound: one for all, or (m,); inf does not truncate.

    Raises:
        ValueError: a variance is negative or not finite, a bound is not > 0.
    """
    from scipy.special import ndtr, ndtri

    spread = np.sqrt(_at_least_zero("variances", variances, 2))
    limit, ratio = _bounds(spread, bound)
    below = ndtr(-ratio)
    # A generator may return zero, which without a bound would be infinite noise.
    probability = np.maximum(below + rng.random(spread.shape) * (1.0 - 2.0 * below), 2.0**-54)
    return np.asarray(np.clip(spread * ndtri(probability), -limit, limit))  # against rounding


def truncated_variance(variances: ArrayLike, bound: ArrayLike) -> Matrix:
    """Variances (N, m) of `truncated_gaussian`: what a filter that knows the noise is told.

    Raises:
        ValueError: as `truncated_gaussian`.
    """
    from scipy.special import ndtr

    spread = np.sqrt(_at_least_zero("variances", variances, 2))
    ratio = np.minimum(_bounds(spread, bound)[1], 40.0)  # beyond, the density is zero, and inf would make it NaN
    density = np.exp(-0.5 * ratio**2) / np.sqrt(2.0 * np.pi)
    # The difference loses all its digits at a bound far inside the deviation, where the density is nearly flat.
    flat = ratio**2 / 3.0 - 2.0 * ratio**4 / 45.0
    left = np.where(ratio < 0.02, flat, 1.0 - 2.0 * ratio * density / (1.0 - 2.0 * ndtr(-ratio)))
    return np.asarray(spread**2 * left)


def biased(samples: ArrayLike, bias: ArrayLike, first_step: int = 0) -> Matrix:
    """Samples (N, m) with `bias` (one for all, or (m,)) added from `first_step` on.

    Raises:
        ValueError: a bias is not finite, or the first step is negative.
    """
    record = _record(samples)
    offset = _per_channel("bias", bias, record)
    if first_step < 0:
        raise ValueError(f"first_step = {first_step}: must be >= 0")
    record[first_step:] += offset
    return record


def quantised(samples: ArrayLike, step: ArrayLike) -> Matrix:
    """Samples (N, m) rounded to whole multiples of `step` (one for all, or (m,)); 0 leaves a channel as it is.

    Raises:
        ValueError: a step is negative or not finite.
    """
    record = _record(samples)
    size = np.broadcast_to(_at_least_zero("step", _per_channel("step", step, record), 1), record.shape)
    return np.where(size > 0.0, np.rint(record / np.where(size > 0.0, size, 1.0)) * size, record)


def delayed(samples: ArrayLike, steps: ArrayLike) -> Matrix:
    """Samples (N, m) that arrive `steps` (whole; one for all, or (m,)) late; NaN before the first.

    Raises:
        ValueError: a delay is negative or not whole.
    """
    record = _record(samples)
    late = np.full_like(record, np.nan)
    for channel, delay in enumerate(_at_least_zero("steps", _per_channel("steps", steps, record), 1)):
        if delay != np.rint(delay):
            raise ValueError(f"steps = {delay}: delays are whole steps")
        count = min(int(delay), len(record))
        late[count:, channel] = record[: len(record) - count, channel]
    return late


def dropped(rng: np.random.Generator, samples: ArrayLike, probability: ArrayLike) -> Matrix:
    """Samples (N, m) with NaN where lost, each step on its own.

    Args:
        rng: one uniform number per step, or per value.
        samples: (N, m).
        probability: one number: all channels of a step are lost together, as with a lost frame; (m,): each on its own.

    Raises:
        ValueError: a probability is outside 0 to 1.
    """
    record = _record(samples)
    rate = _at_least_zero("probability", _per_channel("probability", probability, record), 1)
    if rate.max(initial=0.0) > 1.0:
        raise ValueError(f"probability = {rate.max()}: must be between 0 and 1")
    together = np.ndim(probability) == 0
    record[rng.random((len(record), 1) if together else record.shape) < rate] = np.nan
    return record


def _bounds(spread: Matrix, bound: ArrayLike) -> tuple[Matrix, Matrix]:
    """The bound of every value, and the same in deviations (inf where there is no noise)."""
    limit = np.asarray(bound, dtype=np.float64)
    if limit.ndim > 1 or (limit.ndim == 1 and limit.size != spread.shape[1]):
        raise ValueError(f"bound has shape {limit.shape}: expected one number, or one per channel ({spread.shape[1]})")
    if not (limit > 0.0).all():
        raise ValueError(f"bound = {bound!r}: must be > 0")
    limit = np.broadcast_to(limit, spread.shape)
    return limit, np.divide(limit, spread, out=np.full_like(spread, np.inf), where=spread > 0.0)


def _record(samples: ArrayLike) -> Matrix:
    record = np.array(samples, dtype=np.float64)  # a copy
    if record.ndim != 2:
        raise ValueError(f"samples have shape {record.shape}: expected (steps, channels)")
    return record


def _per_channel(name: str, value: ArrayLike, record: Matrix) -> Matrix:
    values = np.asarray(value, dtype=np.float64)
    if values.ndim > 1 or (values.ndim == 1 and values.size != record.shape[1]):
        raise ValueError(
            f"{name} has shape {values.shape}: expected one number, or one per channel ({record.shape[1]})"
        )
    if not np.isfinite(values).all():
        raise ValueError(f"{name} = {value!r}: must be finite")
    return np.broadcast_to(values, record.shape[1])


def _at_least_zero(name: str, value: ArrayLike, dimensions: int) -> Matrix:
    values = np.asarray(value, dtype=np.float64)
    if values.ndim != dimensions:
        raise ValueError(
            f"{name} has shape {values.shape}: expected {'(channels,)' if dimensions == 1 else '(steps, channels)'}"
        )
    wrong = ~(np.isfinite(values) & (values >= 0.0))
    if wrong.any():
        raise ValueError(f"{name} holds {values[wrong][0]}: must be finite and >= 0")
    return values
