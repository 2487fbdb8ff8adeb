"""The planar one-link robot of P4 section 3.1 (with g in the gravity term), driven along an s-curve, for tests.

State [angle rad, speed rad/s], input [torque Nm], outputs [angle, acceleration rad/s2]; Euler steps of 0.2 ms, noise as
in P4 section 4.1. Parameters: 1/J, viscous friction, Coulomb friction, mass times length, slope of the Coulomb
friction's arctan, gravity. While the arm is held at pi/2 nothing but the mass tells anything about itself.
"""

from math import atan, cos, pi, sin

import numpy as np
from numba import njit

from servohil.estimators import Model

DT = 2e-4
TRUE = np.array([1.0 / 5.59e-2, 0.05, 0.27, 0.11, 10.0, 9.81])
Q = np.diag([1e-11, 5e-5])
R = np.diag([5e-7, 5.0])


def f(x, u, p, dx):
    dx[0] = x[1]
    dx[1] = p[0] * (u[0] - p[1] * x[1] - p[2] * atan(p[4] * x[1]) - 0.5 * p[3] * p[5] * sin(x[0]))


def h(x, u, p, y):
    y[0] = x[0]
    y[1] = p[0] * (u[0] - p[1] * x[1] - p[2] * atan(p[4] * x[1]) - 0.5 * p[3] * p[5] * sin(x[0]))


def model(p=TRUE):
    return Model(f, h, 2, 2, p, DT, integrator="euler")


@njit(cache=True)
def experiment(steps, hold_from, hold_until, before, after, seed):
    """U (N, 1), Y (N, 2), X (N, 2) of -pi/2 .. pi/2 .. -pi/2 in 2 s, at pi/2 from step hold_from to hold_until.

    The parameters are `before`, and `after` from hold_from on. The arm starts at pi/2 and hold_from should be a
    multiple of 2 s. Each input is the torque over the period that ends with its sample.
    """
    np.random.seed(seed)
    inputs, samples, states = np.empty((steps, 1)), np.empty((steps, 2)), np.empty((steps, 2))
    angle, speed, clock = pi / 2, 0.0, 0.0
    for k in range(steps):
        p = after if k >= hold_from else before
        if k < hold_from or k >= hold_until:
            clock += 2e-4
        wanted, rate = pi / 2 * cos(pi * clock), 0.0
        if k < hold_from or k >= hold_until:
            rate = -pi * pi / 2 * sin(pi * clock)
        torque = 0.06 * (100.0 * (rate + 20.0 * (wanted - angle) - speed)) + 0.5 * p[3] * p[5] * sin(angle)
        slope = p[0] * (torque - p[1] * speed - p[2] * atan(p[4] * speed) - 0.5 * p[3] * p[5] * sin(angle))
        angle, speed = (
            angle + 2e-4 * speed + 1e-11**0.5 * np.random.normal(),
            speed + 2e-4 * slope + 5e-5**0.5 * np.random.normal(),
        )
        slope = p[0] * (torque - p[1] * speed - p[2] * atan(p[4] * speed) - 0.5 * p[3] * p[5] * sin(angle))
        inputs[k, 0] = torque
        states[k] = angle, speed
        samples[k, 0] = angle + 5e-7**0.5 * np.random.normal()
        samples[k, 1] = slope + 5.0**0.5 * np.random.normal()
    return inputs, samples, states
