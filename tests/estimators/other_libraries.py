"""One step of the unscented filter in filterpy and in Stone Soup, as oracles. Both draw the points anew after the
prediction, as we do."""

from collections.abc import Callable

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.models.transition.base import TransitionModel
from stonesoup.predictor.kalman import UnscentedKalmanPredictor
from stonesoup.types.array import CovarianceMatrix, StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.updater.kalman import UnscentedKalmanUpdater

Array = NDArray[np.float64]
Function = Callable[[Array], Array]
Estimate = tuple[Array, Array]


def filterpy_step(
    move: Function, see: Function, q: Array, r: Array, x: Array, p: Array, y: Array, scaling: tuple[float, float, float]
) -> Estimate:
    points = MerweScaledSigmaPoints(len(x), *scaling)
    ukf = UnscentedKalmanFilter(len(x), len(y), 1.0, hx=see, fx=lambda z, _: move(z), points=points)
    ukf.x, ukf.P, ukf.Q, ukf.R = x.copy(), p.copy(), q, r
    ukf.predict()
    ukf.update(y)
    return ukf.x, ukf.P


class _Plain:
    """A plain function of one state vector as a Stone Soup model with additive noise."""

    def __init__(self, function: Function, noise: Array, n: int) -> None:
        self.plain, self.noise, self.n = function, CovarianceMatrix(noise), n

    def function(self, state, noise=None, **_):
        columns = np.asarray(state.state_vector, dtype=float).T
        moved = np.array([self.plain(column) for column in columns]).T
        return StateVectors(moved) if moved.shape[1] > 1 else StateVector(moved)

    def covar(self, **_):
        return self.noise

    def rvs(self, *_, **__):
        raise NotImplementedError

    pdf = rvs
    ndim_state = property(lambda self: self.n)
    ndim_meas = property(lambda self: len(self.noise))


class _Transition(_Plain, TransitionModel):
    pass


class _Measurement(_Plain, MeasurementModel):
    mapping = ()


def stonesoup_step(
    move: Function, see: Function, q: Array, r: Array, x: Array, p: Array, y: Array, scaling: tuple[float, float, float]
) -> Estimate:
    alpha, beta, kappa = scaling
    options = {"alpha": alpha, "beta": beta, "kappa": kappa}
    prior = GaussianState(StateVector(x), CovarianceMatrix(p))
    predicted = UnscentedKalmanPredictor(_Transition(move, q, len(x)), **options).predict(prior)
    measured = Detection(StateVector(y), measurement_model=_Measurement(see, r, len(x)))
    state = UnscentedKalmanUpdater(**options).update(SingleHypothesis(predicted, measured))
    return np.asarray(state.state_vector, dtype=float).ravel(), np.asarray(state.covar, dtype=float)
