"""From the codec's decoded signals to what the cycle works with: a SensorView, the filter's y and u."""

from math import isfinite, nan
from typing import Final

import numpy as np

from servohil.control.dead_band import opening
from servohil.drivers.codec import Codec
from servohil.hil.assemble import SENSOR_SIGNALS, message_of
from servohil.hil.config import Rig
from servohil.hil.events import SensorView

PA_PER_MPA: Final = 1e6


class Sensing:
    """Reads one cycle's measurements out of an attached codec.

    `y` (3,) = position m, pressure A MPa, pressure B MPa, NaN where this cycle brought nothing;
    `u` (3,) = valve V over the past interval less its dead band, supply Pa, tank Pa.
    """

    def __init__(self, rig: Rig, codec: Codec) -> None:
        self._codec = codec
        paths = {name: getattr(rig.signals, name) for name in SENSOR_SIGNALS}
        self._slots = [codec.slot(path) for path in paths.values()]
        self._messages = [codec.message_index(message_of(path)) for path in paths.values()]
        # The spool signal improves the estimate but is not needed for it: a rig may have a valve without feedback.
        needed = [name for name in SENSOR_SIGNALS if name != "spool"]
        self._needed = sorted({codec.message_index(message_of(paths[name])) for name in needed})
        self._status_slot = codec.slot(rig.signals.status_word)
        self._status_message = codec.message_index(message_of(rig.signals.status_word))
        self._dead_band_v = rig.control.dead_band_v
        self.y = np.full(3, nan)
        self.u = np.zeros(3)

    def read(self, t_ns: int, last_command_v: float) -> SensorView:
        """The measurements of this cycle at `t_ns`; `last_command_v` stands in for a spool that is not measured."""
        codec = self._codec
        values, fresh = codec.values.tolist(), codec.fresh.tolist()
        last_good_ns, bad_in_a_row = codec.last_good_ns.tolist(), codec.bad_in_a_row.tolist()
        slots, messages = self._slots, self._messages
        position = values[slots[0]] if fresh[messages[0]] else nan
        pressure_a = values[slots[1]] if fresh[messages[1]] else nan
        pressure_b = values[slots[2]] if fresh[messages[2]] else nan
        supply = values[slots[3]]
        tank = values[slots[4]]
        spool = values[slots[5]] if fresh[messages[5]] else nan
        self.y[:] = position, pressure_a / PA_PER_MPA, pressure_b / PA_PER_MPA
        self.u[:] = opening(spool if isfinite(spool) else last_command_v, self._dead_band_v), supply, tank
        complete = isfinite(position + pressure_a + pressure_b + supply + tank)
        oldest = t_ns - min(last_good_ns[index] for index in self._needed)
        worst = max(bad_in_a_row[index] for index in self._needed)
        status = values[self._status_slot] if fresh[self._status_message] else nan
        return SensorView(position, pressure_a, pressure_b, supply, tank, spool, complete, oldest, worst, status)
