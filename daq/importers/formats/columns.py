"""Columns of foreign files: their roles (time, channels, set values), their units, and what every format gives.

No role is guessed: a column gets it from its name (`time_s`, `Drive (mV)`, `accel_g` ...) or from the caller. Two
candidates for one role are an error that asks for ``--map``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels.registry import CHANNELS, KINDS
from daq.importers.tables import split_unit
from daq.setup.errors import InputError
from kernels.arrays import Integers

SET_ROLES = ("frequency", "level")
ROLES = ("time", *KINDS, *SET_ROLES)
PIECE_ROWS = 65536
_SHOWN, _SHOWN_CHARACTERS = 24, 80

_ALIASES = {
    "time": {"time", "t", "times", "timestamp", "timestamps", "elapsed", "elapsedtime", "seconds", "zeit", "xvalue",
             "xaxis"},
    **{name: kind.aliases for name, kind in KINDS.items()},
}  # fmt: skip
_SUFFIXES = ("voltage", "volts", "signal", "channel")  # of a name that mean nothing
TIME_UNITS_S = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
VOLT_UNITS = {"v": 1.0, "volt": 1.0, "volts": 1.0, "mv": 1e-3}
ACCELERATION_UNITS = {"g": "V/g", "m/s^2": "V/(m/s^2)", "m/s2": "V/(m/s^2)", "mps2": "V/(m/s^2)"}
_SPELLINGS = {"m/s²": "m/s^2", "m/s**2": "m/s^2", "gn": "g", "g_n": "g", "volts": "v", "microseconds": "us"}
_KNOWN_UNITS = {*TIME_UNITS_S, *VOLT_UNITS, *ACCELERATION_UNITS, "hz"}
MAP_UNITS = "s ms us ns V mV fs g m/s^2"  # as bench import --help has them
RATE_NAMES = {"rate", "ratehz", "fs", "samplerate", "samplingrate", "sampleratehz", "fshz"}


@dataclass(frozen=True)
class Column:
    """A column of the source and the unit it is in (empty: seconds, volts, hertz)."""

    name: str
    unit: str = ""


@dataclass(frozen=True)
class Piece:
    """Some rows: one array a column, and how to name a row of them to a person."""

    columns: Mapping[str, NDArray[Any]]
    rows: Sequence[int] | Integers
    row_word: str = "row"

    def place(self, index: int) -> str:
        """``row 17`` or ``line 18``."""
        return f"{self.row_word} {int(self.rows[index])}"


class Source:
    """A table of numbers in somebody's file; the classes of the formats say how it is read.

    Attributes
    ----------
    path
    names
        Every column.
    left_out
        What cannot be a column, by name: why.
    rate_hz
        Samples a second, where the file states them.
    header
        The line that was taken for the header, in words; text files only.
    time_unit
        Unit of a column of time stamps whose name states none.
    """

    names: tuple[str, ...] = ()
    rate_hz: float | None = None
    header = ""
    time_unit = ""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.left_out: dict[str, str] = {}

    def scale(self, name: str, range_v: float) -> tuple[float, float]:
        """``(volts, offset_v)`` of one unit of a column, where the file itself says so; else ``(1, 0)``."""
        return 1.0, 0.0

    def dtype(self, name: str) -> np.dtype[Any]:
        """Type in which the column's numbers are stored."""
        return np.dtype("<f8")

    def pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """The named columns, some rows at a time (raises InputError, naming the row that cannot be used)."""
        raise NotImplementedError


def columns_of(source: Source) -> str:
    """The columns of a source for an error, and what cannot be a column."""
    header = f" ({source.header})" if source.header else ""
    left_out = f"; not read: {reasons(source)}" if source.left_out else ""
    return listed(source.names) + header + left_out


def reasons(source: Source) -> str:
    """Columns that are left out, each with its reason."""
    each = [f"{listed([name])} ({why})" for name, why in source.left_out.items()]
    return ", ".join(each[:_SHOWN]) + (f" and {len(each) - _SHOWN} more" if len(each) > _SHOWN else "")


def listed(names: Sequence[str]) -> str:
    """Names for an error: the first few, without what would steer a terminal."""
    few = ["".join(c if c.isprintable() else "?" for c in name[:_SHOWN_CHARACTERS]) for name in names[:_SHOWN]]
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return (", ".join(few) or "none") + more


def parse_map(items: Sequence[str]) -> dict[str, Column]:
    """``role=column[:unit]`` as the command line gives it (raises InputError: unknown or repeated)."""
    mapping: dict[str, Column] = {}
    for item in items:
        role, separator, column = item.partition("=")
        role = role.strip().lower()
        if not separator or role not in ROLES or not column or role in mapping:
            raise InputError(
                f"--map {item}: wanted role=column or role=column:unit, each role once; roles are {', '.join(ROLES)}."
            )
        name, colon, unit = column.rpartition(":")
        if colon and _unit_fits(role, unit):
            mapping[role] = Column(name, unit.lower())
        else:
            mapping[role] = Column(column)
    return mapping


def _unit_fits(role: str, unit: str) -> bool:
    unit = unit.lower()
    if role == "time":
        return unit in TIME_UNITS_S
    return role not in SET_ROLES and (unit in VOLT_UNITS or unit == "fs" or unit in ACCELERATION_UNITS)


def split_name(name: str) -> tuple[str, str]:
    """A column's bare name (letters and digits, lower case) and the unit its name states, if any.

    ``Time (ms)`` is ``("time", "ms")``, ``accelerometer_v`` is ``("accelerometer", "v")``.
    """
    # folders of an HDF5 file go, the stroke of a unit in brackets stays
    last = re.sub(r"^.*/(?![^(\[]*[)\]])", "", name.strip().lower())
    text, unit = split_unit(last, _KNOWN_UNITS)
    return re.sub(r"[^a-z0-9]", "", text), unit


def with_unit(name: str, unit: Any) -> str:
    """``name (unit)`` where a file states a unit that is understood, and the name states none."""
    text = str(unit or "").strip().lower()
    text = _SPELLINGS.get(text, text)
    return f"{name} ({text})" if text in _KNOWN_UNITS - {"hz"} and not split_name(name)[1] else name


def assign(source: Source, mapping: Mapping[str, Column], described: Iterable[str] = CHANNELS) -> dict[str, Column]:
    """Columns by role.

    Raises `InputError` when a mapped column is missing, a role has two candidates, or there is no accelerometer.

    Parameters
    ----------
    source
        The file.
    mapping
        The caller's choice, which wins. Set frequency and set level are used only when mapped.
    described
        Channels of the profile. A further one (a displacement) is sought by name only where the profile has it, so
        that a column of that name in any file is not taken for it.
    """
    chosen = {role: _mapped(source, role, column) for role, column in mapping.items()}
    taken = {column.name for column in chosen.values()}
    for role, aliases in _ALIASES.items():
        if role in chosen or (role in KINDS and role not in {*CHANNELS, *described}):
            continue
        found = []
        for name in source.names:
            bare, unit = split_name(name)
            for word in _SUFFIXES:
                bare = bare.removesuffix(word) if bare != word else bare
            if name not in taken and bare in aliases and (not unit or _unit_fits(role, unit)):
                found.append(name)
        exact = [n for n in found if split_name(n)[0] == role]
        if len(exact) == 1:
            found = exact
        if len(found) > 1:
            raise InputError(f"{source.path}: columns {listed(found)} could all be {role}; say --map {role}=COLUMN.")
        if found:
            chosen[role] = Column(found[0], split_name(found[0])[1])
    if "accelerometer" not in chosen:
        raise InputError(
            f"{source.path}: no column for the accelerometer among {columns_of(source)}; wanted accelerometer_v, "
            "or say --map accelerometer=COLUMN."
        )
    return chosen


def _mapped(source: Source, role: str, column: Column) -> Column:
    """A mapped column under the name that the source knows: its name, another case of it, its last part, or its number.

    The last part is what follows the folders of an HDF5 file; a unit in brackets may be left out; numbers count from 1.
    """
    if column.name in source.names:
        match = column.name
    else:
        wanted = column.name.strip().lower()
        names = [n.strip().lower() for n in source.names]
        bare = [re.sub(r"\s*[(\[][^()\[\]]*[)\]]$", "", n) for n in names]
        for forms in (names, [n.rsplit("/", 1)[-1] for n in names], bare, [n.rsplit("/", 1)[-1] for n in bare]):
            if same := [n for n, form in zip(source.names, forms, strict=True) if form == wanted]:
                break
        if len(same) == 1:
            match = same[0]
        elif column.name.isdigit() and 1 <= int(column.name) <= len(source.names):
            match = source.names[int(column.name) - 1]
        else:
            units = f"; after a colon wanted a unit: {MAP_UNITS}" if ":" in column.name else ""
            raise InputError(
                f"{source.path}: --map {role}={column.name}: no such column; it has {columns_of(source)}{units}."
            )
    unit = column.unit or split_name(match)[1]
    return Column(match, unit if _unit_fits(role, unit) else "")
