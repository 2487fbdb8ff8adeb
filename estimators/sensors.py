"""Sensors with rates of their own: which channels of y bring a new sample in which step.

A sensor that samples every fourth cycle leaves its last value in a register for the three in between. Fed again, that
value would count four times, with the same error each time. Here it is used in the step it belongs to, and the channel
is missing (NaN) in the others. Time is the number of the cycle, an integer.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class SensorError(ValueError):
    """Sensors or readings were refused; the message names the argument, its value and the rule."""


@dataclass(frozen=True)
class Sensor:
    """One device: the channels of y that it measures together, in steps k with (k - phase) % period == 0.

    Args:
        channels: indices into y.
        period: steps from one sample to the next.
        phase: step of the first sample, 0 <= phase < period.

    Raises:
        SensorError: no channel, one twice, a period below 1, or a phase outside the period.
    """

    channels: tuple[int, ...]
    period: int = 1
    phase: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", tuple(self.channels))
        for name in ("period", "phase"):
            if not _is_whole(getattr(self, name)):
                raise SensorError(f"{name} = {getattr(self, name)!r}: must be a whole number of steps")
        if self.period < 1:
            raise SensorError(f"period = {self.period}: must be >= 1")
        if not 0 <= self.phase < self.period:
            raise SensorError(f"phase = {self.phase}: must satisfy 0 <= phase < period = {self.period}")
        if not self.channels or not all(_is_whole(channel) and channel >= 0 for channel in self.channels):
            raise SensorError(f"channels = {self.channels!r}: must be one or more indices of y")
        if len(set(self.channels)) < len(self.channels):
            raise SensorError(f"channels = {self.channels!r}: one stands twice")


class MultiRate:
    """Fills a filter's y from the last readings of several sensors.

    An input that comes seldom (a supply pressure at 100 Hz) is no case for this: u is held by the caller.

    Args:
        m: outputs of the model.
        sensors: together they measure every output exactly once.

    Raises:
        SensorError: an output with no sensor or with two, or a channel that the model does not have.
    """

    def __init__(self, m: int, sensors: Sequence[Sensor]) -> None:
        self.m = m
        self.sensors = tuple(sensors)
        measured = sorted(channel for sensor in self.sensors for channel in sensor.channels)
        if measured != list(range(m)):
            raise SensorError(f"sensors measure the channels {measured}: must be each of 0 .. {m - 1} exactly once")
        # Python loops over two or three numbers are faster than numpy's indexing.
        self._plan = [(sensor.period, sensor.phase, tuple(sensor.channels)) for sensor in self.sensors]
        self._y = np.full(m, np.nan)

    def measurement(self, k: int, readings: Vector) -> Vector:
        """y (m,) of step k: readings (m,) of the sensors that sample in this step, NaN elsewhere.

        The array is the same in every call. A reading that is NaN (a lost frame) stays missing.

        Raises:
            SensorError: wrong length of readings.
        """
        if len(readings) != self.m:
            raise SensorError(f"readings has length {len(readings)}: must be {self.m}")
        y = self._y
        for period, phase, channels in self._plan:
            if k % period == phase:
                for channel in channels:
                    y[channel] = readings[channel]
            else:
                for channel in channels:
                    y[channel] = np.nan
        return y

    def masked(self, Y: ArrayLike, first: int = 0) -> Matrix:
        """A copy of Y (N, m), step `first` in its first row, with NaN wherever no sensor samples: for `Filter.run`.

        Raises:
            SensorError: wrong shape.
        """
        rows = np.array(Y, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.m:
            raise SensorError(f"Y has shape {rows.shape}: must be (N, {self.m})")
        k = first + np.arange(len(rows))
        for sensor in self.sensors:
            rows[np.ix_(k % sensor.period != sensor.phase, sensor.channels)] = np.nan
        return rows


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
