"""Intake of a foreign file's rows into a recording, each checked once.

A number that no rig can have measured (not finite, far outside its channel's range, a time that
falls) ends the import with the place where it stands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import ColumnWriter
from daq.importers.formats.columns import SET_ROLES, TIME_UNITS_S, Column, Piece, Source
from daq.importers.scratch import Scratch
from daq.importers.timebase import quantum_of
from daq.importers.timebase_kernel import to_nanoseconds
from daq.setup.errors import InputError
from daq.setup.setup import FAR_OUTSIDE, Setup

Floats = NDArray[np.float64]
Progress = Callable[[str, int], None]
LONGEST_S = 9e9  # longest span that 64 bits of nanoseconds hold


@dataclass
class Intake:
    """Properties of the rows taken in so far."""

    origin: Any = 0
    origin_s: float = 0.0
    last_s: float = -np.inf
    n_rows: int = 0
    quantum_s: float = np.inf  # rounding step of the time column
    spacing_s: float = 0.0  # coarsest step of its floating-point type
    repeated: str = ""  # the first row whose time equals the one before
    set_values: dict[str, list[tuple[int, float]]] = field(default_factory=dict)  # by role: from which row on
    peak_v: dict[str, float] = field(default_factory=dict)  # largest magnitude of each channel

    @property
    def rounding_s(self) -> float:
        """Resolution of the time column, seconds."""
        return max(self.quantum_s if np.isfinite(self.quantum_s) else 0.0, self.spacing_s, 1e-9)


def take_in(
    source: Source,
    columns: Mapping[str, Column],
    scales: Mapping[str, tuple[float, float]],
    setup: Setup,
    writer: ColumnWriter,
    scratch: Scratch,
    progress: Progress | None,
) -> Intake:
    """Stream every row into the writer, without its time, and into the scratch, checking as it goes.

    Parameters
    ----------
    source, columns
        The foreign file, and its columns by role.
    scales
        By channel, volts of one unit of what is stored, and the offset.
    setup
        Ranges of the channels.
    writer
        Takes the channels.
    scratch
        Takes the channels too, and ``timestamp``, nanoseconds since the first row, where there is a time.
    progress
        Called with ``"reading"`` and the rows done.

    Raises
    ------
    InputError
        Naming file, row and column of what cannot be used.
    """
    intake = Intake(set_values={role: [] for role in SET_ROLES if role in columns})
    wanted = list(dict.fromkeys(column.name for column in columns.values()))
    for piece in source.pieces(wanted):
        ends = {name: _ends(source, piece, name) for name in wanted}
        n = len(piece.rows)
        if "time" in columns:
            scratch.append("timestamp", _times_ns(source, piece, columns["time"], intake))
        for role, changes in intake.set_values.items():
            _note_changes(piece.columns[columns[role].name], intake.n_rows, changes)
        for role, scale in scales.items():
            _refuse_far_outside(source, piece, role, columns[role], scale, setup, intake, ends[columns[role].name])
        channels = {role: piece.columns[columns[role].name] for role in scales}
        writer.append(None, channels)
        for role, values in channels.items():
            scratch.append(role, values)
        intake.n_rows += n
        if progress is not None:
            progress("reading", intake.n_rows)
    if intake.n_rows < 2:
        raise InputError(f"{source.path}: wanted at least 2 rows of numbers, got {intake.n_rows}.")
    if "time" in columns and intake.last_s <= 0.0:
        raise InputError(
            f"{source.path}: column {columns['time'].name} stands still: all {intake.n_rows} rows are at "
            f"{intake.origin_s:.9g} s; name the column that counts time with --map time=COLUMN, or take that column "
            "out and give --rate HZ."
        )
    writer.flush()
    return intake


def _ends(source: Source, piece: Piece, name: str) -> Floats:
    """Smallest and largest value of a column; refuses what is not finite, which one of the two then is."""
    values = piece.columns[name]
    if not len(values):
        return np.zeros(2)
    ends = np.array([values.min(), values.max()], np.float64)
    if values.dtype.kind == "f" and not np.isfinite(ends).all():
        index = int(np.argmin(np.isfinite(values)))
        raise InputError(
            f"{source.path}: {piece.place(index)}, column {name}: wanted a finite number, got {values[index]}; cut the "
            "file there, or repair the value."
        )
    return ends


def _refuse_far_outside(
    source: Source,
    piece: Piece,
    role: str,
    column: Column,
    scale: tuple[float, float],
    setup: Setup,
    intake: Intake,
    ends: Floats,
) -> None:
    """Refuse volts that the channel cannot have read; keep its largest."""
    described = getattr(setup.channels, role)
    values = piece.columns[column.name]
    if described is None or not len(values):
        return
    factor, offset = scale
    with np.errstate(over="ignore"):
        peak_v = float(np.abs(ends * factor + offset).max())
    intake.peak_v[role] = max(intake.peak_v.get(role, 0.0), peak_v)
    if peak_v > FAR_OUTSIDE * described.range_v:
        index = int(np.argmax(np.abs(values.astype(np.float64) * factor + offset) > FAR_OUTSIDE * described.range_v))
        raise InputError(
            f"{source.path}: {piece.place(index)}, column {column.name}: {values[index]:.6g} is far outside the range "
            f"of the {role} (range_v = {described.range_v:g}); is the unit right (--map {role}={column.name}:mV), or "
            f"range_v of [channels.{role}] too small?"
        )


def _times_ns(source: Source, piece: Piece, column: Column, intake: Intake) -> NDArray[np.int64]:
    """Nanoseconds since the first row; refuses times that fall."""
    raw = piece.columns[column.name]
    if raw.dtype.kind == "f" or raw.dtype == np.uint64:
        raw = raw.astype(np.float64 if raw.dtype.kind == "f" or int(raw.max()) >= 1 << 63 else np.int64)
    unit = column.unit or getattr(source, "time_unit", "")
    factor = TIME_UNITS_S[unit or "s"]
    if intake.n_rows == 0:
        intake.origin, intake.origin_s = raw[0], float(raw[0]) * factor
    intake.quantum_s = min(intake.quantum_s, quantum_of(raw.astype(np.float64)) * factor)
    coarsest = np.spacing(piece.columns[column.name][-1]) if raw.dtype.kind == "f" else 0.0
    intake.spacing_s = max(intake.spacing_s, float(coarsest) * factor)
    stamps = np.empty(len(raw), np.int64)
    raw = np.ascontiguousarray(raw)
    far, falls, same, last_s = to_nanoseconds(raw, intake.origin, factor, intake.last_s, LONGEST_S, stamps)
    if far or falls or (same and not intake.repeated):
        _look_at_times(source, piece, column, raw, factor, unit, intake)
    intake.last_s = float(last_s)
    return stamps


def _look_at_times(
    source: Source, piece: Piece, column: Column, raw: NDArray[Any], factor: float, unit: str, intake: Intake
) -> None:
    """Refuse times that are too far off, or fall; note the first that stands still."""
    with np.errstate(over="ignore", invalid="ignore"):
        seconds = (raw - intake.origin) * factor
    change = np.diff(seconds, prepend=intake.last_s)
    if not (np.abs(seconds) < LONGEST_S).all():
        i = int(np.argmin(np.abs(seconds) < LONGEST_S))
        raise InputError(
            f"{source.path}: {piece.place(i)}, column {column.name}: {raw[i]:.6g} {unit or 's'} is more than 285 years "
            "from the first row; is the unit of time right (--map time=COLUMN:ns)?"
        )
    if (change < 0).any():
        i = int(np.argmax(change < 0))
        before, here = (seconds[i - 1] if i else intake.last_s), seconds[i]
        raise InputError(
            f"{source.path}: {piece.place(i)}, column {column.name}: time goes back by {before - here:.9g} s, to "
            f"{here + intake.origin_s:.9g} s; wanted times that rise."
        )
    if not intake.repeated and (change == 0).any():
        i = int(np.argmax(change == 0))
        intake.repeated = f"{piece.place(i)}, column {column.name}: {seconds[i] + intake.origin_s:.9g} s"


def _note_changes(values: NDArray[Any], first_row: int, changes: list[tuple[int, float]]) -> None:
    """Where a set value changes, from which sample on."""
    previous = changes[-1][1] if changes else np.nan
    for i in np.flatnonzero(np.diff(values, prepend=previous) != 0):
        changes.append((first_row + int(i), float(values[i])))
