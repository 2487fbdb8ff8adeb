"""The cylinder against the hydraulic actuator of Exudyn, an independent multibody code, in compiled C++.

Its equations (the reference of `ObjectConnectorHydraulicActuatorSimple`), s being the stroke from `offsetLength`:

    force on the end marker = p0 A0 - p1 A1 - d s'
    p0' = K / (Vh0 + A0 s)       (-A0 s' + Av0 Qn root(ps - p0)), or root(p0 - pt) where Av0 < 0
    p1' = K / (Vh1 + A1 (L - s)) ( A1 s' + Av1 Qn root(ps - p1)), or root(p1 - pt) where Av1 < 0

with `useChamberVolumeChange` and no bulk modulus but the oil's. Chamber 0 is A, and flow counts into a chamber at both:
Av0 = u in V, Av1 = -u, Qn = Cs. Its root has a corner at zero where ours is rounded off within 1 kPa. A user function
before each step is given the time at its end.
"""

from dataclasses import replace

import exudyn
import exudyn.itemInterface
import numpy as np
import pytest

from servohil.sim_bench.plants.cylinder import (
    SUPPLY_PA,
    TANK_PA,
    CylinderPlantParameters,
    cylinder_model,
    initial_state,
)
from servohil.sim_bench.plants.simulate import simulate

FREE = CylinderPlantParameters(friction_ns_per_m=0.0)
PERIOD_S = 1e-3
TIME = PERIOD_S * np.arange(1000)
# V, held for a period each; both directions, and through zero
COMMANDS = 3.0 * np.sin(2 * np.pi * TIME) + 1.5 * np.sin(2 * np.pi * 3.7 * TIME)
POSITION_M, PRESSURE_A_PA, PRESSURE_B_PA = 0.2, 4e6, 7.0e6
OFFSET_M = 1.0


def exudyn_path(p, steps_per_period):
    """Position m, pressures Pa at the end of every period, by Exudyn's own Runge-Kutta 4."""
    system = exudyn.SystemContainer().AddSystem()
    ground = system.AddObject(exudyn.itemInterface.ObjectGround())
    node = system.AddNode(exudyn.itemInterface.NodePoint(referenceCoordinates=[OFFSET_M + POSITION_M, 0, 0]))
    mass = system.AddObject(exudyn.itemInterface.MassPoint(mass=p.mass_kg, nodeNumber=node))
    markers = [system.AddMarker(exudyn.itemInterface.MarkerBodyPosition(bodyNumber=body)) for body in (ground, mass)]
    pressures = system.AddNode(
        exudyn.itemInterface.NodeGenericODE1(
            referenceCoordinates=[0, 0], initialCoordinates=[PRESSURE_A_PA, PRESSURE_B_PA], numberOfODE1Coordinates=2
        )
    )
    actuator = system.AddObject(
        exudyn.itemInterface.HydraulicActuatorSimple(
            markerNumbers=markers, nodeNumbers=[pressures], offsetLength=OFFSET_M, strokeLength=p.stroke_m,
            chamberCrossSection0=p.area_a_m2, chamberCrossSection1=p.area_b_m2, hoseVolume0=p.dead_volume_a_m3,
            hoseVolume1=p.dead_volume_b_m3, oilBulkModulus=p.bulk_modulus_pa, nominalFlow=p.valve_gain,
            systemPressure=SUPPLY_PA, tankPressure=TANK_PA, actuatorDamping=p.friction_ns_per_m,
            useChamberVolumeChange=True,
        )
    )  # fmt: skip
    path = []

    def command(mbs, end_of_step):
        volts = COMMANDS[int(np.ceil(end_of_step / PERIOD_S - 1e-6)) - 1]
        mbs.SetObjectParameter(actuator, "valveOpening0", volts)
        mbs.SetObjectParameter(actuator, "valveOpening1", -volts)
        return True

    def record(mbs, _):
        length = mbs.GetObjectOutput(actuator, exudyn.OutputVariableType.Distance)
        path.append([length - OFFSET_M, *mbs.GetNodeOutput(pressures, exudyn.OutputVariableType.Coordinates)])
        return True

    system.SetPreStepUserFunction(command)
    system.SetPostStepUserFunction(record)
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps = steps_per_period * len(COMMANDS)
    settings.timeIntegration.endTime = PERIOD_S * len(COMMANDS)
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    system.SolveDynamic(settings, solverType=exudyn.DynamicSolverType.RK44)
    return np.array(path)[steps_per_period::steps_per_period]  # the first row is the start


def our_path(p):
    u = np.column_stack([COMMANDS, np.full(len(COMMANDS), SUPPLY_PA), np.full(len(COMMANDS), TANK_PA)])
    start = initial_state(p, POSITION_M, PRESSURE_A_PA, PRESSURE_B_PA)
    return simulate(cylinder_model(p, PERIOD_S, 4), start, u, 0.0, seed=0).Y * [1.0, 1e6, 1e6]


@pytest.mark.parametrize("friction", [0.0, 418.33], ids=["no friction", "viscous friction"])
def test_one_second_of_motion_agrees_to_a_micrometre_and_100_pascal(friction):
    p = replace(FREE, friction_ns_per_m=friction)
    theirs, ours = exudyn_path(p, 5), our_path(p)
    assert theirs.shape == ours.shape == (1000, 3)
    difference = np.abs(ours - theirs).max(axis=0)
    print(difference, np.ptp(ours, axis=0))
    assert np.ptp(ours[:, 0]) > 0.05 and (np.ptp(ours[:, 1:], axis=0) > 2e6).all()
    assert ours[:, 0].min() > 0.0 and ours[:, 0].max() < p.stroke_m
    assert difference[0] < 1e-6 and (difference[1:] < 100.0).all()


@pytest.mark.parametrize(
    "change",
    [
        {"leak_internal": 1e-14},
        {"leak_external_a": 1e-14},
        {"leak_external_b": 1e-14},
        {"load_force_n": 0.5},
        {"friction_coulomb_n": 0.5},
        {"dead_band_v": 1e-3},
        {"bulk_modulus_pa": 7.001e8},
        {"dead_volume_b_m3": 1.0701e-4},
        {"supply_resistance": 1e6},
    ],
    ids=lambda change: next(iter(change)),
)
def test_the_comparison_sees_small_deviations(change):
    difference = np.abs(our_path(replace(FREE, **change)) - our_path(FREE)).max(axis=0)
    assert difference[0] > 1e-6 or (difference[1:] > 100.0).any(), difference
