"""Faults of sensors, valve and cylinder, inside the simulated node."""

from collections.abc import Sequence
from math import copysign, exp
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.assemble import SENSOR_SIGNALS
from servohil.hil.config import Rig
from servohil.sim_bench.actuator_node import ActuatorNode
from servohil.sim_bench.faults.kinds import (
    Air,
    EndStop,
    Fault,
    HoseBurst,
    Load,
    SensorDrift,
    SensorFault,
    SensorJump,
    SensorNoise,
    SensorStuck,
    SlowValve,
    SpoolNotCentring,
    SpoolStuck,
    SupplyLoss,
)

VALVE: Final = (SpoolStuck, SpoolNotCentring, SlowValve)
READING: Final = (SensorStuck, SensorJump, SensorDrift, SensorNoise)
CYLINDER: Final = (SupplyLoss, HoseBurst, EndStop, Air, Load)


class NodeDamage:
    """The node's `damage`: does nothing outside the windows of its faults.

    Args:
        node: whose valve, sensors and cylinder.
        rig: what the cylinder is mended to.
        faults: of a scenario; those of other places are left out.
    """

    def __init__(self, node: ActuatorNode, rig: Rig, faults: Sequence[Fault]) -> None:
        self._node = node
        self._sound = rig.plant_cylinder
        self._dt = node.dt
        mine = [fault for fault in faults if isinstance(fault, (*VALVE, *READING, *CYLINDER))]
        self._faults = [(fault, *fault.window(node.dt)) for fault in mine]
        self._on: list[bool] = [False] * len(mine)
        self._kept = [0.0] * len(mine)  # where spool or reading stood at the onset; the lag's state
        self._readings = np.zeros(len(SENSOR_SIGNALS))
        self._cycle = 0
        self._sound_supply_pa = 0.0
        self._sound_bulk_pa = 0.0

    def begin(self, cycle: int) -> None:
        """The coming period is this cycle from the first ACTIVE one on; negative before."""
        self._cycle = cycle
        for k, (fault, first, end) in enumerate(self._faults):
            on = first <= cycle < end
            if on != self._on[k]:
                self._on[k] = on
                if isinstance(fault, CYLINDER):
                    self._change_cylinder(fault, on)
                elif isinstance(fault, VALVE):
                    self._kept[k] = self._node.plant.spool_v
                elif isinstance(fault, SensorStuck):
                    reading = self._readings[SENSOR_SIGNALS.index(fault.signal)]
                    self._kept[k] = float(reading) if fault.value is None else fault.value

    def spool_v(self, command_v: float) -> float:
        """Where the spool is to be, V."""
        spool = command_v
        for k, (fault, _, _) in enumerate(self._faults):
            if not self._on[k]:
                continue
            if isinstance(fault, SpoolStuck):
                spool = self._kept[k]
            elif isinstance(fault, SpoolNotCentring):
                if abs(spool) < fault.rest_v:
                    spool = copysign(fault.rest_v, self._node.plant.spool_v)
            elif isinstance(fault, SlowValve):
                self._kept[k] += (spool - self._kept[k]) * (1.0 - exp(-self._dt / fault.time_constant_s))
                spool = self._kept[k]
        return spool

    def falsify(self, readings: NDArray[np.float64]) -> None:
        """Change readings (6,) in place."""
        for k, (fault, first, _) in enumerate(self._faults):
            if not (self._on[k] and isinstance(fault, SensorFault)):
                continue
            at = SENSOR_SIGNALS.index(fault.signal)
            if isinstance(fault, SensorStuck):
                readings[at] = self._kept[k]
            elif isinstance(fault, SensorJump):
                readings[at] += fault.by
            elif isinstance(fault, SensorDrift):
                readings[at] += fault.rate * self._dt * (self._cycle - first + 1)
            elif isinstance(fault, SensorNoise):
                truth = self._truth(at)
                readings[at] = truth + fault.factor * (readings[at] - truth)
        self._readings[:] = readings

    def _truth(self, at: int) -> float:
        plant = self._node.plant
        x = plant.state
        return float((x[0], x[2], x[3], plant.supply_at_valve_pa, plant.tank_pa, plant.spool_v)[at])

    def _change_cylinder(self, fault: Fault, broken: bool) -> None:
        plant, sound = self._node.plant, self._sound
        if isinstance(fault, SupplyLoss):
            if broken:
                self._sound_supply_pa = plant.supply_pa
            plant.supply_pa = fault.supply_pa if broken else self._sound_supply_pa
        elif isinstance(fault, HoseBurst):
            tight = sound.leak_external_a if fault.chamber == "a" else sound.leak_external_b
            plant.set_leak(f"external_{fault.chamber}", fault.coefficient if broken else tight)
        elif isinstance(fault, EndStop):
            plant.set_obstacle(fault.position_m if broken else None)
        elif isinstance(fault, Air):
            if broken:
                self._sound_bulk_pa = plant.bulk_modulus_pa
            plant.set_bulk_modulus(self._sound_bulk_pa * (fault.factor if broken else 1.0))
        elif isinstance(fault, Load):
            plant.set_load(fault.force_n if broken else sound.load_force_n)
