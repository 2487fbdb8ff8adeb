"""The identified three-link arm of P3 2.4 on the bus, its torques sines: `hil bench three_link_arm --lockstep`."""

from collections.abc import Sequence
from math import sin

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import SRUKF, Model
from servohil.sim_bench.plant_rig import Channel, PlantRig
from servohil.sim_bench.plants import three_link_arm as arm

PROCESS_STD = (1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3)
SENSOR_STD = (1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2)
START = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

truth = Model(
    arm.f, arm.h, arm.N_STATES, arm.N_OUTPUTS, arm.ThreeLinkArmParameters().vector(), 1e-3, n_u=arm.N_INPUTS,
    names=arm.STATE_NAMES, units=arm.STATE_UNITS,
)  # fmt: skip
rig = PlantRig(
    "three_link_arm", truth, x0=START,
    inputs={f"torque_{i}": Channel(-50.0, 50.0, "Nm") for i in (1, 2, 3)},
    outputs={
        **{f"angle_{i}": Channel(-50.0, 50.0, "rad") for i in (1, 2, 3)},
        **{f"speed_{i}": Channel(-50.0, 50.0, "rad/s") for i in (1, 2, 3)},
    },
    sensor_std=SENSOR_STD, process_std=PROCESS_STD,
)  # fmt: skip
estimator = SRUKF(truth, START, 1e-4 * np.eye(6), np.diag(np.square(PROCESS_STD)), np.diag(np.square(SENSOR_STD)))


def law(t: float, x: NDArray[np.float64]) -> Sequence[float]:
    """Open loop, as for the experiments of P1."""
    return [2.0 * sin(t), 3.0 * sin(1.5 * t), 2.0 * sin(2.0 * t)]
