"""Sensitivity-based adaptive SR-UKF (P4, corrected): states, parameters and noise variances together."""

from collections.abc import Sequence
from itertools import pairwise
from math import inf, isfinite, log, sqrt
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.covariance import lower_factor
from servohil.estimators.filter import Filter, FilterError
from servohil.estimators.model import Model
from servohil.estimators.sensitivity.estimated_parameters import bounds, covariance_of, places, positive, scales_of
from servohil.estimators.sensitivity.sensitivity_layout import own_offsets, scratch_offsets, setting_offsets
from servohil.estimators.sensitivity.sensitivity_step import step
from servohil.estimators.sensitivity.tangent_model import tangent_discrete, tangent_euler, tangent_rk4
from servohil.estimators.sigma_point.sigma_point_work import sigma_point_work
from servohil.estimators.sigma_point.sigma_points import Weights, scaled_weights

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Tensor = NDArray[np.float64]

CRITERIA: Final = ("likelihood", "prediction-error")
TRANSFORMS: Final = ("scaled", "paper")
INTEGRATORS: Final = {"rk4": tangent_rk4, "euler": tangent_euler, "discrete": tangent_discrete}
LARGEST_LOG_CHANGE: Final = log(1e8)  # of a variance from its start, unless bounds say otherwise


class SensitivitySRUKF(Filter):
    """SR-UKF with recursive prediction-error estimation of parameters (P4 tables 1 and 2); fields of `Filter`.

    The estimated quantities are, in this order, k_model model parameters, the variances Q[i, i] for i in Q_entries and
    R[i, i] for i in R_entries, each by its natural logarithm (its correlations stay). Every step propagates the
    derivative of the whole filter with respect to each of the k of them, and moves them by a Gauss-Newton step with
    forgetting, unless their excitation is too small: a parameter that the last one to two windows do not tell is held,
    the others go on. Sensitivities follow `parameters` as they are when the filter meets them; the filter's past is not
    computed anew.

    Args:
        model: its p is the start of the estimate; it is not changed.
        x0, P0, Q, R, chol_Q, chol_R, gate, arena: see `Filter`; estimated variances start from Q and R, must be > 0.
        parameters: places in model.p of the parameters to estimate.
        P0_parameters: initial covariance (k, k), or (k,) standard deviations, of all estimated quantities: of model
            parameters in their units, of a variance's logarithm without unit (1: a factor of e). No variance grows
            beyond it.
        Q_entries, R_entries: diagonal entries of Q and R to estimate.
        forgetting: P4's lambda, 0 < lambda <= 1; memory is 1 / (1 - lambda) steps.
        criterion: "likelihood" weighs the innovation e with its covariance S, and a variance also hears how e e'
            compares with S: it finds the size of Q and R. "prediction-error" is P4's: weighed with the running mean of
            e e'; only the ratio of Q to R can be told from it, so give part of the entries.
        threshold: P4's, one number or (k,) between 0 and 1: a model parameter is held while its excitation is below
            this part of the largest so far. Excitation is what a change of the parameter by its scale does within a
            step to state and outputs, in standard deviations of Q and R at the start, as a norm over the
            window.
        least_excitation: below this a parameter is held whatever the largest was. The excitation of a variance is the
            norm of its whitened sensitivity (5: the window tells it to within 20 %).
        window: steps.
        memory: steps in which the largest excitation fades to 1 / e.
        doubt: model parameters that explain a window, or the part of it so far, better by more than doubt^2 for each
            of them if they may move as far as at the start, must have jumped. Nothing moves for one window then, and
            those that explain it get their initial variance back; for the next two windows they are trusted. The
            initial variance should cover the jump. inf: never.
        scale: (k_model,) in which parameters are counted; None: their start's magnitude, 1 where that is 0.
        lower, upper: (k,) bounds in the units of `parameters`, None: none for model parameters and a factor of 1e8 from
            the start for variances.
        transform: "scaled", or "paper" for P4's points: lambda_f = alpha^2 (n + kappa), without the usual - n.
        alpha, beta, kappa: scaled unscented transform.

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
        parameters: Sequence[int] = (),
        P0_parameters: ArrayLike,
        Q_entries: Sequence[int] = (),
        R_entries: Sequence[int] = (),
        forgetting: float = 0.999,
        criterion: str = "likelihood",
        threshold: ArrayLike = 0.3,
        least_excitation: float = 1.0,
        window: int = 500,
        memory: float = 1e5,
        doubt: float = 5.0,
        scale: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        transform: str = "scaled",
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        if not isinstance(model, Model):
            raise FilterError(f"model = {model!r}: must be a Model")
        n, m, n_p = model.n, model.m, len(model.p)
        self._index = places("parameters", parameters, n_p)
        self._q_entries = places("Q_entries", Q_entries, n)
        self._r_entries = places("R_entries", R_entries, m)
        k_model, k_q = len(self._index), len(self._q_entries)
        k = k_model + k_q + len(self._r_entries)
        if k == 0:
            raise FilterError("parameters, Q_entries and R_entries are empty: there is nothing to estimate")
        common = arena_offsets(n, m)[-1]
        own = own_offsets(n, m, k, k_model, 0)
        super().__init__(
            model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena, own_size=own[-1]
        )  # fmt: skip
        self._start = model.p[list(self._index)]
        self._log_variances = self._current_log_variances()
        for name, entries, first in (("Q", self._q_entries, 0), ("R", self._r_entries, k_q)):
            for i, entry in enumerate(entries):
                if not isfinite(self._log_variances[first + i]):
                    raise FilterError(f"{name}[{entry}, {entry}] = 0: a variance that is estimated must be > 0")
        self._rates = np.ones(k)
        self._rates[:k_model] = scales_of(scale, self._start)
        covariance = covariance_of("P0_parameters", P0_parameters, k)
        self._covariance0 = lower_factor(
            "P0_parameters", covariance / np.outer(self._rates, self._rates), k, definite=True
        )
        if criterion not in CRITERIA:
            raise FilterError(f"criterion = {criterion!r}: must be one of {', '.join(CRITERIA)}")
        if not 0.0 < forgetting <= 1.0:
            raise FilterError(f"forgetting = {forgetting!r}: must be > 0 and <= 1")
        for name, number, least in (("least_excitation", least_excitation, 0.0), ("memory", memory, 2.0)):
            if not isfinite(number) or number < least:
                raise FilterError(f"{name} = {number!r}: must be finite and >= {least}")
        if not doubt > 0.0:
            raise FilterError(f"doubt = {doubt!r}: must be > 0, inf for no restart")
        if isinstance(window, bool) or not isinstance(window, int | np.integer) or window < 1:
            raise FilterError(f"window = {window!r}: must be a whole number of steps >= 1")
        reach = np.concatenate([np.full(k_model, inf), np.full(k - k_model, LARGEST_LOG_CHANGE)])
        start = np.concatenate([self._start, self._log_variances])
        low, high = bounds(lower, upper, start, reach)
        if not (np.isfinite(low[k_model:]).all() and np.isfinite(high[k_model:]).all()):
            raise FilterError(f"lower = {low}, upper = {high}: must be finite for the logarithm of a variance")
        work = sigma_point_work(n, m, _weights(transform, n, alpha, beta, kappa), self._gate_limits)
        settings = np.concatenate([
            [k, k_model, k_q, n_p],
            [forgetting, float(criterion == "likelihood"), window, memory, least_excitation, doubt],
            self._index, self._q_entries, self._r_entries, self._rates, low, high,
            positive("threshold", threshold, k), self._excitation_weights(),
            np.sum(np.square(self._covariance0), axis=1),
        ])  # fmt: skip
        assert len(settings) == setting_offsets(n, m, k, 0)[-1]
        scratch = np.zeros(scratch_offsets(n, m, k, n_p, 0)[-1])
        (
            self._theta, self._dx, self._dfactor, self._dy, self._dloglik, self._gain, self._dgain, self._covariance,
            _, self._excitation, _, self._held, _, self._doubt, self._reopened, self._adapting,
        ) = (self.arena[common + a : common + b] for a, b in pairwise(own))  # fmt: skip
        self._adapting[0] = 1.0
        self._build(step, np.concatenate([work, settings, scratch]), integrate_tangents=INTEGRATORS[model.integrator])

    @staticmethod
    def arena_size(n: int, m: int, k: int, k_model: int) -> int:
        """Float64 elements of the arena with n states, m outputs, k estimated quantities, k_model of them of the
        model."""
        return own_offsets(n, m, k, k_model, arena_offsets(n, m)[-1])[-1]

    def _excitation_weights(self) -> Vector:
        """(n + m,) one over the variances of the noise; a state without has its initial one, an output without that of
        its prediction: none."""
        noise = np.sum(np.square(self._q), axis=0), np.sum(np.square(self._r), axis=0)
        start = np.sum(np.square(self._factor0), axis=1)
        states = np.where(noise[0] > 0.0, noise[0], start)
        return 1.0 / np.concatenate([states, np.where(noise[1] > 0.0, noise[1], np.inf)])

    def _reset_own(self) -> None:
        adapting = self.adapting
        self._own[:] = 0.0
        self.adapting = adapting
        self._theta[:] = self._start
        self._held[:] = 1.0  # nothing has been seen
        self._covariance[:] = self._covariance0.T.ravel()
        entries = [(self._q, i) for i in self._q_entries] + [(self._r, i) for i in self._r_entries]
        for (noise, i), now, start in zip(entries, self._current_log_variances(), self._log_variances, strict=True):
            if isfinite(now):
                noise[:, i] *= np.exp(0.5 * (start - now))
            else:
                noise[i, i] = np.exp(0.5 * start)

    def _current_log_variances(self) -> Vector:
        variances = [np.sum(np.square(self._q[:, i])) for i in self._q_entries]
        variances += [np.sum(np.square(self._r[:, i])) for i in self._r_entries]
        return np.array([log(v) if v > 0.0 else -inf for v in variances])

    @property
    def adapting(self) -> bool:
        """Whether the parameters move; settable, e.g. off while a fault test is pending. Survives a reset."""
        return bool(self._adapting[0])

    @adapting.setter
    def adapting(self, value: bool) -> None:
        self._adapting[0] = float(bool(value))

    @property
    def parameters(self) -> Vector:
        """(k,) estimates: model parameters in their units, then natural logarithms of the variances."""
        return np.concatenate([self._theta, self._current_log_variances()])

    @property
    def parameter_covariance(self) -> Matrix:
        """(k, k) covariance of `parameters` as the recursion has it."""
        upper = self._covariance.reshape(len(self._rates), -1) * self._rates
        return upper.T @ upper

    @property
    def parameter_std(self) -> Vector:
        """(k,) standard deviations of `parameters`."""
        return np.sqrt(np.diag(self.parameter_covariance))

    @property
    def held(self) -> NDArray[np.bool_]:
        """(k,) True where the excitation was too small in the last step to move the parameter."""
        return self._held != 0.0

    @property
    def reopened(self) -> int:
        """How often parameters got their initial variance back since the last reset, see `doubt`. Once in a while: a
        jump. Again and again: the model cannot explain the data, whatever its parameters."""
        return int(self._reopened[0])

    @property
    def excitation(self) -> Vector:
        """(k,) what the gate compares, see `threshold`."""
        return np.sqrt(self._excitation.reshape(4, -1)[2])

    @property
    def sensitivity_x(self) -> Matrix:
        """(n, k) derivative of x with respect to `parameters`."""
        return self._dx.reshape(len(self._rates), -1).T / self._rates

    @property
    def sensitivity_P(self) -> Tensor:
        """(k, n, n) derivative of P."""
        n = self.model.n
        upper = self._dfactor.reshape(-1, n, n) / self._rates[:, None, None]
        half = upper.transpose(0, 2, 1) @ self._factor
        return half + half.transpose(0, 2, 1)

    @property
    def sensitivity_y(self) -> Matrix:
        """(m, k) derivative of the predicted measurement of the last step, missing channels too."""
        return self._dy.reshape(len(self._rates), -1).T / self._rates

    @property
    def sensitivity_loglik(self) -> Vector:
        """(k,) derivative of `loglik`; 0 where no correction was made."""
        return self._dloglik / self._rates

    @property
    def gain(self) -> Matrix:
        """(n, m) gain of the last correction, 0 for missing channels and where none was made."""
        return self._gain.reshape(self.model.n, -1).copy()

    @property
    def sensitivity_gain(self) -> Tensor:
        """(k, n, m) derivative of `gain`."""
        return self._dgain.reshape(-1, self.model.n, self.model.m) / self._rates[:, None, None]


def _weights(transform: str, n: int, alpha: float, beta: float, kappa: float) -> Weights:
    if transform not in TRANSFORMS:
        raise FilterError(f"transform = {transform!r}: must be one of {', '.join(TRANSFORMS)}")
    if transform == "scaled":
        return scaled_weights(n, alpha, beta, kappa)
    scale = n + alpha * alpha * (n + kappa)
    centre = 1.0 - n / scale + 1.0 - alpha * alpha + beta if scale > 0.0 else -1.0
    if not (isfinite(scale) and isfinite(centre) and alpha > 0.0 and centre >= 0.0):
        raise FilterError(
            f"alpha = {alpha!r}, beta = {beta!r}, kappa = {kappa!r}: need finite numbers, alpha > 0, "
            "n + alpha^2 (n + kappa) > 0 and a covariance weight of the central point >= 0"
        )
    return Weights(sqrt(scale), centre, 0.5 / scale)
