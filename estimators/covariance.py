"""Checks covariance matrices given by a user and turns them into lower factors F with F F' = P."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]

ROUNDING = 1e-9  # relative asymmetry that rounding in a user's own computation may leave
SEMIDEFINITE = 1e-12  # eigenvalues above -this * largest count as zero


class CovarianceError(ValueError):
    """A covariance or a factor was refused; the message names the argument, its value and the rule."""


def lower_factor(name: str, value: ArrayLike, size: int, *, definite: bool) -> Matrix:
    """The lower factor, diagonal >= 0, of a covariance matrix.

    Args:
        name: of the argument, for messages.
        value: (size, size) symmetric.
        size: rows it must have.
        definite: refuse a singular matrix too.

    Raises:
        CovarianceError: wrong shape, not finite, not symmetric, or not positive (semi)definite.
    """
    matrix = _matrix(name, value, (size, size))
    scale = np.sqrt(np.abs(np.diag(matrix)))
    uneven = np.abs(matrix - matrix.T) > ROUNDING * np.maximum(np.outer(scale, scale), np.abs(matrix))
    if uneven.any():
        i, j = (int(k) for k in np.argwhere(uneven)[0])
        raise CovarianceError(
            f"{name}[{i}, {j}] = {matrix[i, j]!r} but {name}[{j}, {i}] = {matrix[j, i]!r}: must be symmetric"
        )
    matrix = 0.5 * (matrix + matrix.T)
    # Scaled to a unit diagonal, so that the verdict does not depend on the units of the states.
    unit = np.where(scale > 0.0, scale, 1.0)
    scaled = matrix / np.outer(unit, unit)
    try:
        return unit[:, None] * np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        pass
    eigenvalues, vectors = np.linalg.eigh(scaled)
    rule = "positive definite" if definite else "positive semidefinite"
    if definite or eigenvalues[0] < -SEMIDEFINITE * max(eigenvalues[-1], 1.0):
        raise CovarianceError(
            f"{name} = {_short(matrix)}: must be {rule}; smallest eigenvalue of the matrix scaled to a unit diagonal "
            f"is {eigenvalues[0]:.6g}"
        )
    return _triangular(unit[:, None] * vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))


def checked_factor(name: str, value: ArrayLike, size: int) -> Matrix:
    """The lower factor, diagonal >= 0, equivalent to any factor F (size, any number of columns).

    Raises:
        CovarianceError: wrong shape or not finite.
    """
    matrix = np.array(value, dtype=np.float64)
    columns = matrix.shape[1] if matrix.ndim == 2 else 0
    return _triangular(_matrix(name, matrix, (size, max(columns, 1))))


def _triangular(factor: Matrix) -> Matrix:
    rows, columns = factor.shape
    padded = np.zeros((rows, max(rows, columns)))
    padded[:, :columns] = factor
    lower = np.asarray(np.linalg.qr(padded.T, mode="r")).T
    signs = np.where(np.diag(lower) < 0.0, -1.0, 1.0)
    return np.tril(lower * signs)


def _matrix(name: str, value: ArrayLike, shape: tuple[int, int]) -> Matrix:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CovarianceError(f"{name} = {value!r}: must be a {shape} array of numbers") from error
    if matrix.shape != shape:
        raise CovarianceError(f"{name} has shape {matrix.shape}: must be {shape}")
    bad = np.argwhere(~np.isfinite(matrix))
    if bad.size:
        i, j = (int(k) for k in bad[0])
        raise CovarianceError(f"{name}[{i}, {j}] = {matrix[i, j]!r}: must be finite")
    return matrix


def _short(matrix: Matrix) -> str:
    return np.array2string(matrix, precision=6, separator=", ").replace("\n", "")
