"""Measured effects as declarations in the text of a profile; comments, order and all other lines stay as they are."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, MutableMapping
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from analysis.drop.outcome import Measured
from daq.setup.errors import InputError

__all__ = ["Measured", "declare", "withdraw"]


def declare(text: str, measured: Iterable[Measured], date: datetime.date, where: str) -> str:
    """The profile ``text`` with each of ``measured`` under ``[declared.EFFECT]``.

    Raises
    ------
    InputError
        The profile is not TOML, or ``declared`` is no table.
    """
    document = _parsed(text, where)
    for item in measured:
        effects = _table(document, "declared", where, above=True)
        parameters = _table(effects, item.effect, where)
        parameters[item.parameter] = _quantity(item, date)
    return tomlkit.dumps(document)


def withdraw(text: str, effects: Iterable[str], where: str) -> str:
    """The profile ``text`` without the declarations of ``effects``; raises as `declare` does."""
    document = _parsed(text, where)
    for effect in effects:
        _table(document, "declared", where, above=True).pop(effect, None)
    return tomlkit.dumps(document)


def _parsed(text: str, where: str) -> tomlkit.TOMLDocument:
    try:
        return tomlkit.parse(text)
    except TOMLKitError as error:
        raise InputError(f"{where}: not valid TOML ({error})") from error


def _table(parent: MutableMapping[str, Any], name: str, where: str, above: bool = False) -> MutableMapping[str, Any]:
    """The table ``name`` of ``parent``, made where there is none; ``above``: one that only holds tables."""
    if name not in parent:
        parent[name] = tomlkit.inline_table() if isinstance(parent, InlineTable) else tomlkit.table(above)
    found = parent[name]
    if not isinstance(found, MutableMapping):
        raise InputError(f"{where}: {name}: expected a table, found {found!r}")
    return found


def _quantity(item: Measured, date: datetime.date) -> InlineTable:
    entry = tomlkit.inline_table()
    entry.update({"value": item.value, "uncertainty": item.uncertainty, "date": date})
    entry["source"] = " ".join(item.source.split())
    return entry
