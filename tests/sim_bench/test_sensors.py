"""Sensor noise: its size, its independence, its repeatability."""

import numpy as np
import pytest

from servohil.sim_bench.sensors import Sensors, SensorStd

STATE = np.array([0.3, 0.1, 5e6, 6e6])
TRUTH = np.array([0.3, 5e6, 6e6, 14e6, 0.9e6, 1.5])


def read(std: SensorStd, n: int, seed: int = 1) -> np.ndarray:
    sensors = Sensors(std, np.random.default_rng(seed))
    return np.array([sensors.read(STATE, 14e6, 0.9e6, 1.5) for _ in range(n)])


def test_noise_has_the_stated_deviation_per_channel() -> None:
    std = SensorStd(20e-6, 2e4, 3e4, 4e4, 5e4, 0.01)
    noise = read(std, 20_000) - TRUTH
    expected = np.array([20e-6, 2e4, 3e4, 4e4, 5e4, 0.01])
    np.testing.assert_allclose(noise.std(axis=0), expected, rtol=0.03)
    assert np.all(np.abs(noise.mean(axis=0)) < 4.0 * expected / np.sqrt(20_000))
    correlation = np.corrcoef(noise.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.035


def test_no_deviation_reads_the_truth_and_leaves_the_other_channels_noise_alone() -> None:
    quiet = read(SensorStd(spool_v=0.0), 5)
    assert np.all(quiet[:, 5] == 1.5)
    np.testing.assert_array_equal(quiet[:, :5], read(SensorStd(spool_v=0.1), 5)[:, :5])


def test_a_seed_repeats_and_another_differs() -> None:
    np.testing.assert_array_equal(read(SensorStd(), 10), read(SensorStd(), 10))
    assert not np.array_equal(read(SensorStd(), 10), read(SensorStd(), 10, seed=2))


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_an_impossible_deviation_is_refused_by_name(value: float) -> None:
    with pytest.raises(ValueError, match="sensor_std supply_pa = "):
        SensorStd(supply_pa=value)
