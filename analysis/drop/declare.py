"""Write measured effects into the text of a rig profile, leaving every other line as it was.

The rule kept here: a person's file is edited, not rewritten. Only the lines of the named parameters under
``[declared.<effect>]`` change; the result is parsed and compared before it is handed back.
"""

from __future__ import annotations

import datetime
import re
import tomllib
from dataclasses import dataclass

from daq.setup.errors import InputError


@dataclass(frozen=True)
class Measured:
    """A parameter with its pedigree: effect and parameter by their shared names, one standard deviation, source."""

    effect: str
    parameter: str
    value: float
    uncertainty: float
    source: str


def declare(text: str, measured: list[Measured], date: datetime.date, where: str) -> str:
    """The profile ``text`` with ``measured`` declared in it; the very same text where nothing was measured.

    Raises
    ------
    InputError
        The profile is not TOML, or declares these effects in a way that cannot be edited safely.
    """
    if not measured:
        return text
    try:
        wanted = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: not valid TOML ({error})") from error
    declared = wanted.setdefault("declared", {})
    if not isinstance(declared, dict):
        raise InputError(f"{where}: declared: expected a table, found {type(declared).__name__}")
    lines = text.splitlines()
    for item in measured:
        entry = {"value": item.value, "uncertainty": item.uncertainty, "date": date, "source": _plain(item.source)}
        declared.setdefault(item.effect, {})[item.parameter] = entry
        _put(lines, item, date)
    edited = "\n".join(lines) + "\n"
    try:
        found = tomllib.loads(edited)
    except tomllib.TOMLDecodeError:
        found = {}
    if found != wanted:
        names = ", ".join(f"[declared.{effect}]" for effect in sorted({item.effect for item in measured}))
        raise InputError(f"{where}: {names} is written in a way this cannot edit; make it a table of its own")
    return edited


def _plain(source: str) -> str:
    """Text that needs no escape in TOML."""
    return " ".join(source.replace("\\", "/").replace('"', "'").split())


def _put(lines: list[str], item: Measured, date: datetime.date) -> None:
    """Replace or add one parameter's line, in place."""
    line = (
        f"{item.parameter} = {{ value = {item.value!r}, uncertainty = {item.uncertainty!r}, "
        f'date = {date.isoformat()}, source = "{_plain(item.source)}" }}'
    )
    header = re.compile(rf"\s*\[\s*declared\s*\.\s*{re.escape(item.effect)}\s*\]\s*(#.*)?$")
    start = next((i for i, text in enumerate(lines) if header.match(text)), None)
    if start is None:
        if lines and lines[-1].strip():
            lines.append("")
        lines += [f"[declared.{item.effect}]", line]
        return
    stop = next((i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("[")), len(lines))
    key = re.compile(rf"\s*{re.escape(item.parameter)}\s*=")
    at = next((i for i in range(start + 1, stop) if key.match(lines[i])), None)
    if at is not None:
        lines[at] = line
        return
    while stop > start + 1 and not lines[stop - 1].strip():
        stop -= 1
    lines.insert(stop, line)
