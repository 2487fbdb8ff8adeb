"""[reference]: what the cylinder shall do, one table per kind; the profiles themselves are in `control.references`."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from servohil.hil.config.section import NonNegative, Positive, Section
from servohil.hil.config.trajectory_file import read_trajectory

Levels = Annotated[tuple[float, ...], Field(min_length=1)]


class SineReference(Section):
    """[reference] kind = "sine": offset + amplitude sin(omega t)."""

    kind: Literal["sine"]
    offset_m: float
    amplitude_m: NonNegative
    omega_rad_per_s: Positive
    blend_s: Positive  # from the measured position into the profile; so in every kind


class StepReference(Section):
    """[reference] kind = "step": each level in turn, over and over, with a smooth ramp between them."""

    kind: Literal["step"]
    levels_m: Levels
    dwell_s: Positive  # from one change of level to the next, ramp included
    ramp_s: Positive  # from one level to the next
    blend_s: Positive


class RampReference(Section):
    """[reference] kind = "ramp": to and fro at constant speed, rounded at the ends."""

    kind: Literal["ramp"]
    from_m: float
    to_m: float
    speed_mps: Positive
    acceleration_mps2: Positive  # at the ends at most
    jerk_mps3: Positive
    pause_s: NonNegative  # at either end
    blend_s: Positive


class SCurveReference(Section):
    """[reference] kind = "s_curve": each level in turn, over and over, as fast as three limits allow."""

    kind: Literal["s_curve"]
    levels_m: Levels
    dwell_s: Positive  # from one change of level to the next, the move included
    speed_mps: Positive
    acceleration_mps2: Positive
    jerk_mps3: Positive
    blend_s: Positive


class ChirpReference(Section):
    """[reference] kind = "chirp": a sine whose frequency runs from one value to the other and back, over and over."""

    kind: Literal["chirp"]
    offset_m: float
    amplitude_m: NonNegative
    first_hz: Positive
    last_hz: Positive
    sweep_s: Positive  # from one to the other
    blend_s: Positive


class PrbsReference(Section):
    """[reference] kind = "prbs": a maximum-length binary sequence of two levels."""

    kind: Literal["prbs"]
    low_m: float
    high_m: float
    bit_s: Positive
    ramp_s: Positive  # from one level to the other, at the start of a bit
    order: Annotated[int, Field(ge=7, le=15)]  # it repeats after 2^order - 1 bits
    seed: Annotated[int, Field(ge=1)]  # the first `order` bits; below 2^order
    blend_s: Positive


class TrajectoryReference(Section):
    """[reference] kind = "trajectory": smoothly through samples, in a CSV file or here."""

    kind: Literal["trajectory"]
    file: Annotated[str, Field(min_length=1)] | None = None  # with columns t_s and position_m; relative to the TOML
    t_s: tuple[float, ...] = ()  # in place of the file
    position_m: tuple[float, ...] = ()
    repeat: bool = False  # where the last position is the first; otherwise it stays at the last
    blend_s: Positive

    def inline(self, folder: Path) -> "TrajectoryReference":
        """This table with the samples in place of the file, which lies in `folder`. Raises TrajectoryFileError."""
        if self.file is None:
            return self
        rows = read_trajectory(folder / self.file)
        columns = {"t_s": tuple(row.t_s for row in rows), "position_m": tuple(row.position_m for row in rows)}
        return self.model_copy(update={"file": None, **columns})


AnyReference = (
    SineReference
    | StepReference
    | RampReference
    | SCurveReference
    | ChirpReference
    | PrbsReference
    | TrajectoryReference
)


def _kind(table: object) -> object:
    return table.get("kind") if isinstance(table, dict) else getattr(table, "kind", None)


# A function, as pydantic's own discriminator refuses fields with a validator such as Section's.
Reference = Annotated[
    Annotated[SineReference, Tag("sine")]
    | Annotated[StepReference, Tag("step")]
    | Annotated[RampReference, Tag("ramp")]
    | Annotated[SCurveReference, Tag("s_curve")]
    | Annotated[ChirpReference, Tag("chirp")]
    | Annotated[PrbsReference, Tag("prbs")]
    | Annotated[TrajectoryReference, Tag("trajectory")],
    Discriminator(_kind),
]
