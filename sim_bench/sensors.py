"""Sensor noise of the simulated actuator node: Gaussian, independent per channel, repeatable by seed.

Only noise; the CAN codec quantises when the value is encoded, as a real sensor node does.
"""

from dataclasses import astuple, dataclass, fields
from math import isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

POSITION, PRESSURE_A, PRESSURE_B, SUPPLY, TANK, SPOOL = range(6)
N_CHANNELS: Final = 6


@dataclass(frozen=True)
class SensorStd:
    """Standard deviation of each channel's noise; the keys of a rig's [plant.sensor_std].

    Raises:
        ValueError: a value is negative or not finite; the message names it.
    """

    position_m: float = 20e-6
    pressure_a_pa: float = 2e4
    pressure_b_pa: float = 2e4
    supply_pa: float = 2e4
    tank_pa: float = 2e4
    spool_v: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isfinite(value) or value < 0.0:
                raise ValueError(f"sensor_std {field.name} = {value!r}: must be finite and >= 0")


class Sensors:
    """Turns the plant's true quantities into noisy readings."""

    def __init__(self, std: SensorStd, rng: np.random.Generator) -> None:
        """Every call of `read` draws N_CHANNELS normals from `rng`, also for channels without noise."""
        self._std = np.array(astuple(std), dtype=np.float64)
        self._rng = rng

    def read(self, state: Vector, supply_pa: float, tank_pa: float, spool_v: float) -> Vector:
        """Readings (6,): position m, pressures A, B, supply, tank Pa, spool V.

        Args:
            state: (4,) position m, velocity m/s, pressure A Pa, pressure B Pa (`CylinderPlant.state`).
            supply_pa: true supply pressure, Pa.
            tank_pa: true pressure of the return line, Pa.
            spool_v: true spool position in volts of command.
        """
        truth = np.array([state[0], state[2], state[3], supply_pa, tank_pa, spool_v])
        return truth + self._std * self._rng.standard_normal(N_CHANNELS)
