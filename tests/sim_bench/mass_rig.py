"""A mass on a spring as a plant of one's own."""

from math import sin

import numpy as np

from servohil.estimators import KF, Model
from servohil.sim_bench.plant_rig import Channel, PlantRig

MASS, DAMPING, SPRING, DT = 2.0, 3.0, 50.0, 1e-3


def f(x, u, p, dx):
    dx[0] = x[1]
    dx[1] = (u[0] - p[1] * x[1] - p[2] * x[0]) / p[0]


def h(x, u, p, y):
    y[0] = x[0]
    y[1] = (u[0] - p[1] * x[1] - p[2] * x[0]) / p[0]


MODEL = Model(f, h, 2, 2, [MASS, DAMPING, SPRING], DT, names=("position", "speed"), units=("m", "m/s"))
rig = PlantRig(
    "mass", MODEL, x0=(0.1, 0.0), inputs={"force": Channel(-40.0, 40.0, "N")},
    outputs={"position": Channel(-500.0, 500.0, "mm"), "acceleration": Channel(-50.0, 50.0, "m/s2")},
    sensor_std=(1e-4, 0.01), channel="mass",
)  # fmt: skip
estimator = KF(MODEL, [0.1, 0.0], 1e-6 * np.eye(2), 1e-12 * np.eye(2), np.diag([1e-8, 1e-4]))


def law(t, x):
    return [30.0 * sin(5.0 * t) - 10.0 * x[1]]
