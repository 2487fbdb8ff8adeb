"""The hypotheses' statistics against dense linear algebra and against densities of scipy."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from servohil.estimators.leakage.baseline import absorb, drift
from servohil.estimators.leakage.changes import N_CHANGES, N_LEAKS
from servohil.estimators.leakage.competition import (
    WORK_SIZE,
    all_together,
    evidence,
    likelihood_ratio,
    lower_cholesky,
    marginal,
    winner,
)
from servohil.estimators.leakage.information import (
    CHANNELS,
    CYCLES,
    INFORMATION_SIZE,
    RIGHT,
    SQUARES,
    complete,
    observe,
    shift,
)

C = N_CHANGES
SAMPLES = 40


def random_data(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """g (3 SAMPLES, C), z, P and the record of them."""
    rng = np.random.default_rng(seed)
    g = rng.normal(size=(3 * SAMPLES, C)) * np.exp(rng.normal(size=C))
    root = rng.normal(size=(C, C)) * 0.3
    p = root @ root.T + 0.01 * np.eye(C)
    z = g @ rng.multivariate_normal(np.zeros(C), p) + rng.normal(size=3 * SAMPLES)
    record = np.zeros(INFORMATION_SIZE)
    for k in range(SAMPLES):
        rows = slice(3 * k, 3 * k + 3)
        observe(record, np.concatenate([z[rows], g[rows].ravel()]), 3)
    complete(record)
    return g, z, p, record


def test_a_record_is_the_normal_equations() -> None:
    g, z, _, record = random_data(0)
    np.testing.assert_allclose(record[: C * C].reshape(C, C), g.T @ g, rtol=1e-12)
    np.testing.assert_allclose(record[RIGHT:SQUARES], g.T @ z, rtol=1e-10, atol=1e-10)
    assert record[SQUARES] == pytest.approx(z @ z)
    assert (record[CHANNELS], record[CYCLES]) == (3 * SAMPLES, SAMPLES)
    known = np.linspace(-1.0, 1.0, C)
    shift(record, known)
    np.testing.assert_allclose(record[RIGHT:SQUARES], g.T @ (z - g @ known), rtol=1e-9, atol=1e-9)
    assert record[SQUARES] == pytest.approx(np.sum((z - g @ known) ** 2))


@pytest.mark.parametrize("seed", range(4))
def test_marginal_information_and_ratios(seed: int) -> None:
    g, z, p, record = random_data(seed)
    diagonal, right, work = np.zeros(C), np.zeros(C), np.zeros(WORK_SIZE)
    assert marginal(record, np.linalg.cholesky(p), work, diagonal, right)
    noise = np.eye(len(z)) + g @ p @ g.T  # of z, theta integrated out
    w = g.T @ np.linalg.solve(noise, g)
    np.testing.assert_allclose(diagonal, np.diag(w), rtol=1e-8)
    np.testing.assert_allclose(right, g.T @ np.linalg.solve(noise, z), rtol=1e-8, atol=1e-8)
    nothing = multivariate_normal(np.zeros(len(z)), noise)
    for j in range(C):
        delta = right[j] / diagonal[j]  # the maximum of the likelihood
        ratio = 2.0 * (nothing.logpdf(z - g[:, j] * delta) - nothing.logpdf(z))
        assert likelihood_ratio(j, diagonal, right) == pytest.approx(ratio, rel=1e-6, abs=1e-8)
        for other in (0.9, 1.1):
            assert nothing.logpdf(z - g[:, j] * delta * other) <= nothing.logpdf(z - g[:, j] * delta)
        std = 0.7 + 0.2 * j
        changed = multivariate_normal(np.zeros(len(z)), noise + std**2 * np.outer(g[:, j], g[:, j]))
        bayes = changed.logpdf(z) - nothing.logpdf(z)
        assert evidence(j, diagonal, right, std) == pytest.approx(bayes, rel=1e-6, abs=1e-7)
    everything = multivariate_normal(np.zeros(len(z)), noise + g @ np.diag(np.full(C, 4.0)) @ g.T)
    together = all_together(record, work, right, np.full(C, 2.0), np.zeros((C, C)), np.zeros((C, C)))
    log_det = np.linalg.slogdet(noise + 4.0 * g @ g.T)[1] - np.linalg.slogdet(noise)[1]
    assert together == pytest.approx(2.0 * (everything.logpdf(z) - nothing.logpdf(z)) + log_det, rel=1e-6)


def test_the_winner_is_the_most_probable_and_no_oil_leaks_in() -> None:
    diagonal, right, confidence = np.full(C, 4.0), np.zeros(C), np.zeros(C + 1)
    step, none = np.full(C, 3.0), np.zeros(C)
    assert winner(diagonal, right, step, none, confidence) == C
    assert confidence.sum() == pytest.approx(1.0) and confidence[C] == confidence.max()
    right[5] = -20.0
    assert winner(diagonal, right, step, none, confidence) == 5 and confidence[5] > 0.999
    right[5], right[1] = 0.0, -20.0
    assert winner(diagonal, right, step, none, confidence) == C
    amounts = none.copy()
    amounts[1] = 5.0  # it leaks by as much as is missing: it has closed
    assert winner(diagonal, right, step, amounts, confidence) == 1
    assert N_LEAKS == 3


def test_one_factor_for_semidefinite_matrices() -> None:
    out = np.zeros((C, C))
    matrix = np.diag([1.0] * (C - 1) + [0.0])
    assert lower_cholesky(matrix, out)
    np.testing.assert_allclose(out @ out.T, matrix, atol=1e-12)
    assert not lower_cholesky(np.diag([-1.0] + [1.0] * (C - 1)), out)
    assert not lower_cholesky(np.full((C, C), np.nan), out)


@pytest.mark.parametrize("seed", range(3))
def test_the_baseline_is_a_kalman_filter(seed: int) -> None:
    g, z, p, record = random_data(seed)
    theta, covariance = np.linspace(-0.2, 0.2, C), p.copy()
    rates = np.linspace(0.0, 0.1, C)
    drift(covariance, rates, 4.0)
    np.testing.assert_allclose(covariance, p + np.diag(4.0 * rates**2))
    prior, before = covariance.copy(), theta.copy()
    assert absorb(record, theta, covariance, np.zeros(WORK_SIZE))
    gain = prior @ g.T @ np.linalg.inv(g @ prior @ g.T + np.eye(len(z)))
    np.testing.assert_allclose(theta, before + gain @ (z - g @ before), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(covariance, prior - gain @ g @ prior, rtol=1e-6, atol=1e-10)
    np.testing.assert_array_equal(covariance, covariance.T)
    assert not absorb(record, theta, np.full((C, C), np.nan), np.zeros(WORK_SIZE))
