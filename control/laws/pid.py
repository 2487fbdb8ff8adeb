"""PID on the position error with a feedforward of the reference's velocity: what a plant has before all this.

    u = -(k_p e + k_i int e dt + k_d e') + k_v r'

It knows nothing of the plant: f and b are not used.
"""

from dataclasses import astuple, dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.laws.law import INTEGRAL, RUNNING, actuate, check_gains

Vector = NDArray[np.float64]

K_P, K_I, K_D, K_V = range(4)


@dataclass(frozen=True)
class PidGains:
    """Gains of the law, in units of the command (V for a valve) per m, m s, m/s, m/s.

    Raises:
        GainError: a value is not finite or < 0; the proportional gain is not > 0.
    """

    proportional: float
    integral: float
    derivative: float
    velocity_feedforward: float = 0.0

    def __post_init__(self) -> None:
        others = ("integral", "derivative", "velocity_feedforward")
        check_gains(self, positive=("proportional",), not_negative=others)

    def vector(self) -> Vector:
        """The gains as the float64 vector that `pid_step` takes."""
        return np.array(astuple(self), dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def pid_step(
    state: Vector,
    gains: Vector,
    e: Vector,
    reference: Vector,
    f: float,
    b_extend: float,
    b_retract: float,
    low: float,
    high: float,
    dt: float,
) -> float:
    """One step of the law, see `law`."""
    integral = state[INTEGRAL] if state[RUNNING] != 0.0 else 0.0
    wanted = gains[K_V] * reference[1] - gains[K_P] * e[0] - gains[K_I] * integral - gains[K_D] * e[1]
    return float(actuate(state, gains, wanted, 0.0, integral, e[0], 0.0, 1.0, 1.0, low, high, dt))
