"""What all tables of the configuration share: known keys only, frozen, strict types, quantities by key suffix."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from servohil.hil.quantity import dimension_of, to_si

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]


class Section(BaseModel):
    """One TOML table. A number whose key ends in a unit may be a text such as "210 bar"; nothing else is converted."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _quantity_to_si(cls, value: object, info: ValidationInfo) -> object:
        dimension = dimension_of(info.field_name or "")
        if dimension is None:
            return value
        if isinstance(value, list):  # levels_m = ["100 mm", 0.2]
            return tuple(to_si(element, dimension) for element in value)
        number = to_si(value, dimension)
        whole = cls.model_fields[str(info.field_name)].annotation is int and number.is_integer()
        return int(number) if whole else number
