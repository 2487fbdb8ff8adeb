import numpy as np
import pytest
from reference_filters import kalman, linear_f, linear_h, random_linear

from servohil.estimators import SRUKF, Model
from servohil.estimators.sensors import MultiRate, Sensor, SensorError

NAN = float("nan")
SENSORS = (Sensor((0,)), Sensor((2, 1), period=4, phase=3))


def test_a_filter_equals_one_whose_rows_are_deleted_and_a_held_value_does_not():
    a, b, c, q, r, p0 = random_linear(5, 3, 5)
    system = Model(linear_f, linear_h, 5, 3, np.concatenate([a.ravel(), b, c.ravel()]), 1.0, "discrete")
    sensors = MultiRate(3, SENSORS)
    ukf, held = SRUKF(system, np.zeros(5), p0, q, r), SRUKF(system, np.zeros(5), p0, q, r)
    rng = np.random.default_rng(3)
    x, p, readings = np.zeros(5), p0, np.full(3, NAN)
    for k in range(100):
        u, fresh = rng.normal(size=1), rng.normal(size=3)
        rows = [0, 1, 2] if k % 4 == 3 else [0]
        readings[rows] = fresh[rows]  # the others keep what was last read
        ukf.step(u, sensors.measurement(k, readings))
        held.step(u, readings)
        x, p, _, _ = kalman(a, b, c[rows], q, r[np.ix_(rows, rows)], x, p, u, fresh[rows])
        np.testing.assert_allclose(ukf.x, x, atol=1e-10)
        np.testing.assert_allclose(ukf.P, p, atol=1e-10)
    assert np.abs(held.x - x).max() > 0.1


def test_each_channel_comes_in_its_own_steps_and_nothing_is_allocated():
    sensors, readings = MultiRate(3, SENSORS), np.array([1.0, 2.0, 3.0])
    first = sensors.measurement(0, readings)
    np.testing.assert_array_equal(first, [1, NAN, NAN])
    assert sensors.measurement(3, readings) is first
    np.testing.assert_array_equal(first, [1, 2, 3])
    np.testing.assert_array_equal(sensors.measurement(10**15 + 7, readings), [1, 2, 3])
    np.testing.assert_array_equal(sensors.measurement(7, np.array([NAN, 2, NAN])), [NAN, 2, NAN])


def test_masking_a_record_is_the_same_as_step_by_step():
    sensors = MultiRate(3, SENSORS)
    samples = np.random.default_rng(0).normal(size=(20, 3))
    before = samples.copy()
    expected = [sensors.measurement(k, row).copy() for k, row in enumerate(samples, start=6)]
    np.testing.assert_array_equal(sensors.masked(samples, first=6), expected)
    np.testing.assert_array_equal(samples, before)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sensor((0,), period=0), "period = 0: must be >= 1"),
        (lambda: Sensor((0,), period=2.5), "period = 2.5: must be a whole number"),
        (lambda: Sensor((0,), period=4, phase=4), "phase = 4: must satisfy 0 <= phase < period = 4"),
        (lambda: Sensor(()), r"channels = \(\)"),
        (lambda: Sensor((0, -1)), r"channels = \(0, -1\)"),
        (lambda: Sensor((0, 0)), "one stands twice"),
        (lambda: MultiRate(3, [Sensor((0,))]), r"channels \[0\]: must be each of 0 .. 2"),
        (lambda: MultiRate(2, [Sensor((0, 1)), Sensor((1,))]), r"channels \[0, 1, 1\]"),
        (lambda: MultiRate(1, [Sensor((1,))]), r"channels \[1\]: must be each of 0 .. 0"),
        (lambda: MultiRate(1, [Sensor((0,))]).measurement(0, np.zeros(2)), "readings has length 2: must be 1"),
        (lambda: MultiRate(1, [Sensor((0,))]).masked(np.zeros((3, 2))), r"Y has shape \(3, 2\)"),
    ],
)
def test_refusals_name_argument_value_and_rule(make, words):
    with pytest.raises(SensorError, match=words):
        make()
