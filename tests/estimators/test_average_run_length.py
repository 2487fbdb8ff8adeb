import numpy as np
import pytest
from scipy.special import ndtr

from servohil.estimators.leakage.sequential.average_run_length import (
    markov_run_length,
    siegmund_run_length,
    siegmund_threshold,
)

PER_MINUTE, PER_HOUR, PER_DAY, PER_YEAR = 6e4, 3.6e6, 8.64e7, 3.156e10  # samples at 1 kHz
# One-sided CUSUM, k = shift / 2: (samples between false alarms, shift, threshold, delay in ms at 1 kHz).
TABLE = [
    (PER_MINUTE, 0.25, 29.0, 209), (PER_MINUTE, 0.5, 16.7, 63), (PER_MINUTE, 1.0, 9.1, 19), (PER_MINUTE, 2.0, 4.7, 5),
    (PER_HOUR, 0.25, 45.4, 340), (PER_HOUR, 0.5, 24.9, 96), (PER_HOUR, 1.0, 13.2, 27), (PER_HOUR, 2.0, 6.7, 7),
    (PER_DAY, 0.25, 58.1, 442), (PER_DAY, 0.5, 31.2, 122), (PER_DAY, 1.0, 16.4, 33), (PER_DAY, 2.0, 8.3, 9),
    (PER_YEAR, 0.25, 81.7, 631), (PER_YEAR, 0.5, 43.0, 169), (PER_YEAR, 1.0, 22.3, 45), (PER_YEAR, 2.0, 11.3, 12),
]  # fmt: skip


def integral_equation(shift, reference, threshold, lower=0.0, nodes=200):
    """Page's integral equation of the run length by Gauss-Legendre quadrature: no cells, no chain."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    y = lower + 0.5 * (threshold - lower) * (x + 1.0)
    w = w * 0.5 * (threshold - lower)
    start = np.concatenate([[0.0], y])
    drift = shift - reference
    density = np.exp(-0.5 * (y[None, :] - start[:, None] - drift) ** 2) / np.sqrt(2.0 * np.pi)
    kernel = np.concatenate([ndtr(lower - start - drift)[:, None], density * w], axis=1)
    return np.linalg.solve(np.eye(nodes + 1) - kernel, np.ones(nodes + 1))[0]


@pytest.mark.parametrize(("samples", "shift", "threshold", "delay_ms"), TABLE)
def test_published_thresholds_and_delays(samples, shift, threshold, delay_ms):
    h = siegmund_threshold(samples, shift / 2)
    assert h == pytest.approx(threshold, rel=0.005, abs=0.05)  # the table has one decimal
    assert markov_run_length(shift, shift / 2, h) == pytest.approx(delay_ms, rel=0.02, abs=0.51)
    assert siegmund_run_length(shift, shift / 2, h) == pytest.approx(delay_ms, rel=0.02, abs=0.51)


@pytest.mark.parametrize(
    ("shift", "reference", "threshold", "lower"),
    [
        (0.0, 0.5, 5.0, 0.0), (0.0, 0.5, 8.0, 0.0), (0.0, 0.125, 29.0, 0.0), (0.0, 2.0, 2.0, 0.0), (0.3, 0.5, 9.0, 0.0),
        (1.0, 0.5, 13.0, 0.0), (-0.4, 0.1, 4.0, 0.0), (3.0, 0.5, 13.0, 0.0), (0.0, 0.5, 7.0, -6.0),
        (1.0, 0.5, 13.8, -6.9), (0.0, 1.5, 3.0, -1.0), (0.0, 0.05, 20.0, -40.0),
    ],
)  # fmt: skip
def test_chain_agrees_with_the_integral_equation(shift, reference, threshold, lower):
    exact = integral_equation(shift, reference, threshold, lower)
    assert markov_run_length(shift, reference, threshold, lower) == pytest.approx(exact, rel=2e-3)


def test_known_run_lengths():
    """Lucas and Crosier 1982: 168 and 465 for both sides together."""
    assert round(markov_run_length(0.0, 0.5, 4.0) / 2.0) == 168
    assert round(markov_run_length(0.0, 0.5, 5.0) / 2.0) == 465
    assert siegmund_run_length(0.0, 0.5, 5.0) == pytest.approx(938.0, rel=1e-3)


@pytest.mark.parametrize("threshold", [12.0, 22.0, 45.0, 70.0])
def test_rare_alarms_lose_no_digits(threshold):
    """Siegmund's error is of the boundary alone: the same however long the run."""
    error = markov_run_length(0.0, 0.5, threshold) / siegmund_run_length(0.0, 0.5, threshold)
    assert error == pytest.approx(0.9921, abs=2e-3 + 2e-4 * threshold)


def test_siegmund_without_drift_is_the_limit():
    around = [siegmund_run_length(0.5 + d, 0.5, 10.0) for d in (-1e-3, -1e-7, 0.0, 1e-7, 1e-3)]
    assert around[2] == pytest.approx((10.0 + 1.166) ** 2)
    assert np.all(np.diff(around) < 0.0)


@pytest.mark.parametrize("reference", [0.05, 0.5, 2.0])
@pytest.mark.parametrize("samples", [1e3, 1e6, 1e12, 1e40])
def test_threshold_is_the_inverse(reference, samples):
    h = siegmund_threshold(samples, reference)
    if h > 0.0:
        assert siegmund_run_length(0.0, reference, h) == pytest.approx(samples, rel=1e-6)
