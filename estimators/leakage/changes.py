"""What can change in a cylinder: three leaks, and what looks like one for a while and is none.

Every change is one number that moves a parameter of the model, an input or a measurement. It is counted in a unit of
its own, about the least that matters, so that numbers of very different kinds share one covariance: what stands here
as 3.0 of "valve_gain" is a gain 3 % larger.
"""

from typing import Final, NamedTuple

from servohil.estimators.models.cylinder import BULK, CS, FRICTION, K_EA, K_EB, K_I, LOAD

PARAMETER, INPUT, OUTPUT = range(3)  # what it moves
# As it is; times the sign of the velocity; times minus the sign of the valve's opening.
ALWAYS, AGAINST_MOTION, AGAINST_OPENING = range(3)


class Change(NamedTuple):
    """One thing that can change.

    Attributes:
        name: as in the Diagnosis.
        text: for people.
        moves: PARAMETER, INPUT or OUTPUT.
        place: index into p, u or y.
        unit: how much one unit moves it by, in the unit of p, u or y.
        relative: whether `unit` is a share of the configured parameter.
        when: ALWAYS, AGAINST_MOTION or AGAINST_OPENING.
        unknown: standard deviation before commissioning, units.
        configured: standard deviation where the configuration is taken for the truth, units.
        drift: random walk afterwards, units per square root of a second.
        step: standard deviation of a sudden change, units; 0: it does not jump.
    """

    name: str
    text: str
    moves: int
    place: int
    unit: float
    relative: bool
    when: int
    unknown: float
    configured: float
    drift: float
    step: float


LEAK_UNIT: Final = 1e-13  # m3/(s Pa): 0.03 L/min at 5 MPa
CHANGES: Final = (
    Change("internal", "internal leak, A to B", PARAMETER, K_I, LEAK_UNIT, False, ALWAYS, 10.0, 0.5, 0.01, 30.0),
    Change("external_a", "external leak, chamber A", PARAMETER, K_EA, LEAK_UNIT, False, ALWAYS, 10.0, 0.5, 0.01, 30.0),
    Change("external_b", "external leak, chamber B", PARAMETER, K_EB, LEAK_UNIT, False, ALWAYS, 10.0, 0.5, 0.01, 30.0),
    Change("valve_gain", "valve gain", PARAMETER, CS, 0.01, True, ALWAYS, 20.0, 0.5, 0.05, 5.0),
    Change("valve_null", "valve null", INPUT, 0, 0.01, False, ALWAYS, 20.0, 0.5, 0.05, 5.0),
    Change("bulk_modulus", "bulk modulus (air in the oil)", PARAMETER, BULK, 0.01, True, ALWAYS, 25.0, 2.0, 0.1, 10.0),
    Change("friction", "viscous friction", PARAMETER, FRICTION, 10.0, False, ALWAYS, 30.0, 5.0, 0.2, 20.0),
    Change("dry_friction", "dry friction", PARAMETER, LOAD, 10.0, False, AGAINST_MOTION, 30.0, 3.0, 0.2, 20.0),
    Change("load", "load force", PARAMETER, LOAD, 10.0, False, ALWAYS, 50.0, 3.0, 0.5, 100.0),
    Change("supply", "supply pressure beside its reading", INPUT, 1, 1e5, False, ALWAYS, 1.0, 0.2, 0.01, 10.0),
    Change("sensor_a", "pressure sensor A", OUTPUT, 1, 0.01, False, ALWAYS, 2.0, 0.5, 0.02, 20.0),
    Change("sensor_b", "pressure sensor B", OUTPUT, 2, 0.01, False, ALWAYS, 2.0, 0.5, 0.02, 20.0),
    Change("overlap", "valve overlap", INPUT, 0, 0.01, False, AGAINST_OPENING, 20.0, 0.5, 0.02, 10.0),
)  # fmt: skip
N_CHANGES: Final = len(CHANGES)
N_LEAKS: Final = 3  # they come first
NAMES: Final = tuple(change.name for change in CHANGES)
