"""Noise of experiments: its moments, its schedule, what it is bounded by; faults of sensors; refusals."""

from collections.abc import Callable
from typing import cast

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm

from servohil.sim_bench.noise import (
    biased,
    delayed,
    dropped,
    gaussian,
    quantised,
    scheduled,
    truncated_gaussian,
    truncated_variance,
)

N = 100_000
RECORD = np.arange(12.0).reshape(6, 2)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_schedule_changes_at_the_steps_of_its_times_and_back() -> None:
    found = scheduled(20_001, 1e-3, (1e-7, 1e-5), [(4.0, 16.0, (1e-5, 1e-3))])
    assert found.shape == (20_001, 2)
    changed = np.flatnonzero(found[:, 0] != 1e-7)
    assert (changed[0], changed[-1], len(changed)) == (4000, 16_000, 12_001)  # P1: 4 s <= t <= 16 s
    np.testing.assert_array_equal(found[4000:16_001], np.tile([1e-5, 1e-3], (12_001, 1)))
    np.testing.assert_array_equal(found[16_001:], np.tile([1e-7, 1e-5], (4000, 1)))


def test_a_schedule_hits_its_steps_in_spite_of_rounding_and_may_reach_beyond_the_end() -> None:
    assert 0.7 / 0.1 < 7.0
    changes = [(0.2, 0.7, (2.0,)), (0.5, 0.5, (3.0,))]
    np.testing.assert_array_equal(scheduled(10, 0.1, (1.0,), changes)[:, 0], [1, 1, 2, 2, 2, 3, 2, 2, 1, 1])
    assert 2.1 / 0.3 > 7.0
    np.testing.assert_array_equal(scheduled(9, 0.3, (1.0,), [(2.1, np.inf, (4.0,))])[:, 0], [1] * 7 + [4] * 2)


def test_gaussian_noise_has_the_variance_of_every_step_and_channel() -> None:
    noise = gaussian(rng(), scheduled(2 * N, 1.0, (4.0, 1e10, 0.0), [(N, 2 * N, (1.0, 1e12, 0.0))]))
    np.testing.assert_allclose(noise[:N, :2].var(axis=0), [4.0, 1e10], rtol=0.02)
    np.testing.assert_allclose(noise[N:, :2].var(axis=0), [1.0, 1e12], rtol=0.02)
    assert np.all(noise[:, 2] == 0.0)
    white = noise[:N, :2] / [2.0, 1e5]
    assert np.all(np.abs(white.mean(axis=0)) < 4.0 / np.sqrt(N))
    assert abs(np.mean(white[:, 0] * white[:, 1])) < 4.0 / np.sqrt(N)
    assert np.all(np.abs(np.mean(white[1:] * white[:-1], axis=0)) < 4.0 / np.sqrt(N))


@pytest.mark.parametrize("ratio", [1e-3, 0.3, 1.0, 3.0, 9.0])
def test_truncated_noise_is_scipys(ratio: float) -> None:
    std = 20e-6
    variances = np.full((N, 1), std**2)
    noise = truncated_gaussian(rng(), variances, ratio * std)[:, 0]
    oracle = truncnorm(-ratio, ratio, scale=std)
    assert np.abs(noise).max() <= ratio * std
    assert abs(noise.mean()) < 4.0 * oracle.std() / np.sqrt(N)
    assert noise.var() == pytest.approx(oracle.var(), rel=0.02)
    assert kstest(noise, oracle.cdf).pvalue > 1e-3


@pytest.mark.parametrize("ratio", [0.019, 0.021, 0.3, 1.0, 3.0, 9.0, 100.0])
def test_the_variance_that_truncation_leaves_is_scipys(ratio: float) -> None:
    expected = truncnorm(-ratio, ratio).var() * 9.0
    found = truncated_variance([[9.0]], 3.0 * ratio)
    np.testing.assert_allclose(found, [[expected]], rtol=1e-7)


def test_a_bound_far_inside_the_deviation_leaves_a_uniform_variance() -> None:
    np.testing.assert_allclose(truncated_variance([[1.0]], 1e-6), [[1e-12 / 3.0]], rtol=1e-9)


def test_truncation_per_channel_with_no_bound_and_no_noise() -> None:
    variances = np.tile([1.0, 4.0, 0.0], (N, 1))
    noise = truncated_gaussian(rng(), variances, (0.5, np.inf, 1.0))
    assert np.abs(noise[:, 0]).max() <= 0.5
    assert noise[:, 1].var() == pytest.approx(4.0, rel=0.02)
    assert np.all(noise[:, 2] == 0.0)
    np.testing.assert_allclose(truncated_variance(variances[:1], (0.5, np.inf, 1.0))[0, 1:], [4.0, 0.0])


def test_noise_is_finite_also_at_the_generators_smallest_number() -> None:
    class Zero:
        def random(self, shape: tuple[int, int]) -> np.ndarray:
            return np.zeros(shape)

    noise = truncated_gaussian(cast(np.random.Generator, Zero()), [[4.0, 4.0, 0.0]], (np.inf, 2.0, 1.0))
    np.testing.assert_array_equal(noise[0, 1:], [-2.0, 0.0])
    assert -20.0 < noise[0, 0] < -16.0


def test_a_bias_starts_at_its_step() -> None:
    found = biased(RECORD, (0.5, -1.0), first_step=4)
    np.testing.assert_array_equal(found[:4], RECORD[:4])
    np.testing.assert_array_equal(found[4:], RECORD[4:] + np.array([0.5, -1.0]))
    np.testing.assert_array_equal(biased(RECORD, 2.0), RECORD + 2.0)


def test_quantised_samples_are_the_nearest_multiples() -> None:
    samples = rng().normal(size=(1000, 2))
    found = quantised(samples, (0.25, 0.0))
    np.testing.assert_array_equal(found[:, 0] % 0.25, 0.0)
    assert 0.12 < np.abs(found[:, 0] - samples[:, 0]).max() <= 0.125
    np.testing.assert_array_equal(found[:, 1], samples[:, 1])
    assert np.isnan(quantised([[np.nan]], 0.1)).all()  # what is lost stays lost


def test_a_delay_shifts_each_channel_by_whole_steps() -> None:
    found = delayed(RECORD, (2, 0))
    assert np.isnan(found[:2, 0]).all()
    np.testing.assert_array_equal(found[2:, 0], RECORD[:4, 0])
    np.testing.assert_array_equal(found[:, 1], RECORD[:, 1])
    np.testing.assert_array_equal(delayed(RECORD, 1)[1:], RECORD[:-1])
    assert np.isnan(delayed(RECORD, 7)).all()


def test_dropout_loses_its_share_of_whole_steps() -> None:
    samples = np.ones((N, 3))
    lost = np.isnan(dropped(rng(), samples, 0.3))
    np.testing.assert_array_equal(lost, np.tile(lost[:, :1], (1, 3)))
    assert lost[:, 0].mean() == pytest.approx(0.3, abs=4.0 * np.sqrt(0.3 * 0.7 / N))
    assert np.mean(lost[1:, 0] & lost[:-1, 0]) == pytest.approx(0.09, abs=0.005)  # each step on its own


def test_dropout_per_channel_is_independent() -> None:
    lost = np.isnan(dropped(rng(), np.ones((N, 3)), (0.2, 0.5, 0.0)))
    np.testing.assert_allclose(lost.mean(axis=0), [0.2, 0.5, 0.0], atol=0.006)
    assert np.mean(lost[:, 0] & lost[:, 1]) == pytest.approx(0.1, abs=0.005)
    assert np.isnan(dropped(rng(), RECORD, 1.0)).all()


CHANGES: list[Callable[[np.ndarray], np.ndarray]] = [
    lambda record: biased(record, 1.0),
    lambda record: quantised(record, 0.7),
    lambda record: delayed(record, 1),
    lambda record: dropped(rng(), record, 0.5),
    lambda record: gaussian(rng(), record),
    lambda record: truncated_gaussian(rng(), record, 1.0),
]


@pytest.mark.parametrize("change", CHANGES)
def test_the_argument_stays_and_a_seed_repeats(change: Callable[[np.ndarray], np.ndarray]) -> None:
    record = RECORD + 1.0
    first = change(record)
    np.testing.assert_array_equal(record, RECORD + 1.0)
    assert not np.array_equal(first, record, equal_nan=True)
    np.testing.assert_array_equal(first, change(record))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: scheduled(0, 1e-3, (1.0,)), "steps = 0"),
        (lambda: scheduled(5, 0.0, (1.0,)), r"dt_s = 0\.0"),
        (lambda: scheduled(5, 1e-3, (1.0, -2.0)), r"base holds -2\.0: must be finite and >= 0"),
        (lambda: scheduled(5, 1e-3, 1.0), r"base has shape \(\): expected \(channels,\)"),
        (lambda: scheduled(5, 1e-3, (1.0,), [(3.0, 2.0, (1.0,))]), r"change from 3\.0 s to 2\.0 s: expected"),
        (lambda: scheduled(5, 1e-3, (1.0,), [(1.0, 2.0, (1.0, 2.0))]), "2 variances, base has 1"),
        (lambda: scheduled(5, 1e-3, (1.0,), [(1.0, 2.0, (np.nan,))]), r"change from 1\.0 s to 2\.0 s holds nan"),
        (lambda: gaussian(rng(), (1.0, 1.0)), r"variances has shape \(2,\): expected \(steps, channels\)"),
        (lambda: gaussian(rng(), [[np.inf]]), "variances holds inf"),
        (lambda: truncated_gaussian(rng(), [[1.0]], 0.0), r"bound = 0\.0: must be > 0"),
        (lambda: truncated_gaussian(rng(), [[1.0]], np.nan), "bound = nan"),
        (lambda: truncated_variance([[1.0]], (1.0, 2.0)), r"bound has shape \(2,\)"),
        (lambda: biased(RECORD, np.nan), "bias = nan: must be finite"),
        (lambda: biased(RECORD, 1.0, first_step=-1), "first_step = -1"),
        (lambda: biased(RECORD[0], 1.0), r"samples have shape \(2,\)"),
        (lambda: quantised(RECORD, (0.1, -0.1)), r"step holds -0\.1"),
        (lambda: quantised(RECORD, (0.1, 0.1, 0.1)), r"step has shape \(3,\)"),
        (lambda: delayed(RECORD, 1.5), r"steps = 1\.5: delays are whole steps"),
        (lambda: delayed(RECORD, -1), r"steps holds -1\.0"),
        (lambda: dropped(rng(), RECORD, 1.5), r"probability = 1\.5: must be between 0 and 1"),
        (lambda: dropped(rng(), RECORD, (0.1, -0.1)), r"probability holds -0\.1"),
    ],
)
def test_what_cannot_be_is_refused_by_name(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
