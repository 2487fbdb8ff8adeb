"""Checks of the arguments that say which parameters a filter estimates, from where, and how."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.covariance import lower_factor
from servohil.estimators.filter import FilterError, state_vector

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def places(name: str, value: Sequence[int], size: int) -> tuple[int, ...]:
    """Indices into something of `size` elements, each at most once.

    Raises:
        FilterError: not whole numbers, out of range or twice the same.
    """
    try:
        items: list[Any] = list(value)
    except TypeError as error:
        raise FilterError(f"{name} = {value!r}: must be a sequence of indices") from error
    for item in items:
        if isinstance(item, bool) or not isinstance(item, int | np.integer) or not 0 <= item < size:
            raise FilterError(f"{name} = {value!r}: {item!r} is no index >= 0 and < {size}")
    if len(set(items)) != len(items):
        raise FilterError(f"{name} = {value!r}: every index once only")
    return tuple(int(item) for item in items)


def scales_of(scale: ArrayLike | None, start: Vector) -> Vector:
    """(k,) units in which parameters are counted: as given, or the magnitude of their start, 1 where that is 0.

    Raises:
        FilterError: wrong shape, not finite or not > 0.
    """
    if scale is None:
        return np.where(start == 0.0, 1.0, np.abs(start))
    scales = state_vector("scale", scale, len(start))
    if (scales <= 0.0).any():
        raise FilterError(f"scale = {scales}: must be > 0")
    return scales


def covariance_of(name: str, value: ArrayLike, k: int, *, definite: bool = True) -> Matrix:
    """(k, k) covariance from itself or from (k,) standard deviations.

    Raises:
        ValueError: wrong shape, not finite, negative, not symmetric or not positive (semi)definite.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FilterError(f"{name} = {value!r}: must be ({k}, {k}) or ({k},) numbers") from error
    if array.ndim == 1:
        std = state_vector(name, array, k)
        if (std < 0.0).any() or (definite and (std == 0.0).any()):
            raise FilterError(f"{name} = {std}: standard deviations must be {'>' if definite else '>='} 0")
        return np.diag(np.square(std))
    lower_factor(name, array, k, definite=definite)
    return array


def bounds(lower: ArrayLike | None, upper: ArrayLike | None, start: Vector, reach: Vector) -> tuple[Vector, Vector]:
    """(k,) lower and upper bounds as given, or start -+ reach; the start lies within.

    Raises:
        FilterError: wrong shape, NaN, or the start is outside.
    """
    limits = []
    for name, value, default in (("lower", lower, start - reach), ("upper", upper, start + reach)):
        limit = default if value is None else np.array(value, dtype=np.float64)
        if limit.shape != start.shape or np.isnan(limit).any():
            raise FilterError(f"{name} = {value!r}: must be ({len(start)},) numbers, inf where there is no bound")
        limits.append(limit)
    outside = (start < limits[0]) | (start > limits[1])
    if outside.any():
        raise FilterError(
            f"lower = {limits[0]}, upper = {limits[1]}: the start {start} must lie within"
        )  # fmt: skip
    return limits[0], limits[1]


def positive(name: str, value: ArrayLike, k: int) -> Vector:
    """(k,) numbers >= 0 from one or from k.

    Raises:
        FilterError: wrong shape, not finite or negative.
    """
    try:
        vector = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (k,)))
    except (TypeError, ValueError) as error:
        raise FilterError(f"{name} = {value!r}: must be one number or ({k},)") from error
    if not np.isfinite(vector).all() or (vector < 0.0).any():
        raise FilterError(f"{name} = {value!r}: must be finite and >= 0")
    return vector
