"""Energy of the cylinder plant: what it stores, what the valve and the leaks bring in, what is lost.

With a constant bulk modulus b the density of oil is rho0 exp(p / b), p in gauge pressure. Mass rho V then changes by
rho Q exactly, and a chamber stores V (b (exp(p / b) - 1) - p). A flow Q at chamber pressure carries the power
Q b (exp(p / b) - 1), which is Q p and half a percent more at 7 MPa. With these

    d energy / dt = hydraulic_power - mechanical_loss - load force x velocity

holds without approximation while the piston is within the stroke.
"""

from math import exp, expm1

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.models.cylinder import (
    AREA_A,
    AREA_B,
    BULK,
    FRICTION,
    MASS,
    PA_PER_MPA,
    STROKE,
    V0_A,
    V0_B,
)
from servohil.sim_bench.plants.cylinder import STOP_K, dry_friction, stop_force

Vector = NDArray[np.float64]

# Nothing here is cached on disk: numba would not notice an edit of the plant, which is in another file.


@njit(nogil=True, error_model="numpy")
def volumes(x: Vector, p: Vector) -> tuple[float, float]:
    """Oil in A and in B, m3, with its hoses; a piston inside an end stop changes nothing."""
    position = min(max(x[0], 0.0), p[STROKE])
    return p[AREA_A] * position + p[V0_A], p[AREA_B] * (p[STROKE] - position) + p[V0_B]


@njit(nogil=True, error_model="numpy")
def relative_masses(x: Vector, p: Vector) -> tuple[float, float]:
    """Mass of oil in A and in B over its density at gauge pressure 0, m3: V exp(p / b)."""
    volume_a, volume_b = volumes(x, p)
    return volume_a * exp(x[2] * PA_PER_MPA / p[BULK]), volume_b * exp(x[3] * PA_PER_MPA / p[BULK])


@njit(nogil=True, error_model="numpy")
def inflows(x: Vector, p: Vector, dx: Vector) -> tuple[float, float]:
    """Net flow into A and into B at chamber pressure, m3/s, through valve and leaks; dx is what `f` gives at x."""
    volume_a, volume_b = volumes(x, p)
    compressed_a = volume_a * dx[2] * PA_PER_MPA / p[BULK]
    compressed_b = volume_b * dx[3] * PA_PER_MPA / p[BULK]
    return compressed_a + p[AREA_A] * x[1], compressed_b - p[AREA_B] * x[1]


@njit(nogil=True, error_model="numpy")
def energy(x: Vector, p: Vector) -> float:
    """Energy of the moving mass, of the compressed oil and of a compressed end stop, J."""
    volume_a, volume_b = volumes(x, p)
    stored = 0.5 * p[MASS] * x[1] * x[1]
    for volume, pressure in ((volume_a, x[2] * PA_PER_MPA), (volume_b, x[3] * PA_PER_MPA)):
        stored += volume * (p[BULK] * expm1(pressure / p[BULK]) - pressure)
    depth = max(-x[0], x[0] - p[STROKE], 0.0)
    return stored + 0.5 * p[STOP_K] * depth * depth


@njit(nogil=True, error_model="numpy")
def hydraulic_power(x: Vector, p: Vector, dx: Vector) -> float:
    """Power that flows bring into both chambers, W; dx is what `f` gives at x."""
    flow_a, flow_b = inflows(x, p, dx)
    carried_a = flow_a * expm1(x[2] * PA_PER_MPA / p[BULK])
    carried_b = flow_b * expm1(x[3] * PA_PER_MPA / p[BULK])
    return p[BULK] * (carried_a + carried_b)


@njit(nogil=True, error_model="numpy")
def mechanical_loss(x: Vector, p: Vector) -> float:
    """Power lost to friction and in the end stops, W; never negative."""
    friction = p[FRICTION] * x[1] + dry_friction(x[1], p)
    depth = -x[0] if x[0] < 0.0 else min(p[STROKE] - x[0], 0.0)
    elastic = p[STOP_K] * depth  # the part of the stop's force that stores
    return friction * x[1] + (elastic - stop_force(x[0], x[1], p)) * x[1]
