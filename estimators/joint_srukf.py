"""SR-UKF with unknown parameters in the state: the usual way, and P4's competitor of the sensitivity-based filter."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.covariance import lower_factor
from servohil.estimators.filter import FilterError, noise_factor, state_vector
from servohil.estimators.model import Model, difference
from servohil.estimators.sensitivity.estimated_parameters import covariance_of, places, scales_of
from servohil.estimators.srukf import SRUKF

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class JointSRUKF(SRUKF):
    """`SRUKF` of the model's n states and k of its parameters, which follow a random walk.

    `x`, `P`, `chol_P` and `Q` have n + k rows: states, then parameters in units of `scale`, which keeps P well
    conditioned. Parameters move whenever the innovation correlates with them, also where nothing excites them; see
    `SensitivitySRUKF` for one that holds them.

    Args:
        model: its p is where the parameters start; it is not changed.
        x0, P0, Q, chol_Q: of the n states.
        parameters: places in model.p of the parameters to estimate.
        P0_parameters: initial covariance (k, k) or (k,) standard deviations, in the parameters' units.
        Q_parameters: covariance per step of their random walk, (k, k) or (k,) standard deviations; 0 for constants.
        scale: (k,) units of the parameters in the state; None: the magnitude of their start.
        lower, upper: (k,) bounds of what the model is given; the state itself may lie outside for a while.

    Other arguments as `SRUKF`.

    Raises:
        ValueError: an argument was refused; the message names it, its value and the rule.
    """

    def __init__(
        self,
        model: Model,
        x0: ArrayLike,
        P0: ArrayLike,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
        *,
        parameters: Sequence[int],
        P0_parameters: ArrayLike,
        Q_parameters: ArrayLike = 0.0,
        scale: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        if not isinstance(model, Model):
            raise FilterError(f"model = {model!r}: must be a Model")
        n = model.n
        self.places = places("parameters", parameters, len(model.p))
        k = len(self.places)
        if k == 0:
            raise FilterError("parameters = []: must name at least one place in p")
        start = model.p[list(self.places)]
        self.scale = scales_of(scale, start)
        start = start / self.scale
        low, high = _limits(lower, upper, self.scale, start)
        walk = np.zeros(k) if np.ndim(Q_parameters) == 0 and Q_parameters == 0.0 else Q_parameters
        units = np.outer(self.scale, self.scale)
        factor_q = noise_factor("Q", Q, chol_Q, n)
        joint_p = covariance_of("P0_parameters", P0_parameters, k) / units
        joint_q = lower_factor(
            "Q_parameters", covariance_of("Q_parameters", walk, k, definite=False) / units, k, definite=False
        )
        state_p = lower_factor("P0", P0, n, definite=True)
        super().__init__(
            _joint_model(model, self.places, tuple(self.scale), tuple(low), tuple(high)),
            np.concatenate([state_vector("x0", x0, n), start]),
            _blocks(state_p @ state_p.T, joint_p),
            R=R,
            alpha=alpha,
            beta=beta,
            kappa=kappa,
            chol_Q=_blocks(factor_q, joint_q),
            chol_R=chol_R,
            gate=gate,
            arena=arena,
        )

    @property
    def parameters(self) -> Vector:
        """(k,) estimates in the parameters' units."""
        return self._x[-len(self.places) :] * self.scale

    @property
    def parameter_std(self) -> Vector:
        """(k,) their standard deviations."""
        return np.sqrt(np.diag(self.P))[-len(self.places) :] * self.scale


def _limits(lower: ArrayLike | None, upper: ArrayLike | None, scale: Vector, start: Vector) -> tuple[Vector, Vector]:
    """(k,) bounds in units of scale."""
    found = []
    for name, value, none in (("lower", lower, -np.inf), ("upper", upper, np.inf)):
        limit = np.full(len(scale), none) if value is None else np.array(value, dtype=np.float64)
        if limit.shape != scale.shape or np.isnan(limit).any():
            raise FilterError(f"{name} = {value!r}: must be ({len(scale)},) numbers, inf where there is no bound")
        found.append(limit / scale)
    if (start < found[0]).any() or (start > found[1]).any():
        raise FilterError(f"lower = {lower!r}, upper = {upper!r}: the start {start * scale} must lie within")
    return found[0], found[1]


def _blocks(first: Matrix, second: Matrix) -> Matrix:
    n = len(first)
    whole = np.zeros((n + len(second), n + len(second)))
    whole[:n, :n] = first
    whole[n:, n:] = second
    return whole


def _joint_model(
    model: Model,
    indices: tuple[int, ...],
    scale: tuple[float, ...],
    lower: tuple[float, ...],
    upper: tuple[float, ...],
) -> Model:
    """The model of states and parameters. It writes the parameters of a sigma point into its own p in front of each
    call: p is scratch here, so nothing needs to be allocated."""
    n, k, m = model.n, len(indices), model.m
    still = 1.0 if model.integrator == "discrete" else 0.0  # next value: the same; derivative: none
    user_f, user_h = (njit(error_model="numpy")(g) for g in (model.f, model.h))
    subtract = njit(error_model="numpy")(model.state_residual)

    def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
        for j in range(k):
            p[indices[j]] = min(max(x[n + j], lower[j]), upper[j]) * scale[j]
            dx[n + j] = still * x[n + j]
        user_f(x[:n], u, p, dx[:n])

    def h(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
        for j in range(k):
            p[indices[j]] = min(max(x[n + j], lower[j]), upper[j]) * scale[j]
        user_h(x[:n], u, p, y)

    def residual(a: Vector, b: Vector, out: Vector) -> None:
        subtract(a[:n], b[:n], out[:n])
        for j in range(k):
            out[n + j] = a[n + j] - b[n + j]

    return Model(
        f,
        h,
        n + k,
        m,
        model.p,
        model.dt,
        model.integrator,
        model.substeps,
        model.n_u,
        names=(*model.names, *(f"p[{i}]" for i in indices)),
        units=(*model.units, *("scaled" for _ in indices)),
        state_residual=None if model.state_residual is difference else residual,
        output_residual=None if model.output_residual is difference else model.output_residual,
    )
