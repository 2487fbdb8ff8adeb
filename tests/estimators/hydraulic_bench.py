"""A cylinder moving along the bench's sine, for tests: truth at 0.1 ms, noisy quantised samples at 1 ms."""

from typing import Any

import numpy as np
from numba import njit

from servohil.estimators import SRUKF, Model
from servohil.estimators.models import cylinder

DT = 1e-3
X0 = np.array([0.3, 0.3, 3.6, 5.75])
P0 = np.diag(np.square([1e-3, 1e-2, 0.2, 0.2]))
PROCESS_STD = np.array([1e-6, 1e-4, 2e-3, 2e-3])
MEASUREMENT_STD = np.array([4e-5, 0.02, 0.02])
HEALTHY = cylinder.CylinderParameters()

_f = njit(cylinder.f, error_model="numpy")


def model() -> Model:
    return Model(cylinder.f, cylinder.h, 4, 3, HEALTHY.vector(), DT, n_u=cylinder.N_INPUTS)


def srukf(
    process_std: Any = PROCESS_STD, measurement_std: Any = MEASUREMENT_STD, p0: Any = P0, **options: Any
) -> SRUKF:
    return SRUKF(model(), X0, p0, np.diag(np.square(process_std)), np.diag(np.square(measurement_std)), **options)


@njit(cache=True)
def _advance(x, u, p, dt):
    k1, k2, k3, k4 = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    _f(x, u, p, k1)
    _f(x + dt / 2 * k1, u, p, k2)
    _f(x + dt / 2 * k2, u, p, k3)
    _f(x + dt * k3, u, p, k4)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


@njit(cache=True)
def sine_motion(steps, seed, healthy, faulty, fault_step, jitter, command_noise_v):
    """Inputs U (N, 3), samples Y (N, 3) and true states X (N, 4) of 0.3 + 0.15 sin(2t) m.

    Samples have 20 um and 0.2 bar rms and are quantised to 1 um and 0.01 bar; they are taken up to `jitter` tenths of
    a millisecond beside their time. From `fault_step` on the plant has the parameters `faulty`.
    """
    np.random.seed(seed)
    inputs, samples, states = np.empty((steps, 3)), np.empty((steps, 3)), np.empty((steps, 4))
    x = np.array([0.3, 0.3, 3.6, 5.75])
    u = np.array([0.0, 14e6, 0.9e6])
    path = np.empty((14, 4))
    for k in range(steps):
        t = k * 1e-3
        p = faulty if k >= fault_step else healthy
        velocity, acceleration = 0.3 * np.cos(2 * t), -0.6 * np.sin(2 * t)
        actual = ((p[2] * x[2] - p[3] * x[3]) * 1e6 - p[1] * x[1]) / p[0]
        wanted = velocity + 4 * (0.3 + 0.15 * np.sin(2 * t) - x[0]) + 0.5 * (velocity - x[1])
        wanted += 0.02 * (acceleration - actual)
        drop, area = (14 - x[2], p[2]) if wanted >= 0 else (14 - x[3], p[3])
        command = wanted * area / (2.36e-5 * np.sqrt(max(drop, 0.1))) + command_noise_v * np.random.normal()
        u[0] = min(max(command, -10.0), 10.0)
        z = x.copy()
        for i in range(14):
            path[i] = z
            z = _advance(z, u, p, 1e-4)
        x = path[10].copy()
        x[1] += 1e-5 * np.random.normal()
        x[2] += 5e-4 * np.random.normal()
        x[3] += 5e-4 * np.random.normal()
        seen = path[10 + np.random.randint(-jitter, jitter + 1)] if jitter > 0 else x
        inputs[k] = u
        states[k] = x
        samples[k, 0] = round((seen[0] + 2e-5 * np.random.normal()) * 1e6) / 1e6
        samples[k, 1] = round((seen[2] + 0.02 * np.random.normal()) * 1e3) / 1e3
        samples[k, 2] = round((seen[3] + 0.02 * np.random.normal()) * 1e3) / 1e3
    return inputs, samples, states


def healthy_motion(steps: int, seed: int = 0) -> Any:
    p = HEALTHY.vector()
    return sine_motion(steps, seed, p, p, steps, 0, 0.0)
