"""The electro-hydrostatic actuator of P2 on the bus: nonlinear truth, linear filter: `hil bench eha --lockstep`."""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import SRUKF
from servohil.sim_bench.plant_rig import Channel, PlantRig
from servohil.sim_bench.plants import eha

SENSOR_STD = (1e-6,)
AMPLITUDE_M = 0.02

rig = PlantRig(
    "eha", eha.nonlinear_model(), x0=(0.0, 0.0, 0.0),
    inputs={"flow": Channel(-1e-3, 1e-3, "m3/s")}, outputs={"position": Channel(-0.1, 0.1, "m")},
    sensor_std=SENSOR_STD,
)  # fmt: skip
estimator = SRUKF(
    eha.linear_model(), [0.0, 0.0, 0.0], np.diag([1e-8, 1e-4, 1.0]), np.diag([0.0, 1e-8, 1e-1]),
    np.diag(np.square(SENSOR_STD)),
)  # fmt: skip


def law(t: float, x: NDArray[np.float64]) -> Sequence[float]:
    """Flow for the position to follow 0.02 sin(pi t) m."""
    position, speed = AMPLITUDE_M * sin(pi * t), pi * AMPLITUDE_M * cos(pi * t)
    return [eha.NORMAL.area_m2 * (speed + 5.0 * (position - x[0]))]
