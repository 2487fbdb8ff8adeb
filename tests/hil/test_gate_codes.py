"""Numbers of the gate that stand in recordings, on the bus and in the tables of other programs: they never change."""

from servohil.hil.gate import DeviceState, Event, Reaction


def test_device_states() -> None:
    names = ("INIT", "DISABLED", "HOLD", "ACTIVE", "FAULT_REACTION", "FAULT_HOLD", "FAULT_DISABLED")
    assert {state.name: int(state) for state in DeviceState} == {name: k for k, name in enumerate(names)}


def test_reactions_by_severity() -> None:
    assert [(r.name, int(r)) for r in Reaction] == [
        ("NONE", 0),
        ("HOLD", 1),
        ("FAULT_HOLD", 2),
        ("RAMP", 3),
        ("STOP", 4),
    ]


def test_events_have_one_bit_each_in_this_order() -> None:
    names = (
        "OVERRUNS_HOLD", "OVERRUNS_FAULT", "SETPOINT_STALE", "SENSOR_STALE", "BAD_FRAMES", "IMPLAUSIBLE",
        "POSITION_LIMIT", "SPEED_LIMIT", "PRESSURE_LIMIT", "SLEW_LIMIT", "SUPPLY_LOST", "ESTIMATOR_UNHEALTHY",
        "NOT_FINITE", "ESTOP", "BUS_OFF", "SECOND_COMMANDER", "LEAK_WARNING", "LEAK_ALARM", "INTERNAL_ERROR",
        "COMMAND_CLIPPED", "COMMAND_SLEWED", "VALVE_FAULT",
    )  # fmt: skip
    assert {event.name: int(event) for event in Event} == {name: 1 << k for k, name in enumerate(names)}
