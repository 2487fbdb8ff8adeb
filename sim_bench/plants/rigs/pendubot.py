"""The pendubot of P4 on the bus, hanging, its shoulder swung by 0.5 rad: `hil bench pendubot --lockstep`."""

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import SRUKF, Model
from servohil.sim_bench.plant_rig import Channel, PlantRig
from servohil.sim_bench.plants import pendubot

PROCESS_STD = (1e-6, 1e-3, 1e-6, 1e-3)
SENSOR_STD = (7e-4, 7e-4, 2.2)
ROBOT = pendubot.PendubotParameters()
HANGING = (-pi / 2, 0.0, 0.0, 0.0)

truth = Model(
    pendubot.f, pendubot.h, pendubot.N_STATES, pendubot.N_OUTPUTS, ROBOT.vector(), 1e-3, n_u=pendubot.N_INPUTS,
    names=pendubot.STATE_NAMES, units=pendubot.STATE_UNITS,
)  # fmt: skip
rig = PlantRig(
    "pendubot", truth, x0=HANGING,
    inputs={"torque": Channel(-20.0, 20.0, "Nm")},
    outputs={
        "angle_1": Channel(-20.0, 20.0, "rad"), "angle_2": Channel(-20.0, 20.0, "rad"),
        "acceleration_1": Channel(-1000.0, 1000.0, "rad/s2"),
    },
    sensor_std=SENSOR_STD, process_std=PROCESS_STD,
)  # fmt: skip
estimator = SRUKF(truth, HANGING, 1e-2 * np.eye(4), np.diag(np.square(PROCESS_STD)), np.diag(np.square(SENSOR_STD)))


def law(t: float, x: NDArray[np.float64]) -> Sequence[float]:
    """The shoulder around its lowest place by 0.5 sin 2t rad; the elbow follows as it will."""
    angle, speed = -pi / 2 + 0.5 * sin(2.0 * t), cos(2.0 * t)
    weight = ROBOT.gravity_m_per_s2 * (ROBOT.theta_4_kg_m * cos(x[0]) + ROBOT.theta_5_kg_m * cos(x[0] + x[2]))
    return [weight + 2.0 * (speed - x[1]) + 20.0 * (angle - x[0])]
