"""Every key of a profile, as the schema describes it: value, unit, limits, help; and a typed text as its value."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from bench.profiles.edit import toml_value
from daq.setup.errors import InputError
from rig.profile import json_schema

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
    found = [dict(_followed(node))]
    for one in (*found[0].get("anyOf", ()), *found[0].get("oneOf", ())):
        found += _branches(one)
    return found


def _followed(node: Mapping[str, Any]) -> Mapping[str, Any]:
    """A node, or what its reference leads to."""
    while "$ref" in node:
        node = _schema()["$defs"][node["$ref"].rpartition("/")[2]]
    return node


def _table(node: Mapping[str, Any], kind: str | None) -> dict[str, Any] | None:
    """The table that a node describes, of this ``kind`` of back end where that is given; None where it is a value."""
    tables = [one for one in _branches(node) if "properties" in one]
    if kind is not None:
        tables = [one for one in tables if one["properties"].get("kind", {}).get("const") == kind]
    return tables[0] if tables else None
