"""KF and EKF on the actuator of P2: estimation error and innovation have the size the filters claim.

Noise as P2 prints it: R = 1e-13 m2, Q = diag(1e3, 10, 1e2) of eq. 77, P0 = 10 I. That is 30 m of position noise per
step, so a physically scaled twin beside it: the same R, and per step 1 nm, 10 um/s and 10 mm/s2 rms.
"""

import numpy as np
import pytest
from linear_bench import EHA_A, EHA_B, actuator
from scipy.stats import chi2

from servohil.estimators.ekf import EKF
from servohil.estimators.kf import KF

RUNS, STEPS = 200, 300
TIMES = (0, 10, 30, 100, 200, 299)
R = 1e-13
NOISE = {
    "P2": (np.array([1e3, 10.0, 1e2]), np.full(3, 10.0)),
    "scaled": (np.square([1e-9, 1e-5, 1e-2]), np.square([1e-3, 1e-2, 1.0])),
}
FAMILY = 2 * len(NOISE) * (len(TIMES) + 1)  # intervals that hold together with 99.9 %


@pytest.mark.parametrize("noise", list(NOISE))
def test_estimation_error_and_innovation_have_the_size_the_filters_claim(noise):
    q, p0 = NOISE[noise]
    rng = np.random.default_rng(11)
    inputs = 5e-5 * np.sin(0.05 * np.arange(STEPS))[:, None]
    x = np.sqrt(p0) * rng.normal(size=(RUNS, 3))
    states = np.empty((STEPS, RUNS, 3))
    for k in range(STEPS):
        x = x @ EHA_A.T + EHA_B * inputs[k, 0] + np.sqrt(q) * rng.normal(size=(RUNS, 3))
        states[k] = x
    samples = states[..., :1] + np.sqrt(R) * rng.normal(size=(STEPS, RUNS, 1))
    for kind in (KF, EKF):
        ours = kind(actuator(), np.zeros(3), np.diag(p0), np.diag(q), [[R]])
        nees, nis = np.zeros(len(TIMES)), 0.0
        for run in range(RUNS):
            ours.reset()
            trajectory = ours.run(inputs, samples[:, run].copy())
            for i, k in enumerate(TIMES):
                error = states[k, run] - trajectory.x[k]
                deviations = np.sqrt(np.diag(trajectory.P[k]))
                scaled = trajectory.P[k] / np.outer(deviations, deviations)
                nees[i] += error / deviations @ np.linalg.solve(scaled, error / deviations)
            nis += trajectory.nis.sum()
        tail = 0.001 / FAMILY / 2
        low, high = chi2.ppf(tail, 3 * RUNS), chi2.isf(tail, 3 * RUNS)
        assert (nees > low).all() and (nees < high).all(), (kind, nees / RUNS)
        freedom = RUNS * STEPS
        assert chi2.ppf(tail, freedom) < nis < chi2.isf(tail, freedom), (kind, nis / freedom)
