"""The one-link arm of P4 on the bus, swung between -90 and 90 degrees in 2 s: `hil bench one_link_arm --lockstep`."""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import SRUKF, Model
from servohil.sim_bench.plant_rig import Channel, PlantRig
from servohil.sim_bench.plants import one_link_arm as arm

PROCESS_STD = (1e-6, 7e-3)  # P4's, per sample
SENSOR_STD = (7e-4, 2.2)
ARM = arm.OneLinkArmParameters()

truth = Model(
    arm.f, arm.h, arm.N_STATES, arm.N_OUTPUTS, ARM.vector(), 1e-3, n_u=arm.N_INPUTS, names=arm.STATE_NAMES,
    units=arm.STATE_UNITS,
)  # fmt: skip
rig = PlantRig(
    "one_link_arm", truth, x0=(pi / 2, 0.0),
    inputs={"torque": Channel(-20.0, 20.0, "Nm")},
    outputs={"angle": Channel(-10.0, 10.0, "rad"), "acceleration": Channel(-1000.0, 1000.0, "rad/s2")},
    sensor_std=SENSOR_STD, process_std=PROCESS_STD,
)  # fmt: skip
estimator = SRUKF(
    truth, [pi / 2, 0.0], np.diag([1e-4, 1e-2]), np.diag(np.square(PROCESS_STD)), np.diag(np.square(SENSOR_STD))
)


def law(t: float, x: NDArray[np.float64]) -> Sequence[float]:
    """Weight held, angle and speed pulled to pi/2 cos(pi t)."""
    angle, speed = pi / 2 * cos(pi * t), -pi * pi / 2 * sin(pi * t)
    weight = 0.5 * ARM.mass_length_kg_m * ARM.gravity_m_per_s2 * sin(x[0])
    return [weight + 2.0 * (speed - x[1]) + 20.0 * (angle - x[0])]
