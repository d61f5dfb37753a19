"""Strict TOML, and values that can carry their uncertainty, date and source.

Strict TOML: a file either becomes a checked, frozen model, or one error names every fault in it.
Each fault is one line with its dotted key, what was wanted and what came; a key that is nearly right is answered with
the right one.
"""

from __future__ import annotations

import codecs
import datetime
import difflib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from daq.setup.errors import InputError, require_file

Model = TypeVar("Model", bound=BaseModel)

_TOO_DEEP = "tables or lists lie too deep in one another; wanted a table within a table, a few levels at most"
_LIMITS = {"gt": "greater than", "ge": "at least", "lt": "less than", "le": "at most"}


def load_toml(path: Path, model: type[Model]) -> tuple[Model, str]:
    """Read ``path`` into ``model`` and return it with the file's text.

    Raises `InputError` when the file cannot be read, is no TOML, or does not fit the model (all faults in one message).
    """
    text = read_toml_text(path)
    return parse_toml(text, model, str(path)), text


def read_toml_text(path: Path) -> str:
    """The text of a TOML file, whatever mark it begins with and however its lines end (raises InputError)."""
    require_file(path)
    try:
        raw = path.read_bytes()
        utf16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        return raw.decode("utf-16" if utf16 else "utf-8-sig").replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: wanted a readable TOML file in UTF-8; {error}") from error


def parse_toml(text: str, model: type[Model], name: str) -> Model:
    """Check TOML ``text`` against ``model``; ``name`` stands for the file in messages.

    Raises `InputError` when the text is no TOML or does not fit the model (all faults in one message).
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{name}: {_TOO_DEEP}") from error
    except ValueError as error:  # the one other that reading a number raises
        raise InputError(f"{name}: holds a whole number of thousands of digits; write a shorter one") from error
    try:
        # through JSON, because strict checking there still takes arrays for tuples and ISO dates for dates
        return model.model_validate_json(json.dumps(data, default=lambda when: when.isoformat()), strict=True)
    except RecursionError as error:
        raise InputError(f"{name}: {_TOO_DEEP}") from error
    except ValidationError as error:
        lines: list[str] = []
        for fault in error.errors(include_url=False):
            place = _place(fault["loc"], data, missing=fault["type"] == "missing")
            dotted = ""  # as ramp.gamma[2]
            for key in place:
                dotted += f"[{key}]" if isinstance(key, int) else f".{key}" if dotted else key
            came = ""
            if fault["type"] != "missing" and not isinstance(fault["input"], dict) and ", came " not in fault["msg"]:
                text = json.dumps(fault["input"], default=str, ensure_ascii=False)
                came = f", came {text if len(text) <= 60 else text[:57] + '...'}"
            lines.append(f"{dotted or '(file)'}: {_wanted(fault, place, data, model)}{came}")
        lines = list(dict.fromkeys(lines))
        count = "1 fault" if len(lines) == 1 else f"{len(lines)} faults"
        raise InputError(f"{name}: {count}\n" + "\n".join(f"  {line}" for line in lines)) from error


def _place(location: tuple[int | str, ...], data: Any, *, missing: bool) -> list[int | str]:
    """Keys of ``location`` that stand in the file, and a missing last one, without the names of union branches."""
    place: list[int | str] = []
    here: Any = data
    for i, key in enumerate(location):
        if isinstance(here, Mapping) and isinstance(key, str) and key in here:
            here = here[key]
        elif isinstance(here, list) and isinstance(key, int):
            here = here[key] if key < len(here) else None
        elif not (missing and i == len(location) - 1):
            continue
        place.append(key)
    return place


def _wanted(fault: Any, place: list[int | str], data: dict[str, Any], model: type[BaseModel]) -> str:
    """The expected content of the place."""
    kind, context = fault["type"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        siblings = _allowed(fault["loc"], model)
        near = difflib.get_close_matches(str(place[-1]), siblings, n=1, cutoff=0.6)
        hint = f"; did you mean {near[0]}?" if near else f"; known here: {', '.join(siblings)}" if siblings else ""
        return f"unknown key{hint}"
    if kind == "missing":
        return "missing; this key is required"
    if kind == "literal_error":
        return f"wanted {context['expected']}"
    if kind in {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}:
        (name, bound), *_ = context.items()
        return f"wanted a number {_LIMITS[name]} {bound:g}"
    if kind in {"model_type", "model_attributes_type"}:
        bare = context.get("class_name") == "QuantityTable"
        return "wanted a number, or a table { value = ..., uncertainty = ... }" if bare else "wanted a table"
    if kind in {"too_long", "too_short"}:
        number = context.get("max_length", context.get("min_length"))
        return f"wanted {'at most' if kind == 'too_long' else 'at least'} {number} values"
    simple = {
        "float_type": "wanted a number",
        "int_type": "wanted a whole number",
        "int_from_float": "wanted a whole number",
        "string_type": "wanted text in quotes",
        "bool_type": "wanted true or false",
        "finite_number": "wanted a finite number",
        "value_error": str(context.get("error", "")),
        "tuple_type": "wanted a list in brackets",
        "list_type": "wanted a list in brackets",
        "dict_type": "wanted a table",
        **dict.fromkeys(("date_type", "date_parsing", "date_from_datetime_parsing"), "wanted a date as 2026-11-20"),
    }
    return simple.get(kind, f"wanted: {fault['msg']}")


def _allowed(location: tuple[int | str, ...], model: type[BaseModel]) -> list[str]:
    """The keys of the table that holds ``location``, from the model's own schema."""
    schema = model.model_json_schema()
    definitions = schema.get("$defs", {})
    nodes = [schema]
    for key in location[:-1]:
        below = []
        for branch in (b for node in nodes for b in _branches(node, definitions)):
            if key in branch.get("properties", {}):
                below.append(branch["properties"][key])
            elif isinstance(branch.get("additionalProperties"), dict):
                below.append(branch["additionalProperties"])
        nodes = below or nodes  # the name of a union branch leads nowhere: stay
    return sorted({name for node in nodes for b in _branches(node, definitions) for name in b.get("properties", {})})


def _branches(node: dict[str, Any], definitions: dict[str, Any]) -> list[dict[str, Any]]:
    """``node`` with references followed and unions opened."""
    if "$ref" in node:
        return _branches(definitions[node["$ref"].rsplit("/", 1)[-1]], definitions)
    inner = [*node.get("anyOf", []), *node.get("oneOf", []), *node.get("allOf", [])]
    return [node, *(b for child in inner for b in _branches(child, definitions))]


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
