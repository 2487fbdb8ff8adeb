"""Normalised errors and innovations of the unscented family over 200 runs on the cylinder, same truth for all.

The forms are equal with the same alpha (`test_ukf.py`): one alpha each is enough.
"""

import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, model
from scipy.stats import chi2

from servohil.estimators import SRUKF
from servohil.estimators.asrukf import ASRUKF
from servohil.estimators.aukf import AUKF
from servohil.estimators.ukf import UKF

RUNS, STEPS = 200, 300
TIMES = (0, 20, 50, 100, 200, 299)
Q, R = np.diag(PROCESS_STD**2), np.diag(MEASUREMENT_STD**2)

FILTERS = {
    "array": (SRUKF, {}),
    "vdm": (SRUKF, {"variant": "vdm"}),
    "covariance, alpha 1e-3": (UKF, {"alpha": 1e-3}),
}


@pytest.fixture(scope="module")
def truth():
    rng = np.random.default_rng(11)
    plant = model()
    time = np.arange(STEPS) * 1e-3
    inputs = np.column_stack([3 * np.cos(40 * time), np.full(STEPS, 14e6), np.full(STEPS, 0.9e6)])
    process = PROCESS_STD * rng.normal(size=(RUNS, STEPS, 4))
    states = np.empty((RUNS, STEPS, 4))
    for run in range(RUNS):
        x = X0 + np.sqrt(np.diag(P0)) * rng.normal(size=4)
        for k in range(STEPS):
            x = plant.advance(x, inputs[k]) + process[run, k]
            states[run, k] = x
    return inputs, states[:, :, [0, 2, 3]] + MEASUREMENT_STD * rng.normal(size=(RUNS, STEPS, 3)), states


@pytest.mark.parametrize("name", FILTERS)
def test_errors_and_innovations_have_the_size_the_filter_claims(truth, name):
    """NEES at six times and NIS over all, inside a family-wise 99.9 % chi-square interval."""
    inputs, samples, states = truth
    kind, options = FILTERS[name]
    ours = kind(model(), X0, P0, Q, R, **options)
    nees, nis = np.zeros(len(TIMES)), 0.0
    for run in range(RUNS):
        ours.reset()
        trajectory = ours.run(inputs, samples[run])
        error = (states[run] - trajectory.x)[list(TIMES)]
        nees += np.einsum("ki,ki->k", error, np.linalg.solve(trajectory.P[list(TIMES)], error[:, :, None])[:, :, 0])
        nis += trajectory.nis.sum()
    tail = 0.001 / (len(TIMES) + 1) / 2
    assert (nees > chi2.ppf(tail, 4 * RUNS)).all() and (nees < chi2.isf(tail, 4 * RUNS)).all(), nees / RUNS
    freedom = 3 * RUNS * STEPS
    assert chi2.ppf(tail, freedom) < nis < chi2.isf(tail, freedom), nis / RUNS / STEPS


@pytest.mark.parametrize(("kind", "base"), [(AUKF, UKF), (ASRUKF, SRUKF)])
def test_adaptation_off_is_one_of_these(truth, kind, base):
    inputs, samples, _ = truth
    off = kind(model(), X0, P0, Q, R, adaptation="off").run(inputs, samples[0])
    assert off.P.tobytes() == base(model(), X0, P0, Q, R).run(inputs, samples[0]).P.tobytes()
