"""The two-link arm of P3 eq. 2.3 on the bus, both joints swung by sines: `hil bench two_link_arm --lockstep`."""

from collections.abc import Sequence
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import SRUKF, Model
from servohil.sim_bench.plant_rig import Channel, PlantRig
from servohil.sim_bench.plants import two_link_arm as arm

PROCESS_STD = (1e-6, 1e-6, 1e-3, 1e-3)
SENSOR_STD = (7e-4, 7e-4)
ARM = arm.TwoLinkArmParameters()
START = (0.0, 0.0, 0.5, 1.0)

truth = Model(
    arm.f, arm.h, arm.N_STATES, arm.N_OUTPUTS, ARM.vector(), 1e-3, n_u=arm.N_INPUTS, names=arm.STATE_NAMES,
    units=arm.STATE_UNITS,
)  # fmt: skip
rig = PlantRig(
    "two_link_arm", truth, x0=START,
    inputs={"torque_1": Channel(-100.0, 100.0, "Nm"), "torque_2": Channel(-100.0, 100.0, "Nm")},
    outputs={"angle_1": Channel(-10.0, 10.0, "rad"), "angle_2": Channel(-10.0, 10.0, "rad")},
    sensor_std=SENSOR_STD, process_std=PROCESS_STD,
)  # fmt: skip
estimator = SRUKF(truth, START, 1e-2 * np.eye(4), np.diag(np.square(PROCESS_STD)), np.diag(np.square(SENSOR_STD)))


def law(t: float, x: NDArray[np.float64]) -> Sequence[float]:
    """Weight held; the joints pulled to 0.5 sin t and 0.5 sin 2t rad."""
    forearm = ARM.mass_2_kg * ARM.gravity_m_per_s2 * ARM.length_2_m * cos(x[0] + x[1])
    upper = (ARM.mass_1_kg + ARM.mass_2_kg) * ARM.gravity_m_per_s2 * ARM.length_1_m * cos(x[0]) + forearm
    return [
        upper + 60.0 * (0.5 * sin(t) - x[0]) + 15.0 * (0.5 * cos(t) - x[2]),
        forearm + 20.0 * (0.5 * sin(2.0 * t) - x[1]) + 5.0 * (cos(2.0 * t) - x[3]),
    ]
