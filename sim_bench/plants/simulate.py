"""The truth of an experiment in open loop: a model driven by given inputs and seeded noise, in one compiled loop.

The step is checked first: a linearisation of f at the start must be within the stability region of the integrator.
That is no proof for the whole path or of accuracy; a step that breaks it is far too long in any case.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.integrate import STAGES
from servohil.estimators.linear_algebra.views import matrix_at
from servohil.estimators.model import VECTOR, Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Largest |eigenvalue| x step. Within that of "rk4" whatever decays in truth decays: 2.785 on the real axis,
# 2.828 on the imaginary one, least at 122 degrees. No disc has that for Euler's rule; its limit is that of the
# real axis. A discrete model has no step.
STABILITY_LIMITS: Final = {"rk4": 2.61, "euler": 2.0}
MATRIX: Final = "f8[:,::1]"

# `Model.specialise` compiles the function below with the model's functions and sizes in place of these.
f: Any = None
h: Any = None
integrate: Any = None
N: int = 0
DT: float = 0.0
SUBSTEPS: int = 0


class Truth(NamedTuple):
    """States X (N, n) and outputs without sensor noise Y (N, m); row k is at the end of the period of input k."""

    X: Matrix
    Y: Matrix


def _drive(x: Vector, p: Vector, U: Matrix, W: Matrix, X: Matrix, Y: Matrix, stages: Vector) -> None:
    for k in range(U.shape[0]):
        integrate(f, N, DT, SUBSTEPS, x, U[k], p, matrix_at(stages, 0, STAGES, N))
        for i in range(N):
            x[i] += W[k, i]
            X[k, i] = x[i]
        h(x, U[k], p, Y[k])


def simulate(model: Model, x0: ArrayLike, U: ArrayLike, noise_std: ArrayLike, seed: int) -> Truth:
    """Drive `model` from x0 through every row of U, each held for one sample period; noise is added after each.

    Args:
        model: its p, dt, integrator and substeps are the truth's.
        x0: (n,) state before the first period.
        U: (N, n_u) inputs.
        noise_std: standard deviation of what is added to the state per sample: a number, (n,) or (N, n).
        seed: of the noise; the same seed gives the same path.

    Raises:
        ValueError: wrong shape or value of an argument; a step above the stability limit (names both); a path that
            leaves the finite numbers (names the step).
    """
    x = np.array(x0, dtype=np.float64)
    inputs = np.array(U, dtype=np.float64, order="C")
    std = np.asarray(noise_std, dtype=np.float64)
    if x.shape != (model.n,) or not np.isfinite(x).all():
        raise ValueError(f"x0 = {x0!r}: must be {model.n} finite numbers")
    if inputs.ndim != 2 or inputs.shape[1] != model.n_u or not len(inputs) or not np.isfinite(inputs).all():
        raise ValueError(f"U has shape {inputs.shape}: must be (N, {model.n_u}), N >= 1, all finite")
    count = len(inputs)
    if std.shape not in ((), (model.n,), (count, model.n)) or not (np.isfinite(std).all() and (std >= 0.0).all()):
        raise ValueError(
            f"noise_std with shape {std.shape}: must be a number, ({model.n},) or ({count}, {model.n}), finite and >= 0"
        )
    check_step(model, x, inputs[0])
    noise = std * np.random.default_rng(seed).standard_normal((count, model.n))
    states, outputs = np.empty((count, model.n)), np.empty((count, model.m))
    compiled_drive(model)(x, model.p, inputs, noise, states, outputs, np.empty(STAGES * model.n))
    lost = np.flatnonzero(~np.isfinite(states).all(axis=1))
    if lost.size:
        raise ValueError(f"the simulated state is not finite from step {lost[0]} on (dt = {model.dt} s): shorten dt")
    return Truth(states, outputs)


def compiled_drive(model: Model) -> Any:
    """The loop above for `model`: drive(x (n,), p, U (N, n_u), W (N, n), X (N, n), Y (N, m), stages (STAGES n,)).

    It moves x through every row of U and adds the row of W; states and outputs go to X and Y.
    """
    return model.specialise(_drive, f"void({VECTOR}, {VECTOR}, {', '.join([MATRIX] * 4)}, {VECTOR})")


def check_step(model: Model, x: Vector, u: Vector) -> None:
    """Refuse a model whose integration step is too long at (x, u).

    Raises:
        ValueError: names the step, the fastest eigenvalue and the limit.
    """
    if model.integrator not in STABILITY_LIMITS:
        return
    check_step_length(model.f, x, u, model.p, model.dt / model.substeps, model.integrator)


def check_step_length(f: Any, x: Vector, u: Vector, p: Vector, step_s: float, integrator: str) -> None:
    """The same for a right-hand side f(x, u, p, dx) and a step of its own; `integrator` is "rk4" or "euler".

    Raises:
        ValueError: names the step, the fastest eigenvalue and the limit.
    """
    fastest = float(np.abs(np.linalg.eigvals(jacobian(f, x, u, p))).max())
    allowed = STABILITY_LIMITS[integrator]
    if fastest * step_s > allowed:
        raise ValueError(
            f"integration step = {step_s:g} s (dt / substeps): above the stability limit {allowed / fastest:.3g} s of "
            f"{integrator!r}, |eigenvalue| x step <= {allowed}, with the fastest eigenvalue {fastest:.4g} 1/s"
        )


def jacobian(f: Any, x: Vector, u: Vector, p: Vector) -> Matrix:
    """df/dx (n, n) of f(x, u, p, dx) by central differences.

    Raises:
        ValueError: f is not finite near x.
    """
    matrix, slopes = np.empty((x.size, x.size)), np.empty((2, x.size))
    for i in range(x.size):
        step = 1e-5 * max(1.0, abs(x[i]))
        for sign, slope in zip((1.0, -1.0), slopes, strict=True):
            moved = x.copy()
            moved[i] += sign * step
            try:
                with np.errstate(all="ignore"):
                    f(moved, u, p, slope)
            except (ArithmeticError, ValueError):  # plain Python raises where compiled code gives inf or NaN
                slope[:] = np.nan
        with np.errstate(invalid="ignore"):  # inf - inf
            matrix[:, i] = (slopes[0] - slopes[1]) / (2.0 * step)
    if not np.isfinite(matrix).all():
        raise ValueError(f"f is not finite near x0 = {x}: no step size can be judged")
    return matrix
