"""Reference and control law of the cycle: what the cylinder should do now, and the voltage that the law asks for."""

from math import nan
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.control.dead_band import opening, spool_for
from servohil.control.laws import law
from servohil.control.laws.catalogue import LAWS
from servohil.control.references import evaluate
from servohil.control.stopping import come_to_rest
from servohil.estimators.models import cylinder
from servohil.hil import assemble
from servohil.hil.config import Rig
from servohil.hil.gate import DeviceState, GateLimits

Vector = NDArray[np.float64]

HOLD, ACTIVE = int(DeviceState.HOLD), int(DeviceState.ACTIVE)
STOPPING_S: Final = 0.4  # from full speed to rest in HOLD

# Places in this part's float64 state, in front of the vector of a profile with parameters.
START_M, START_MPS, ENTERED_CYCLE, PROFILE = range(4)


class Tracking:
    """Follows the profile in ACTIVE, comes to rest and stays in HOLD; every entry starts from the estimated motion.

    Args:
        rig: the configuration.
        law_state: float64 state of the control law, (law.STATE_SIZE,).
        motion: float64 state of this part, (`motion_size(rig)`,).

    Raises:
        GainError, ProfileError: named condition.
    """

    def __init__(self, rig: Rig, law_state: Vector, motion: Vector) -> None:
        self.dt = rig.loop.period_ns * 1e-9
        self.gains = rig.control.gains()
        self._step = LAWS[rig.control.law].step
        self._dead_band_v = rig.control.dead_band_v
        self.reference = np.full(4, nan)  # position m and three derivatives; NaN where no law runs
        # What an operator can change is part of the state; the rest, often long, is configuration like the gains.
        self.profile = assemble.build_profile(rig).vector()
        if motion.size > PROFILE:
            motion[PROFILE:] = self.profile
            self.profile = motion[PROFILE:]
        self._law = law_state
        self._motion = motion
        self._plant = rig.cylinder.parameters().vector()
        self._error = np.zeros(3)
        self._jerk = np.zeros(3)

    @staticmethod
    def motion_size(rig: Rig) -> int:
        """Float64 words of `motion` for this rig."""
        return PROFILE + (int(assemble.build_profile(rig).vector().size) if rig.reference.kind == "sine" else 0)

    @property
    def sigma(self) -> float:
        """Sliding variable of the last step, in the unit of the law; 0 where it has none."""
        return float(self._law[law.SIGMA])

    def enter(self, x: Vector, cycle: int) -> None:
        """The device state changed: start from the estimated position and velocity, with a fresh law."""
        motion = self._motion
        motion[START_M], motion[START_MPS], motion[ENTERED_CYCLE] = x[0], x[1], cycle
        law.reset(self._law)

    @property
    def flags(self) -> int:
        """Of the last step, see `law`; 0 in a state where none runs."""
        return int(self._law[law.FLAGS])

    def command(
        self, device: int, cycle: int, x: Vector, u: Vector, last_v: float, limits: GateLimits, periods: int
    ) -> float:
        """What the law asks for, V; 0.0 in a state where none runs. Fills `reference`.

        Args:
            device: device state at the start of this cycle.
            cycle: cycle number.
            x: (4,) estimate, m, m/s, MPa, MPa.
            u: (3,) valve V, supply Pa, tank Pa.
            last_v: last command: the law knows how far the gate lets the next one go, and its integral waits there.
            limits: of the gate.
            periods: since the last command.
        """
        reference: Any = self.reference
        if device not in (HOLD, ACTIVE):
            reference[:] = nan
            self._law[law.FLAGS] = 0.0
            return 0.0
        start_m, start_mps, entered = self._motion[:PROFILE].tolist()
        since_s = (cycle - entered) * self.dt
        if device == HOLD:
            come_to_rest(since_s, start_m, start_mps, STOPPING_S, reference)
        else:
            evaluate(self.profile, since_s, start_m, reference)
        cylinder.jerk_model(x, u, self._plant, self._jerk)
        error = self._error
        error[:2] = x[:2] - reference[:2]
        error[2] = cylinder.acceleration(x, self._plant) - reference[2]
        band = self._dead_band_v
        limit = max(0.0, limits.command_max_v - band)
        before, slew = opening(last_v, band), limits.slew_step_v * periods
        # Both ends within the limit: one that was lowered under way must not leave a window that asks for motion.
        low, high = max(-limit, min(limit, before - slew)), max(-limit, min(limit, before + slew))
        asked = self._step(self._law, self.gains, error, reference, *self._jerk.tolist(), low, high, self.dt)
        return float(spool_for(asked, band))
