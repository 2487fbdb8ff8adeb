"""How `sigma_point_step.py` moves Q and R at the end of a good step, and the settings it takes."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.gate import gate_limits
from servohil.estimators.noise.adaptive_layout import HOLD
from servohil.estimators.noise.limited_sage_husa import limited_sage_husa
from servohil.estimators.noise.sage_husa import sage_husa

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SETTINGS: Final = 8
LAW, FORGETTING, ESTIMATE_MEANS, WARM_UP, LARGEST_NIS, LOW, HIGH, STRUCTURE = range(SETTINGS)
SAGE_HUSA, LIMITED_R, LIMITED_Q = range(3)  # laws
DIAGONAL, FULL = range(2)  # structures
GATE_SHARE: Final = 0.999  # of consistent innovations adapt the limited forms


def sage_husa_settings(forgetting: float, means: bool) -> Vector:
    """Settings of `sage_husa.py`."""
    settings = np.zeros(SETTINGS)
    settings[[LAW, FORGETTING, ESTIMATE_MEANS]] = SAGE_HUSA, forgetting, means
    return settings


def limited_settings(
    m: int, forgetting: float, of_q: bool, full: bool, warm_up: int, bounds: tuple[float, float]
) -> Vector:
    """Settings of `limited_sage_husa.py`; m: number of outputs."""
    settings = np.zeros(SETTINGS)
    settings[[LAW, FORGETTING]] = LIMITED_Q if of_q else LIMITED_R, forgetting
    settings[[WARM_UP, LARGEST_NIS, LOW, HIGH]] = warm_up, gate_limits(GATE_SHARE, m)[-1], *bounds
    settings[STRUCTURE] = FULL if full else DIAGONAL
    return settings


@njit(nogil=True, cache=True, error_model="numpy")
def adapt_noise(
    own: Vector, settings: Vector, n: int, m: int, nis: float, stack: Matrix, e: Vector, factor: Matrix, q: Matrix,
    r: Matrix, spare: Vector,
) -> None:  # fmt: skip
    """After a correction with all channels. Arguments as those of `sage_husa`."""
    if own[HOLD] != 0.0:
        return
    law = settings[LAW]
    forgetting = settings[FORGETTING]
    if law == SAGE_HUSA:
        sage_husa(own, n, m, forgetting, settings[ESTIMATE_MEANS] != 0.0, stack, e, factor, q, r, spare)
    elif nis < settings[LARGEST_NIS]:
        limited_sage_husa(
            own, n, m, forgetting, settings[WARM_UP], law == LIMITED_Q, settings[STRUCTURE] == FULL, settings[LOW],
            settings[HIGH], stack, e, q, r, spare,
        )  # fmt: skip
