"""Linear systems for the tests of the Kalman filters: random ones, and the actuator of P2."""

from functools import cache

import numpy as np
from reference_filters import linear_f, linear_h, random_linear

from servohil.estimators import Model
from servohil.estimators.models import eha

EHA_A, EHA_B = eha.linear_matrices(eha.EhaParameters())
EHA_C = np.array([[1.0, 0.0, 0.0]])


def as_model(a, b, c) -> Model:
    """x+ = A x + b u, y = C x; all of one size share one compilation."""
    return Model(linear_f, linear_h, len(a), len(c), np.concatenate([a.ravel(), b, c.ravel()]), 1.0, "discrete")


@cache
def random_system(n: int, m: int):
    """Model, A, b, C, Q, R, P0."""
    a, b, c, q, r, p0 = random_linear(n, m, 100 * n + m)
    return as_model(a, b, c), a, b, c, q, r, p0


@cache
def actuator() -> Model:
    """The linear actuator, eq. 76 of P2."""
    return as_model(EHA_A, EHA_B, EHA_C)


def excitation(steps: int, m: int, seed: int):
    """Random inputs (steps, 1) and outputs (steps, m) with missing channels, and steps without any."""
    rng = np.random.default_rng(seed)
    inputs, outputs = rng.normal(size=(steps, 1)), 3 * rng.normal(size=(steps, m))
    for k in range(3, steps, 7):
        outputs[k, rng.integers(m)] = np.nan
    outputs[49::50] = np.nan
    return inputs, outputs
