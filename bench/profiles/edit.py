"""Profiles as text: every key as the schema describes it, and edits in place.

Only the values named change; comments, order and everything else of the text stay as they are.
"""

from __future__ import annotations

import datetime
import json
import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from functools import cache
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from daq.files.disk import whole
from daq.setup.errors import InputError
from daq.setup.values import MeasuredValue
from rig.profile import json_schema, parse_profile

UNITS = {
    "hz": "Hz", "v": "V", "s": "s", "deg": "\u00b0", "kg": "kg", "m": "m", "mps2": "m/s\u00b2", "mps": "m/s",
    "days": "days", "cycles": "cycles", "samples": "samples", "volt": "g/V",
    "v_per_m": "V/m",
}  # fmt: skip
"""Unit by a key's name, or the last part of it."""
_LIMITS = {"minimum": "\u2265", "exclusiveMinimum": ">", "maximum": "\u2264", "exclusiveMaximum": "<"}
Field = dict[str, Any]


@cache
def _schema() -> dict[str, Any]:
    """The profile's JSON Schema."""
    schema: dict[str, Any] = json.loads(json_schema())
    return schema


def fields_of(text: str) -> list[Field]:
    """Every key that the profile ``text`` has or may have; raises `InputError` when the text is not TOML.

    Returns ``key`` (dotted), ``text`` (the value as TOML writes it; empty where it is not set), ``unit``, ``limit``,
    ``help``, ``choices`` (a list, empty where any value goes). The kind of back end is not among them: another one is
    another profile. Nor is a stake, which the program writes.
    """
    try:
        held = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not valid TOML: {error}") from error
    backend = held.get("backend")
    kind = str(backend.get("kind", "simulated")) if isinstance(backend, dict) else "simulated"
    every = _walk(_schema(), "", held, kind)
    return [one for one in every if one["key"] != "backend.kind" and not one["key"].startswith("stake.")]


def value_of(key: str, text: str) -> Any:
    """A typed ``text`` as the value of a key: what TOML would take, or a bare word as a text; raises `InputError`."""
    typed = text.strip()
    if not typed:
        raise InputError(f"{key}: nothing was typed; write a value, as TOML has it")
    try:
        return tomllib.loads(f"value = {typed}")["value"]
    except tomllib.TOMLDecodeError:
        if typed[0] in "\"'[{" or "\n" in typed:
            expected = "expected a number, a word, a [list] or a { table }"
            raise InputError(f"{key}: {typed!r} is no value; {expected}") from None
        return typed


def _walk(node: Mapping[str, Any], path: str, held: Any, kind: str) -> Iterator[Field]:
    """The fields below a table of the schema."""
    for name, said in node.get("properties", {}).items():
        key = f"{path}.{name}" if path else name
        if key == "$schema":
            continue
        value = held.get(name) if isinstance(held, Mapping) else None
        inner = _table(said, kind if key == "backend" else None)
        is_quantity = inner is not None and "value" in inner["properties"]
        if inner is not None and not is_quantity and key not in ("ramp.gamma", "declared"):
            yield from _walk(inner, key, value, kind)
            continue
        number = inner["properties"]["value"] if inner is not None and is_quantity else said
        found = _branches(number)
        limits = [f"{sign} {one[limit]:g}" for one in found for limit, sign in _LIMITS.items() if limit in one]
        yield {
            "key": key,
            "text": "" if value is None else toml_value(value),
            "unit": UNITS.get(name) or UNITS.get(name.rpartition("_")[2], ""),
            "limit": ", ".join(dict.fromkeys(limits)),
            "choices": [json.dumps(choice) for one in found for choice in one.get("enum", ())],
            "help": said.get("description", "a number, or { value, uncertainty, date, source }" if is_quantity else ""),
        }


def _branches(node: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A node and the alternatives in it, references followed."""
    while "$ref" in node:
        node = _schema()["$defs"][node["$ref"].rpartition("/")[2]]
    found = [dict(node)]
    for one in (*found[0].get("anyOf", ()), *found[0].get("oneOf", ())):
        found += _branches(one)
    return found


def _table(node: Mapping[str, Any], kind: str | None) -> dict[str, Any] | None:
    """The table that a node describes, of this ``kind`` of back end where that is given; None where it is a value."""
    tables = [one for one in _branches(node) if "properties" in one]
    if kind is not None:
        tables = [one for one in tables if one["properties"].get("kind", {}).get("const") == kind]
    return tables[0] if tables else None


def with_values(text: str, values: Mapping[str, Any], where: str) -> str:
    """The profile ``text`` with each of ``values`` at its dotted key (raises `InputError`, which calls it ``where``).

    ``values`` are numbers, strings, dates, lists and tables by dotted key, ``ramp.gamma``; tables that are missing are
    made. None takes a key away.
    """
    try:
        document, wanted = tomlkit.parse(text), tomllib.loads(text)
    except (TOMLKitError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{where}: not valid TOML: {error}") from error
    for dotted, value in values.items():
        *tables, key = dotted.split(".")
        table: MutableMapping[str, Any] = document
        for depth, name in enumerate(tables):
            if name not in table:
                inline = isinstance(table, InlineTable)
                table[name] = tomlkit.inline_table() if inline else tomlkit.table(depth + 1 < len(tables))
            if not isinstance(table[name], MutableMapping):
                raise InputError(f"{where}: {name}: expected a table, found {table[name]!r}")
            table = table[name]
        if value is None:
            table.pop(key, None)
        elif isinstance(value, Mapping):
            table[key] = tomlkit.inline_table()
            table[key].update(value)
        else:
            table[key] = value
        plain = wanted
        for name in tables:
            plain = plain.setdefault(name, {})
        plain[key] = value
        if value is None:
            del plain[key]
    edited = tomlkit.dumps(document)
    if tomllib.loads(edited) != wanted:
        raise InputError(f"{where}: {', '.join(values)} cannot be set in this text; write each table once and in a row")
    return edited


def declare(text: str, measured: Iterable[MeasuredValue], on: datetime.date, where: str) -> str:
    """The profile ``text`` with ``measured`` to two digits of the uncertainty, dated, with source; as `with_values`."""
    found = {}
    for one in measured:
        value, uncertainty = float(one.value), float(one.uncertainty)
        if 0.0 < uncertainty < math.inf:
            places = 1 - math.floor(math.log10(uncertainty))
            value, uncertainty = round(value, places + 1), round(uncertainty, places)
        source = " ".join(one.source.split())
        found[one.key] = {"value": value, "uncertainty": uncertainty, "date": on, "source": source}
    return with_values(text, found, where)


def write_into(path: Path, measured: Iterable[MeasuredValue], on: datetime.date) -> None:
    """Put each value at its dotted key in the profile ``path``, or leave it as it was (`InputError`, `OSError`)."""
    text = declare(path.read_bytes().decode("utf-8"), measured, on, str(path))
    parse_profile(text, str(path))
    with whole(path) as part:
        part.write_bytes(text.encode("utf-8"))


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {toml_value(own)}" for name, own in value.items()) + " }"
    text: str = tomlkit.item(value).as_string()
    return text
