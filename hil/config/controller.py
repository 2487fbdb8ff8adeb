"""What the controller does with the signals: [estimator], [control], [reference], [limits], [leakage]."""

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

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


class SineReference(Section):
    """[reference] kind = "sine": offset + amplitude sin(omega t)."""

    kind: Literal["sine"]
    offset_m: float
    amplitude_m: NonNegative
    omega_rad_per_s: Positive
    blend_s: Positive  # from the measured position into the profile


class StepReference(Section):
    """[reference] kind = "step": each level in turn, over and over, with a smooth ramp between them."""

    kind: Literal["step"]
    levels_m: Annotated[tuple[float, ...], Field(min_length=1)]
    dwell_s: Positive  # from one change of level to the next, ramp included
    ramp_s: Positive  # from one level to the next
    blend_s: Positive  # from the measured position to the first level


def _kind(table: object) -> object:
    return table.get("kind") if isinstance(table, dict) else getattr(table, "kind", None)


# A function, as pydantic's own discriminator refuses fields with a validator such as Section's.
Reference = Annotated[
    Annotated[SineReference, Tag("sine")] | Annotated[StepReference, Tag("step")], Discriminator(_kind)
]


class Limits(Section):
    """[limits]: beyond these the gate stops the cylinder; the command is clipped to its own."""

    position_min_m: float
    position_max_m: float
    speed_max_mps: Positive
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
