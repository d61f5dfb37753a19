"""Intake of a foreign file's rows into a recording, each checked once, and the scratch file of numbers read again.

A number that no rig can have measured (not finite, far outside its channel's range, a time that falls) ends the import
with the place where it stands. The scratch file has no name and lies in the recording's folder: memory does not depend
on its size, and nothing is left of it, however the import ends. Reading a column there costs a tenth of unpacking it
from the recording. Decision 113.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import ColumnWriter
from daq.files.disk import Closing, refusal
from daq.importers.formats.columns import TIME_UNITS_S, Column, Piece, Source
from daq.importers.timebase import quantum_of, to_nanoseconds
from daq.setup.errors import InputError
from daq.setup.setup import FAR_OUTSIDE, Setup
from kernels.arrays import Floats, Integers


class Scratch(Closing):
    """Columns in raw files in ``folder``, by name of the types ``dtypes``; each grows at its end."""

    def __init__(self, folder: Path, dtypes: Mapping[str, np.dtype[Any]]) -> None:
        self._folder = folder
        self._dtypes = {name: np.dtype(dtype) for name, dtype in dtypes.items()}
        self._files = {name: tempfile.TemporaryFile(dir=folder, buffering=0) for name in dtypes}  # noqa: SIM115

    def append(self, name: str, values: NDArray[Any]) -> None:
        """Add values to the end of a column; raises OSError naming the folder, when the disk refuses."""
        left = np.ascontiguousarray(values, self._dtypes[name]).data.cast("B")
        try:
            while len(left):
                left = left[self._files[name].write(left) :]
        except OSError as error:
            raise refusal(error, self._folder) from error

    def read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        """Values ``start`` to ``stop`` of a column, fewer where it ends."""
        dtype, file = self._dtypes[name], self._files[name]
        n = max(min(stop, file.seek(0, 2) // dtype.itemsize) - start, 0)
        values = np.empty(n, dtype)
        left = values.data.cast("B")
        file.seek(start * dtype.itemsize)
        while len(left):
            left = left[file.readinto(left) :]
        file.seek(0, 2)  # where `append` goes on
        return values

    def close(self) -> None:
        """Remove everything."""
        for file in self._files.values():
            file.close()


Progress = Callable[[str, int], None]
LONGEST_S = 9e9  # longest span that 64 bits of nanoseconds hold


@dataclass
class Intake:
    """Rows taken in so far: checks of each piece, and properties of all of them."""

    source: Source  # the foreign file
    columns: Mapping[str, Column]  # by role
    scales: Mapping[str, tuple[float, float]]  # by channel, volts of one unit of what is stored, and the offset
    setup: Setup  # ranges of the channels
    origin: Any = 0  # the first time as it stands in the file
    origin_s: float = 0.0  # the same in seconds
    last_s: float = -np.inf  # the last one, in seconds after it
    n_rows: int = 0
    quantum_s: float = 0.0  # coarsest decimal rounding of the time column
    spacing_s: float = 0.0  # coarsest step of its floating-point type
    repeated: str = ""  # the first row whose time equals the one before
    # by role, from which row on a value was set
    set_values: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    peak_v: dict[str, float] = field(default_factory=dict)  # largest magnitude of each channel

    @property
    def rounding_s(self) -> float:
        """Resolution of the time column, seconds."""
        return max(self.quantum_s, self.spacing_s, 1e-9)

    def take(self, piece: Piece) -> Integers:
        """Check a piece and note its properties; returns nanoseconds since the first row, empty without a time."""
        ends = {name: self._ends(piece, name) for name in dict.fromkeys(c.name for c in self.columns.values())}
        stamps = self._times_ns(piece) if "time" in self.columns else np.zeros(0, np.int64)
        for role, changes in self.set_values.items():
            values = piece.columns[self.columns[role].name]
            for i in np.flatnonzero(np.diff(values, prepend=changes[-1][1] if changes else np.nan) != 0):
                changes.append((self.n_rows + int(i), float(values[i])))
        for role, (factor, offset) in self.scales.items():
            name, described = self.columns[role].name, self.setup.channels.get(role)
            values = piece.columns[name]
            if described is None or not len(values):
                continue
            with np.errstate(over="ignore"):
                peak_v = float(np.abs(ends[name] * factor + offset).max())
            self.peak_v[role] = max(self.peak_v.get(role, 0.0), peak_v)
            limit_v = FAR_OUTSIDE * described.range_v
            if peak_v > limit_v:
                index = int(np.argmax(np.abs(values.astype(np.float64) * factor + offset) > limit_v))
                counts = "; whole numbers may be a converter's counts: write volts" if not np.any(values % 1) else ""
                raise InputError(
                    f"{self.source.path}: {piece.place(index)}, column {name}: {values[index]:.6g} is far outside the "
                    f"range of the {role} (range_v = {described.range_v:g}); is the unit right (--map "
                    f"{role}={name}:mV), or range_v of [channels.{role}] too small{counts}?"
                )
        self.n_rows += len(piece.rows)
        return stamps

    def _ends(self, piece: Piece, name: str) -> Floats:
        """Smallest and largest value of a column; refuses what is not finite, which one of the two then is."""
        values = piece.columns[name]
        if not len(values):
            return np.zeros(2)
        ends = np.array([values.min(), values.max()], np.float64)
        if values.dtype.kind == "f" and not np.isfinite(ends).all():
            index = int(np.argmin(np.isfinite(values)))
            raise InputError(
                f"{self.source.path}: {piece.place(index)}, column {name}: wanted a finite number, got "
                f"{values[index]}; cut the file there, or repair the value."
            )
        return ends

    def _times_ns(self, piece: Piece) -> Integers:
        """Nanoseconds since the first row; refuses times that fall."""
        column = self.columns["time"]
        raw = given = piece.columns[column.name]
        if raw.dtype.kind == "f" or raw.dtype == np.uint64:
            raw = raw.astype(np.float64 if raw.dtype.kind == "f" or int(raw.max()) >= 1 << 63 else np.int64)
        unit = column.unit or self.source.time_unit or "s"
        factor = TIME_UNITS_S[unit]
        if self.n_rows == 0:
            self.origin, self.origin_s = raw[0], float(raw[0]) * factor
        # times written with so many digits are rounded the more coarsely the longer they run: by both ends of a piece
        for end in (raw[:1000], raw[-1000:]):
            if self.n_rows == 0 or len(end) == 1000:  # of fewer, all may be round by chance
                quantum_s = quantum_of(end.astype(np.float64)) * factor
                self.quantum_s = max(self.quantum_s, quantum_s if np.isfinite(quantum_s) else 0.0)
        coarsest = np.spacing(given[-1]) if raw.dtype.kind == "f" else 0.0
        self.spacing_s = max(self.spacing_s, float(coarsest) * factor)
        stamps = np.empty(len(raw), np.int64)
        raw = np.ascontiguousarray(raw)
        far, falls, same, last_s = to_nanoseconds(raw, self.origin, factor, self.last_s, LONGEST_S, stamps)
        if far or falls or (same and not self.repeated):
            self._look_at_times(piece, raw, unit)
        self.last_s = float(last_s)
        return stamps

    def _look_at_times(self, piece: Piece, raw: NDArray[Any], unit: str) -> None:
        """Refuse times that are too far off, or fall; note the first that stands still."""
        with np.errstate(over="ignore", invalid="ignore"):
            seconds = (raw - self.origin) * TIME_UNITS_S[unit]
        change = np.diff(seconds, prepend=self.last_s)
        name = self.columns["time"].name
        if not (np.abs(seconds) < LONGEST_S).all():
            i = int(np.argmin(np.abs(seconds) < LONGEST_S))
            raise InputError(
                f"{self.source.path}: {piece.place(i)}, column {name}: {raw[i]:.6g} {unit} is more than 285 years "
                "from the first row; is the unit of time right (--map time=COLUMN:ns)?"
            )
        if (change < 0).any():
            i = int(np.argmax(change < 0))
            before, here = (seconds[i - 1] if i else self.last_s), seconds[i]
            raise InputError(
                f"{self.source.path}: {piece.place(i)}, column {name}: time goes back by {before - here:.9g} s, to "
                f"{here + self.origin_s:.9g} s; wanted times that rise."
            )
        if not self.repeated and (change == 0).any():
            i = int(np.argmax(change == 0))
            self.repeated = f"{piece.place(i)}, column {name}: {seconds[i] + self.origin_s:.9g} s"


def take_in(intake: Intake, writer: ColumnWriter, scratch: Scratch, progress: Progress | None) -> None:
    """Stream every row into the writer, without its time, and into the scratch, checking as it goes.

    The scratch takes ``timestamp``, too: nanoseconds since the first row, where there is a time. ``progress`` is called
    with ``"reading"`` and the rows done. Raises `InputError`, naming file, row and column of what cannot be used.
    """
    source, columns = intake.source, intake.columns
    for piece in source.pieces(list(dict.fromkeys(column.name for column in columns.values()))):
        stamps = intake.take(piece)
        if "time" in columns:
            scratch.append("timestamp", stamps)
        channels = {role: piece.columns[columns[role].name] for role in intake.scales}
        writer.append(None, channels)
        for role, values in channels.items():
            scratch.append(role, values)
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
