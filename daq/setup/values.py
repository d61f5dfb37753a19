"""Values of a profile: strict tables, and numbers that can carry their uncertainty, date and source."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

STANDARD_GRAVITY_MPS2 = 9.80665


class Frozen(BaseModel):
    """Strict and immutable: an unknown key, a wrong type or a non-finite number is refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _bare_number(value: Any) -> Any:
    """Let a profile write ``x = 0.3`` for ``x = {value = 0.3}``."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return {"value": value}
    return value


def _iso_date(value: Any) -> Any:
    """Take ``2026-11-20`` as text for the date it writes."""
    try:
        return datetime.date.fromisoformat(value) if isinstance(value, str) else value
    except ValueError:
        raise ValueError("wanted a date as 2026-11-20") from None


class QuantityTable(Frozen):
    """A number with its uncertainty, date and source."""

    value: float
    uncertainty: float = Field(default=0.0, ge=0.0, description="one standard deviation, in the unit of the value")
    date: Annotated[datetime.date | None, BeforeValidator(_iso_date)] = None
    source: str = ""

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Editors accept the bare number as well."""
        return {"anyOf": [{"type": "number"}, handler.resolve_ref_schema(handler(core_schema))]}


Quantity = Annotated[QuantityTable, BeforeValidator(_bare_number)]


def _positive_quantity(given: QuantityTable) -> QuantityTable:
    """Refuse a scale that is not greater than zero."""
    if given.value <= 0.0:
        raise ValueError(f"wanted a value greater than 0, came {given.value:g}")
    return given


PositiveQuantity = Annotated[Quantity, AfterValidator(_positive_quantity)]


def quantity(value: float, uncertainty: float = 0.0) -> QuantityTable:
    """A number as a default of a profile."""
    return QuantityTable(value=value, uncertainty=uncertainty)


@dataclass(frozen=True)
class MeasuredValue:
    """A value for the dotted ``key`` of a profile, with its standard uncertainty, and how it was found."""

    key: str
    value: float
    uncertainty: float
    source: str
