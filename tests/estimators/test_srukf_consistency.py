import numpy as np
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, model, srukf
from scipy.stats import chi2

RUNS, STEPS = 200, 300
TIMES = (0, 20, 50, 100, 200, 299)


def test_estimation_error_and_innovation_have_the_size_the_filter_claims():
    """NEES at six times and NIS over all, 200 runs, inside a family-wise 99.9 % chi-square interval."""
    rng = np.random.default_rng(11)
    plant, ukf = model(), srukf()
    time = np.arange(STEPS) * 1e-3
    inputs = np.column_stack([3 * np.cos(40 * time), np.full(STEPS, 14e6), np.full(STEPS, 0.9e6)])
    nees, nis = np.zeros(len(TIMES)), 0.0
    for _ in range(RUNS):
        x = X0 + np.sqrt(np.diag(P0)) * rng.normal(size=4)
        states, samples = np.empty((STEPS, 4)), np.empty((STEPS, 3))
        for k in range(STEPS):
            x = plant.advance(x, inputs[k]) + PROCESS_STD * rng.normal(size=4)
            states[k] = x
            samples[k] = x[[0, 2, 3]] + MEASUREMENT_STD * rng.normal(size=3)
        ukf.reset()
        trajectory = ukf.run(inputs, samples)
        for i, k in enumerate(TIMES):
            error = states[k] - trajectory.x[k]
            nees[i] += error @ np.linalg.solve(trajectory.P[k], error)
        nis += trajectory.nis.sum()
    tail = 0.001 / (len(TIMES) + 1) / 2
    assert (nees > chi2.ppf(tail, 4 * RUNS)).all() and (nees < chi2.isf(tail, 4 * RUNS)).all(), nees / RUNS
    freedom = 3 * RUNS * STEPS
    assert chi2.ppf(tail, freedom) < nis < chi2.isf(tail, freedom), nis / RUNS / STEPS
