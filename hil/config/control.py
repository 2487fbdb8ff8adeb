"""[control]: the law and its gains. Ranges that hold alone stand here; the law itself checks the rest."""

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator

from servohil.hil.config.section import NonNegative, Positive, Section

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

ORDER = 3  # of the plant: position, velocity, acceleration
Coefficients = Annotated[tuple[Positive, ...], Field(min_length=ORDER, max_length=ORDER)]
Exponent = Annotated[float, Field(gt=1.0, lt=4.0 / 3.0)]  # P3 eq. 4.15, n = 3
Bound = Annotated[float, Field(gt=0.0, le=1.0)]
Pair = Annotated[tuple[Positive, ...], Field(min_length=2, max_length=2)]


class Law(Section):
    """What every law has."""

    @field_validator("*", mode="before")
    @classmethod
    def _array(cls, value: object) -> object:
        return tuple(value) if isinstance(value, list) else value

    def gains(self) -> "NDArray[np.float64]":
        """The gain vector of the law; raises GainError naming the condition that is broken."""
        from servohil.control.laws.catalogue import LAWS

        numbers: dict[str, Any] = self.model_dump(exclude={"law", "dead_band_v"}, by_alias=True)
        law: str = self.law  # type: ignore[attr-defined]
        vector: NDArray[np.float64] = LAWS[law].gains(**numbers).vector()
        return vector


class Intsmc(Law):
    """Integral non-singular terminal sliding mode (P3 4.2)."""

    law: Literal["intsmc"]
    alpha1: Exponent
    c: Coefficients
    decay_per_s: Positive
    switching_gain: Positive  # m/s3
    boundary_layer: Positive  # m/s
    singularity_bound: Bound
    dead_band_v: NonNegative = 0.0


class IntegralTerminal(Law):
    """The corrected integral terminal law: exponents below 1."""

    law: Literal["integral_terminal"]
    alpha: Annotated[float, Field(gt=0.0, lt=1.0)]
    c: Coefficients
    switching_gain: Positive  # m/s3
    boundary_layer: Positive  # m/s2
    dead_band_v: NonNegative = 0.0


class Fintsc(Law):
    """Finite integral non-singular terminal synergetic control (P3 4.3)."""

    law: Literal["fintsc"]
    mu: Positive
    alpha1: Exponent
    power: Annotated[float, Field(gt=1.0, lt=2.0)]
    c: Coefficients
    switching_gain: NonNegative  # m/s3
    boundary_layer: Positive  # m
    epsilon: Positive  # m
    singularity_bound: Bound
    dead_band_v: NonNegative = 0.0


class Afintsc(Law):
    """FINTSC with mu from a fuzzy system of the error and its rate."""

    law: Literal["afintsc"]
    fuzzy: Literal["type2", "type1"] = "type2"
    error_scale_m: Annotated[float, Field(gt=0.0, serialization_alias="error_scale")]
    rate_scale_mps: Annotated[float, Field(gt=0.0, serialization_alias="rate_scale")]
    footprint: Annotated[float, Field(ge=0.0, le=0.15)]
    gamma: Positive
    alpha1: Exponent
    power: Annotated[float, Field(gt=1.0, lt=2.0)]
    c: Coefficients
    switching_gain: NonNegative  # m/s3
    boundary_layer: Positive  # m
    epsilon: Positive  # m
    singularity_bound: Bound
    dead_band_v: NonNegative = 0.0


class Ntsmc(Law):
    """Non-singular terminal sliding mode, the papers' baseline."""

    law: Literal["ntsmc"]
    beta: Pair
    power: Annotated[tuple[Annotated[float, Field(gt=1.0, lt=2.0)], ...], Field(min_length=2, max_length=2)]
    switching_gain: Positive  # m/s3
    boundary_layer: Positive  # m
    singularity_bound: Bound
    dead_band_v: NonNegative = 0.0


class Smc(Law):
    """Conventional sliding mode."""

    law: Literal["smc"]
    decay_per_s: Positive
    switching_gain: Positive  # m/s3
    boundary_layer: Positive  # m/s2
    dead_band_v: NonNegative = 0.0


class PolePlacement(Law):
    """Feedback linearisation, all poles in one place."""

    law: Literal["pole_placement"]
    pole_per_s: Positive
    integral: bool
    order: Literal[3] = 3
    dead_band_v: NonNegative = 0.0


class Pid(Law):
    """PID with velocity feedforward; in V per m, m s, m/s, m/s."""

    law: Literal["pid"]
    proportional: Positive
    integral: NonNegative
    derivative: NonNegative
    velocity_feedforward: NonNegative = 0.0
    dead_band_v: NonNegative = 0.0


def _law(table: object) -> object:
    return table.get("law") if isinstance(table, dict) else getattr(table, "law", None)


# A function, as pydantic's own discriminator refuses fields with a validator such as Section's.
Control = Annotated[
    Annotated[Intsmc, Tag("intsmc")]
    | Annotated[IntegralTerminal, Tag("integral_terminal")]
    | Annotated[Fintsc, Tag("fintsc")]
    | Annotated[Afintsc, Tag("afintsc")]
    | Annotated[Ntsmc, Tag("ntsmc")]
    | Annotated[Smc, Tag("smc")]
    | Annotated[PolePlacement, Tag("pole_placement")]
    | Annotated[Pid, Tag("pid")],
    Discriminator(_law),
]
