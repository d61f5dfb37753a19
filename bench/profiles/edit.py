"""Edits of a profile's TOML text: values set in place, measured quantities, declared effects.

Only the values named change; comments, order and everything else of the text stay as they are.
"""

from __future__ import annotations

import datetime
import math
import tomllib
from collections.abc import Iterable, Mapping, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from daq.files.whole_file import whole
from daq.setup.errors import InputError
from daq.setup.values import MeasuredValue
from rig.profile import parse_profile


def with_values(text: str, values: Mapping[str, Any], where: str) -> str:
    """The profile ``text`` with each of ``values`` at its dotted key.

    Raises `InputError` when ``text`` is not TOML, or a key leads through something that is no table.

    Parameters
    ----------
    text
        TOML.
    values
        Numbers, strings, dates, lists and tables by dotted key, ``ramp.gamma``; tables that are missing are made. None
        takes a key away.
    where
        Name of the text, for messages.
    """
    try:
        document, wanted = tomlkit.parse(text), tomllib.loads(text)
    except (TOMLKitError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{where}: not valid TOML: {error}") from error
    for dotted, value in values.items():
        *tables, key = dotted.split(".")
        table: MutableMapping[str, Any] = document
        for depth, name in enumerate(tables):
            table = _table(table, name, where, holds_tables=depth + 1 < len(tables))
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
    """The profile ``text`` with ``measured``, rounded, with uncertainty, date and source; raises as `with_values`."""
    return with_values(text, {one.key: _quantity(one, on) for one in measured}, where)


def write_into(path: Path, measured: Iterable[MeasuredValue], on: datetime.date) -> None:
    """Put each value at its dotted key in the profile ``path``.

    Raises
    ------
    InputError
        When the file would not be a profile any more; it is left as it was.
    OSError
        When it cannot be read or written.
    """
    text = declare(path.read_bytes().decode("utf-8"), measured, on, str(path))
    parse_profile(text, str(path))
    with whole(path) as part:
        part.write_bytes(text.encode("utf-8"))


def _table(parent: MutableMapping[str, Any], name: str, where: str, *, holds_tables: bool) -> MutableMapping[str, Any]:
    """The table ``name`` of ``parent``, made where there is none."""
    if name not in parent:
        parent[name] = tomlkit.inline_table() if isinstance(parent, InlineTable) else tomlkit.table(holds_tables)
    found = parent[name]
    if not isinstance(found, MutableMapping):
        raise InputError(f"{where}: {name}: expected a table, found {found!r}")
    return found


def _quantity(one: MeasuredValue, on: datetime.date) -> dict[str, Any]:
    """Value, uncertainty, date and source as a profile holds them.

    The uncertainty has two digits, the value one more than it can carry.
    """
    value, uncertainty = float(one.value), float(one.uncertainty)
    if 0.0 < uncertainty < math.inf:
        places = 1 - math.floor(math.log10(uncertainty))
        value, uncertainty = round(value, places + 1), round(uncertainty, places)
    return {"value": value, "uncertainty": uncertainty, "date": on, "source": " ".join(one.source.split())}


def toml_value(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {toml_value(own)}" for name, own in value.items()) + " }"
    text: str = tomlkit.item(value).as_string()
    return text
