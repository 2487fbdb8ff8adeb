"""Adaptive square-root unscented Kalman filter (P1 algorithm 1): the object around the compiled step."""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.adaptive_filter import AdaptiveFilter, checked_forgetting
from servohil.estimators.covariance import lower_factor
from servohil.estimators.filter import FilterError, state_vector
from servohil.estimators.model import Model
from servohil.estimators.noise.adaptive_layout import adaptive_offsets
from servohil.estimators.noise.asrukf_likelihood_step import step as likelihood_step
from servohil.estimators.noise.noise_adaptation import limited_settings, sage_husa_settings
from servohil.estimators.noise.noise_estimator import NoiseEstimator, first_variances
from servohil.estimators.noise.noise_layout import room_size
from servohil.estimators.sigma_point.sigma_point_step import form_work
from servohil.estimators.sigma_point.sigma_point_step import step as form_step
from servohil.estimators.sigma_point.sigma_point_work import sigma_point_work
from servohil.estimators.sigma_point.sigma_points import scaled_weights
from servohil.estimators.sigma_point.srukf_forms import factor_array, reduce_array
from servohil.estimators.sigma_point.srukf_step import step

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

ADAPTATIONS: Final = ("likelihood", "limited", "sage-husa", "off")


class ASRUKF(AdaptiveFilter):
    """`SRUKF`, array form, that estimates its noise covariances.

    adaptation "likelihood" estimates the diagonals of Q and R together, from nothing: `noise_likelihood.py`.
    "sage-husa" is the papers' form, for their experiments: `sage_husa.py`. "limited" estimates one of Q and R, the
    other being known, positive definite by construction: `limited_sage_husa.py`. "off" is an `SRUKF`.

    Args:
        Q, R: where the estimates start; what is not estimated stays. "likelihood" needs neither (None: no prior
            knowledge), keeps to diagonals, and leaves a variance of zero at zero.
        adaptation: "likelihood", "limited", "sage-husa" or "off".
        forgetting: rho of the fading memory of "limited" and "sage-husa", 0 < rho < 1: about 1 / (1 - rho) steps.
        adapt: which of "R" and "Q" the "limited" form estimates.
        structure: "diagonal" or "full", of what the "limited" form estimates.
        warm_up: steps before the "limited" form starts; the start's error must have settled.
        bounds: least and largest ratio of each variance to its start in the "limited" form.
        window: steps of data that "likelihood" judges by; fewer while the noise has just changed.
        window_steps: how many of them it goes through per step: the cost of a step, and how soon Q and R follow.
        means: "sage-husa" estimates the means of both noises too. They cannot be told from an offset of the state.

    Other arguments and fields as `SRUKF`, and those of `AdaptiveFilter`.

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
        adaptation: Literal["likelihood", "limited", "sage-husa", "off"] = "likelihood",
        forgetting: float = 0.99,
        adapt: Literal["R", "Q"] = "R",
        structure: Literal["diagonal", "full"] = "diagonal",
        warm_up: int = 200,
        bounds: tuple[float, float] = (1 / 25, 25.0),
        means: bool = False,
        window: int = 1000,
        window_steps: int = 16,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        if adaptation not in ADAPTATIONS:
            raise FilterError(f"adaptation = {adaptation!r}: must be one of {', '.join(ADAPTATIONS)}")
        self._noise: NoiseEstimator | None = None
        self._by_data = R is None and chol_R is None
        if adaptation == "likelihood" and isinstance(model, Model):
            self._noise = NoiseEstimator(model.n, model.m, window, window_steps)
            start = state_vector("x0", x0, model.n), lower_factor("P0", P0, model.n, definite=True)
            first_q, first_r = first_variances(model, *start)
            Q = np.diag(first_q) if Q is None and chol_Q is None else Q
            R = np.diag(first_r) if self._by_data else R
        for name, value, factor in (("Q", Q, chol_Q), ("R", R, chol_R)):
            if value is None and factor is None and adaptation != "likelihood":
                raise FilterError(
                    f"{name} = None: adaptation {adaptation!r} needs a start, only 'likelihood' finds one"
                )
        super().__init__(
            model,
            x0,
            P0,
            Q,
            R,
            chol_Q=chol_Q,
            chol_R=chol_R,
            gate=gate,
            arena=arena,
            more=self._noise.size if self._noise else 0,
        )
        n, m = model.n, model.m
        weights = scaled_weights(n, alpha, beta, kappa)
        rho = checked_forgetting(forgetting)
        if self._noise is not None:
            work = np.concatenate([sigma_point_work(n, m, weights, self._gate_limits), np.zeros(room_size(n, m))])
            self._build(
                likelihood_step, work, RING=self._noise.ring, WINDOW=self._noise.window, TURN=self._noise.turn,
                CHANGE_LIMIT=self._noise.change_limit,
            )  # fmt: skip
            return
        if adaptation == "off":
            self._build(step, sigma_point_work(n, m, weights, self._gate_limits))
            return
        if adaptation == "sage-husa":
            settings = sage_husa_settings(rho, means)
        else:
            _check_limits(adapt, structure, warm_up, bounds)
            settings = limited_settings(m, rho, adapt == "Q", structure == "full", warm_up, bounds)
        work = form_work(n, m, weights, self._gate_limits, settings)
        self._build(form_step, work, factor_form=factor_array, reduce_form=reduce_array, ADAPTIVE=True)

    @staticmethod
    def arena_size(n: int, m: int, adaptation: str = "likelihood", window: int = 1000, window_steps: int = 16) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        more = NoiseEstimator(n, m, window, window_steps).size if adaptation == "likelihood" else 0
        return AdaptiveFilter.arena_size(n, m) + more

    @property
    def _window(self) -> Vector:
        return self._own[adaptive_offsets(self.model.n, self.model.m)[-1] :]

    def _reset_own(self) -> None:
        super()._reset_own()
        if self._noise is not None:
            variances = np.square(self._q).sum(axis=0), np.square(self._r).sum(axis=0)
            self._noise.start(self._window, self._factor, *variances, self._by_data)

    @property
    def Q(self) -> Matrix:
        """(n, n) process noise per step, as estimated; setting it is a new start."""
        return self._q.T @ self._q

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        AdaptiveFilter.Q.__set__(self, value)  # type: ignore[attr-defined]
        if self._noise is not None:
            self._noise.set_q(self._window, np.square(self._q).sum(axis=0))

    @property
    def R(self) -> Matrix:
        """(m, m) measurement noise, as estimated; setting it is a new start."""
        return self._r.T @ self._r

    @R.setter
    def R(self, value: ArrayLike) -> None:
        AdaptiveFilter.R.__set__(self, value)  # type: ignore[attr-defined]
        if self._noise is not None:
            self._noise.set_r(self._window, np.square(self._r).sum(axis=0))

    @property
    def noise_std(self) -> Vector:
        """(n + m,) relative standard deviations of the diagonals of Q and R by "likelihood" (of their logarithms).

        inf: not estimated yet, or by another adaptation.
        """
        if self._noise is None:
            return np.full(self.model.n + self.model.m, np.inf)
        return self._noise.std_of_logs(self._window)

    @property
    def noise_changes(self) -> int:
        """Times that "likelihood" found the noise changed and dropped what was older."""
        return 0 if self._noise is None else self._noise.changes(self._window)


def _check_limits(adapt: str, structure: str, warm_up: int, bounds: tuple[float, float]) -> None:
    if adapt not in {"R", "Q"}:
        raise FilterError(
            f"adapt = {adapt!r}: must be 'R' or 'Q'; both cannot be told from the innovation's covariance"
        )
    if structure not in {"diagonal", "full"}:
        raise FilterError(f"structure = {structure!r}: must be 'diagonal' or 'full'")
    if isinstance(warm_up, bool) or not isinstance(warm_up, int | np.integer) or warm_up < 0:
        raise FilterError(f"warm_up = {warm_up!r}: must be a whole number of steps >= 0")
    try:
        low, high = (float(bound) for bound in bounds)
    except (TypeError, ValueError) as error:
        raise FilterError(f"bounds = {bounds!r}: must be two ratios") from error
    if not 0.0 < low <= 1.0 <= high < np.inf:
        raise FilterError(f"bounds = {bounds!r}: must be two ratios, 0 < low <= 1 <= high")
