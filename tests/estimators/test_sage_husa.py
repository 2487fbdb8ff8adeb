"""The two noise updates by themselves, against the formulas as printed, in plain numpy."""

import numpy as np
import pytest

from servohil.estimators.noise.adaptive_layout import (
    MEANS,
    N_UPDATES,
    N_USABLE,
    Q_FALLBACKS,
    R_FALLBACKS,
    adaptive_offsets,
)
from servohil.estimators.noise.limited_sage_husa import THETA, limited_sage_husa
from servohil.estimators.noise.sage_husa import LARGEST_GAIN, fading_gain, sage_husa

N, M = 4, 3


def covariance(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T / size + 0.3 * np.eye(size)


class Correction:
    """A linear correction with all its matrices, and what `correct` leaves of it."""

    def __init__(self, seed, error=1.0, n=N, m=M, q_scale=1.0):
        rng = np.random.default_rng(seed)
        self.n, self.m = n, m
        self.q, self.r = q_scale * covariance(rng, n), covariance(rng, m)
        self.p_prior = covariance(rng, n) + self.q
        h = rng.normal(size=(m, n))
        self.s = h @ self.p_prior @ h.T + self.r
        self.k = self.p_prior @ h.T @ np.linalg.inv(self.s)
        self.p = self.p_prior - self.k @ self.s @ self.k.T
        root = np.linalg.cholesky(self.s)
        self.e = error * root @ rng.normal(size=m)
        self.stack = rng.normal(size=(m + n + 2, m + n))  # rubbish below the diagonal
        self.stack[:m, :m] = np.triu(root.T) + np.tril(self.stack[:m, :m], -1)
        self.stack[:m, m:] = (self.k @ root).T
        self.white = np.linalg.solve(root, self.e)
        self.factor_q, self.factor_r = (np.linalg.cholesky(a).T.copy() for a in (self.q, self.r))
        start_q, start_r, size = adaptive_offsets(n, m)
        self.own = np.zeros(size)
        self.own[start_q:start_r] = self.factor_q.ravel()
        self.own[start_r:] = self.factor_r.ravel()
        self.scratch = np.full(2 * max(n, m) ** 2 + 2 * max(n, m), np.nan)

    def sage_husa(self, forgetting, means=False):
        factor = np.linalg.cholesky(self.p).T.copy()
        sage_husa(
            self.own, self.n, self.m, forgetting, means, self.stack, self.white, factor, self.factor_q, self.factor_r,
            self.scratch,
        )  # fmt: skip
        return self.factor_q.T @ self.factor_q, self.factor_r.T @ self.factor_r

    def limited(self, forgetting=0.99, of_q=False, full=False, low=1e-9, high=1e9, warm_up=0.0):
        limited_sage_husa(
            self.own, self.n, self.m, forgetting, warm_up, of_q, full, low, high, self.stack, self.white, self.factor_q,
            self.factor_r, self.scratch,
        )  # fmt: skip
        return self.factor_q.T @ self.factor_q if of_q else self.factor_r.T @ self.factor_r

    def printed(self, gain):
        outer = np.outer(self.e, self.e)
        r = (1 - gain) * self.r + gain * (outer - (self.s - self.r))
        q = (1 - gain) * self.q + gain * (self.k @ outer @ self.k.T + self.p - (self.p_prior - self.q))
        return q, r


def test_the_gain_is_that_of_a_fading_mean_but_for_its_first_samples():
    for k in (1, 5, 40, 400):
        for rho in (0.5, 0.98, 0.999):
            assert fading_gain(k, rho) == pytest.approx(
                min((1 - rho) / (1 - rho**k), max(LARGEST_GAIN, 1 - rho)), rel=1e-9
            )
    assert fading_gain(1.0, 0.98) == LARGEST_GAIN < 1


def test_equals_the_printed_formulas_with_eq_19_where_they_fail():
    used = set()
    for seed in range(40):
        for error, forgetting, q_scale in ((1.0, 0.99, 1.0), (0.01, 0.95, 1e-3), (3.0, 0.5, 1.0)):
            case = Correction(seed, error, *((N, M), (2, 5))[seed % 2], q_scale)
            case.own[N_UPDATES] = seed
            gain = fading_gain(seed + 1.0, forgetting)
            q, r = case.printed(gain)
            fallbacks = [np.linalg.eigvalsh(matrix)[0] <= 0 for matrix in (q, r)]
            q = case.q + gain * (case.p_prior - case.q) if fallbacks[0] else q
            r = case.r + gain * (case.s - case.r) if fallbacks[1] else r
            new_q, new_r = case.sage_husa(forgetting)
            np.testing.assert_allclose(new_q, q, atol=1e-12)
            np.testing.assert_allclose(new_r, r, atol=1e-12)
            assert list(case.own[[N_UPDATES, Q_FALLBACKS, R_FALLBACKS]]) == [seed + 1, *fallbacks]
            assert (case.own[MEANS : MEANS + case.n + case.m] == 0).all()
            used.add(tuple(fallbacks))
    assert len(used) == 4  # every combination was met


def test_means_follow_the_innovation_and_the_correction():
    case = Correction(3)
    case.own[MEANS : MEANS + N + M] = before = np.arange(N + M, dtype=float)
    case.sage_husa(0.9, means=True)
    gain = fading_gain(1.0, 0.9)
    # q <- (1 - G) q + G (x+ - f), f without q;  r <- (1 - G) r + G (y - g), g without r
    change = np.concatenate([case.k @ case.e, case.e])
    np.testing.assert_allclose(case.own[MEANS : MEANS + N + M], (1 - gain) * before + gain * (before + change))


def test_variances_stay_below_what_a_filter_can_square():
    case = Correction(1)
    case.white[:] = 1e140
    for _ in range(10):
        q, r = case.sage_husa(0.9)
        assert np.isfinite(q).all() and np.isfinite(r).all() and max(q.max(), r.max()) < 1e100


@pytest.mark.parametrize("of_q", [False, True])
def test_the_limited_form_is_the_printed_one_while_the_limit_does_not_act(of_q):
    for seed in range(20):
        gain = fading_gain(1.0, 0.999)
        case, diagonal = Correction(seed), Correction(seed)
        start = case.q if of_q else case.r
        # small enough a correction that neither limit acts
        share = 0.5 * np.linalg.eigvalsh(start)[0] / 4 / gain
        for c in (case, diagonal):
            weight = np.sqrt(share / np.abs(np.linalg.norm(c.k @ c.s @ c.k.T if of_q else c.s)))
            c.stack *= weight
            c.s, c.e = weight**2 * c.s, weight * c.e
        outer = np.outer(case.e, case.e) - case.s
        printed = start + gain * (case.k @ outer @ case.k.T if of_q else outer)
        np.testing.assert_allclose(case.limited(0.999, of_q, full=True), printed, atol=1e-12)
        np.testing.assert_allclose(diagonal.limited(0.999, of_q), np.diag(np.diag(printed)), atol=1e-12)
        for c in (case, diagonal):
            assert c.own[N_UPDATES] == 1 and c.own[Q_FALLBACKS] == 0 and c.own[R_FALLBACKS] == 0


@pytest.mark.parametrize("of_q", [False, True])
@pytest.mark.parametrize("full", [False, True])
def test_the_limited_form_stays_definite_whatever_comes(of_q, full):
    rng = np.random.default_rng(5)
    for seed in range(200):
        case = Correction(seed)
        start = case.q if of_q else case.r
        case.stack *= 10.0 ** rng.uniform(-1, 6)
        case.white *= 10.0 ** rng.uniform(-6, 3)
        limited = case.limited(0.5, of_q, full)
        least = (1 - THETA) * (start if full else np.diag(np.diag(start)))
        assert np.linalg.eigvalsh(limited - (1 - 1e-6) * least)[0] > 0
        assert case.own[Q_FALLBACKS if of_q else R_FALLBACKS] <= 1
    assert case.own[R_FALLBACKS if of_q else Q_FALLBACKS] == 0


@pytest.mark.parametrize("full", [False, True])
def test_the_limited_form_keeps_to_its_bounds_and_to_zero(full):
    grown, shrunk = Correction(1), Correction(1)
    for _ in range(3000):
        grown.white[:] = 2.0
        shrunk.white[:] = 0.0
        large = grown.limited(0.9, full=full, low=0.5, high=3.0)
        small = shrunk.limited(0.9, full=full, low=0.5, high=3.0)
    np.testing.assert_allclose(np.diag(large), 3.0 * np.diag(grown.r), rtol=1e-12)
    ratio = np.diag(small) / np.diag(shrunk.r)  # the full form also stops before some direction is too small
    assert (ratio > 0.5 - 1e-12).all() and (ratio < (0.9 if full else 0.5 + 1e-12)).all()
    root = np.linalg.inv(np.linalg.cholesky(shrunk.r))
    assert np.linalg.eigvalsh(root @ small @ root.T)[0] > (0.5 / M if full else 0.0)
    silent = Correction(2)
    silent.factor_q[:, 2] = silent.factor_q[2] = 0.0  # no noise enters state 2
    start_q, start_r, _ = adaptive_offsets(N, M)
    silent.own[start_q:start_r] = silent.factor_q.ravel()
    q = silent.limited(of_q=True, full=full)
    assert (q[2] == 0).all() and (q[:, 2] == 0).all() and np.isfinite(q).all()


def test_the_limited_form_waits_for_its_warm_up():
    case = Correction(1)
    for k in range(5):
        np.testing.assert_allclose(case.limited(warm_up=5.0), case.r, rtol=1e-14)
        assert case.own[N_UPDATES] == 0 and case.own[N_USABLE] == k + 1
    assert np.abs(case.limited(warm_up=5.0) - case.r).max() > 1e-3
    assert case.own[N_UPDATES] == 1
