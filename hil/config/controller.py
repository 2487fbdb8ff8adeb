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


class TwinNoise(Section):
    """[leakage.process_std]: process noise of the diagnosis' own filter, per millisecond: that of a good model, for
    what the model leaves out is among the changes that the diagnosis looks for."""

    position_m: NonNegative = 1e-8
    velocity_mps: NonNegative = 3e-5
    pressure_a_pa: NonNegative = 2e3
    pressure_b_pa: NonNegative = 2e3


class Leakage(Section):
    """[leakage]: the diagnosis and the residual test beside it, and what the gate does at a leak alarm."""

    threshold_sigma: Positive
    cusum_drift: NonNegative
    cusum_threshold: Positive
    settle_s: NonNegative
    reaction: Literal["none", "hold", "fault_hold"] = "none"
    learn_s: NonNegative = 0.0  # of healthy motion, for baseline and model; 0: [cylinder] is the truth
    hours_between_false_suspicions: Positive = 1000.0
    judge_s: Positive = 0.5  # from the suspicion to the first verdict
    give_up_s: Positive = 60.0  # then an unexplained change becomes part of the baseline
    confidence: Annotated[float, Field(gt=0.5, lt=1.0)] = 0.999
    warn_m3_per_s: Positive = 0.05 / 6e4  # above the baseline
    alarm_m3_per_s: Positive = 0.3 / 6e4
    process_std: TwinNoise = TwinNoise()
    measurement_std: MeasurementNoise | None = None  # None: of [estimator]
