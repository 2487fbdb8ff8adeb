"""What the controller does with the signals: [estimator], [limits], [leakage]."""

from typing import Annotated, Literal

from pydantic import Field

from servohil.hil.config.section import NonNegative, Positive, Section


class ProcessNoise(Section):
    """[estimator.process_std]: standard deviation added to the state per cycle."""

    position_m: NonNegative
    velocity_mps: NonNegative
    pressure_a_pa: NonNegative
    pressure_b_pa: NonNegative


class MeasurementNoise(Section):
    """[estimator.measurement_std]: standard deviation of each measurement."""

    position_m: Positive
    pressure_a_pa: Positive
    pressure_b_pa: Positive


class InitialNoise(Section):
    """[estimator.initial_std]: standard deviation of the state the filter starts from."""

    position_m: Positive
    velocity_mps: Positive
    pressure_a_pa: Positive
    pressure_b_pa: Positive


class Estimator(Section):
    """[estimator]: the filter, its sigma points and its noise figures, where "asrukf" starts estimating them."""

    filter: Literal["srukf", "asrukf"]
    alpha: Positive
    beta: NonNegative
    kappa: float
    process_std: ProcessNoise
    measurement_std: MeasurementNoise
    initial_std: InitialNoise


class Limits(Section):
    """[limits]: beyond these the gate stops the cylinder; the command is clipped to its own."""

    position_min_m: float
    position_max_m: float
    speed_max_mps: Positive
    acceleration_max_mps2: Positive | None = None  # of the reference alone; without it any
    pressure_min_pa: float
    pressure_max_pa: float
    supply_min_pa: float
    command_max_v: Annotated[float, Field(gt=0.0, le=10.0)]  # the valve takes +-10 V
    command_slew_v_per_s: Positive
    ramp_down_s: Positive
    sensor_age_periods: Annotated[int, Field(ge=1)] = 5
    bad_frames_tolerated: Annotated[int, Field(ge=0)]
    overruns_hold: Annotated[int, Field(ge=1)] = 3  # in a row
    overruns_fault: Annotated[int, Field(ge=1)] = 10  # in a row


class Leakage(Section):
    """[leakage]: the residual monitor, and what the gate does at its alarm."""

    threshold_sigma: Positive
    cusum_drift: NonNegative
    cusum_threshold: Positive
    settle_s: NonNegative
    reaction: Literal["none", "hold", "fault_hold"] = "none"
