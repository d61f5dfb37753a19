"""Turn somebody's file into a recording: stream it in, find its time base, find its steps, check, rename.

The rule kept here: all or nothing. The recording appears under its name only when everything in it was read, found
consistent, written and read back; values are stored as they came, never requantised.
"""

from __future__ import annotations

import datetime
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.block import BLOCK_DTYPE
from daq.coarse import Read
from daq.columns import ColumnWriter
from daq.errors import InputError
from daq.foreign import (
    ACCELERATION_UNITS,
    CHANNEL_ROLES,
    SET_ROLES,
    TIME_UNITS_S,
    VOLT_UNITS,
    Column,
    Piece,
    Source,
    assign,
)
from daq.import_remarks import contact_doubts, remarks
from daq.reader import timestamps_ns
from daq.setup import Setup
from daq.steps import FoundStep, find_steps, gamma_of, given_step, step_table
from daq.timebase import Timebase, quantum_of, timebase_of
from daq.tracking import fit
from daq.writer import now_utc, root_attributes

Floats = NDArray[np.float64]
Progress = Callable[[str, int], None]

EPOCH_S = 1e9  # a larger first time is seconds since 1970
SHORTEST_FELT_CYCLES = 6.0  # of a step found in the accelerometer: there the middle of a fade may look still, for less


@dataclass(frozen=True)
class ImportSummary:
    """What an import did: sizes, time base, steps, which column became what, and what a person should know."""

    path: Path
    n_samples: int
    timebase: Timebase
    steps: NDArray[np.void]
    columns: dict[str, str]
    remarks: list[str]


@dataclass
class _Intake:
    """What is learned while the rows go by."""

    origin: Any = 0
    origin_s: float = 0.0
    last_s: float = -np.inf
    n_rows: int = 0
    quantum_s: float = np.inf  # rounding step of the time column
    spacing_s: float = 0.0  # coarsest step of its floating-point type
    repeated: str = ""  # the first row whose time equals the one before
    set_values: dict[str, list[tuple[int, float]]] = field(default_factory=dict)  # by role: from which row on

    @property
    def rounding_s(self) -> float:
        """How coarse the time column is, seconds."""
        return max(self.quantum_s if np.isfinite(self.quantum_s) else 0.0, self.spacing_s, 1e-9)


def import_recording(
    source: Source,
    out: Path,
    setup: Setup,
    profile_text: str,
    *,
    mapping: Mapping[str, Column] | None = None,
    rate_hz: float | None = None,
    note: str | None = None,
    extra: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> ImportSummary:
    """Write ``out`` from a foreign file.

    Parameters
    ----------
    source
        The open foreign file.
    out
        Recording to create.
    setup, profile_text
        What was measured with what, and the profile's text.
    mapping
        Columns by role where names do not say.
    rate_hz
        Sample rate where there is no time column.
    note, extra
        Kept in the recording.
    progress
        Called with what is being done and how many rows are done.

    Raises
    ------
    InputError
        Naming file and row of what cannot be used; nothing is left behind.
    """
    columns = assign(source, mapping or {})
    channels = [role for role in CHANNEL_ROLES if role in columns]
    rate = rate_hz or source.rate_hz
    if "time" not in columns and rate is None:
        raise InputError(
            f"{source.path}: no time column among {', '.join(source.names)}; name it with --map time=COLUMN or give "
            "the sample rate with --rate HZ."
        )
    setup = _adapted(setup, columns, channels)
    attributes = root_attributes(setup, profile_text=profile_text, backend="import", simulated=False, note=note)
    scales = {role: _scale(source, columns[role], role, setup) for role in channels}
    writer = _begun(source, columns, out, setup, scales, attributes)
    try:
        intake = _take_in(source, columns, channels, writer, progress)
        base = _timebase(source, writer, intake, "time" in columns, rate)
        setup = setup.model_copy(update={"sampling": setup.sampling.model_copy(update={"rate_hz": base.rate_hz})})
        steps, from_drive = _find(writer, scales, setup, base, intake, progress)
        doubts = contact_doubts(_volts(writer, scales, "continuity"), setup, steps) if "continuity" in scales else []
        late = _late_attributes(source, columns, setup, base, intake, extra)
        writer.check(steps, _blocks(base, writer.n_samples), **late)
    except BaseException:
        writer.abandon()
        raise
    writer.rename()
    named = {role: column.name for role, column in columns.items()}
    said = remarks(base, steps, channels, from_drive) + doubts
    return ImportSummary(out, writer.n_samples, base, steps, named, said)


def _begun(
    source: Source, columns: Mapping[str, Column], out: Path, setup: Setup, scales: Mapping[str, tuple[float, float]],
    attributes: Mapping[str, Any],
) -> ColumnWriter:
    """The column file, empty; each channel in the type that its column has."""
    dtypes = {role: source.dtype(columns[role].name) for role in scales}
    ending = {"channels": list(scales), "started": "", "ended": "complete", "why": "", "ended_at": ""}
    return ColumnWriter(out, setup, dtypes, scales, {**attributes, **ending})


def _scale(source: Source, column: Column, role: str, setup: Setup) -> tuple[float, float]:
    """Volts of one unit of what is stored, and the offset."""
    described = getattr(setup.channels, role)
    range_v = described.range_v if described is not None else 10.0
    if column.unit == "fs":
        return range_v, 0.0
    factor, offset = source.scale(column.name, range_v)
    unit_v = VOLT_UNITS.get(column.unit, 1.0)
    return factor * unit_v, offset * unit_v


def _adapted(setup: Setup, columns: Mapping[str, Column], channels: list[str]) -> Setup:
    """The set-up as the file has it: without a channel that is absent; 1 V a unit for a calibrated acceleration."""
    changed: dict[str, Any] = {}
    if "continuity" not in channels:
        changed["continuity"] = None
    unit = columns["accelerometer"].unit
    if unit in ACCELERATION_UNITS:
        old = setup.channels.accelerometer
        relative = old.sensitivity.uncertainty / old.sensitivity.value
        source = f"column {columns['accelerometer'].name} is in {unit}"
        sensitivity = old.sensitivity.model_copy(update={"value": 1.0, "uncertainty": relative, "source": source})
        changed["accelerometer"] = old.model_copy(
            update={"sensitivity": sensitivity, "unit": ACCELERATION_UNITS[unit]}
        )
    return setup.model_copy(update={"channels": setup.channels.model_copy(update=changed)})


def _take_in(
    source: Source, columns: Mapping[str, Column], channels: list[str], writer: ColumnWriter, progress: Progress | None
) -> _Intake:
    """Stream every row into the writer, checking as it goes."""
    intake = _Intake(set_values={role: [] for role in SET_ROLES if role in columns})
    wanted = list(dict.fromkeys(column.name for column in columns.values()))
    for piece in source.pieces(wanted):
        for column in columns.values():
            _refuse_not_finite(source, piece, column.name)
        n = len(piece.rows)
        if "time" in columns:
            stamps = _times_ns(source, piece, columns["time"], intake)
        else:
            stamps = np.arange(intake.n_rows, intake.n_rows + n, dtype=np.int64)
        for role, changes in intake.set_values.items():
            _note_changes(piece.columns[columns[role].name], intake.n_rows, changes)
        writer.append(stamps, {role: piece.columns[columns[role].name] for role in channels})
        intake.n_rows += n
        if progress is not None:
            progress("reading", intake.n_rows)
    if intake.n_rows < 2:
        raise InputError(f"{source.path}: wanted at least 2 rows of numbers, got {intake.n_rows}.")
    writer.flush()
    return intake


def _refuse_not_finite(source: Source, piece: Piece, name: str) -> None:
    values = piece.columns[name]
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        index = int(np.argmin(np.isfinite(values)))
        raise InputError(
            f"{source.path}: {piece.place(index)}, column {name}: wanted a finite number, got {values[index]}; cut the "
            "file there, or repair the value."
        )


def _times_ns(source: Source, piece: Piece, column: Column, intake: _Intake) -> NDArray[np.int64]:
    """Nanoseconds since the first row; refuses times that fall."""
    raw = piece.columns[column.name]
    if raw.dtype.kind == "f":
        raw = raw.astype(np.float64)
    unit = column.unit or getattr(source, "time_unit", "")
    factor = TIME_UNITS_S[unit or "s"]
    if intake.n_rows == 0:
        intake.origin, intake.origin_s = raw[0], float(raw[0]) * factor
    intake.quantum_s = min(intake.quantum_s, quantum_of(raw.astype(np.float64)) * factor)
    coarsest = np.spacing(piece.columns[column.name][-1]) if raw.dtype.kind == "f" else 0.0
    intake.spacing_s = max(intake.spacing_s, float(coarsest) * factor)
    seconds = (raw - intake.origin) * factor
    change = np.diff(seconds, prepend=intake.last_s)
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
    intake.last_s = float(seconds[-1])
    stamps: NDArray[np.int64] = np.rint(seconds * 1e9).astype(np.int64)
    return stamps


def _note_changes(values: NDArray[Any], first_row: int, changes: list[tuple[int, float]]) -> None:
    """Where a set value changes, from which sample on."""
    previous = changes[-1][1] if changes else np.nan
    for i in np.flatnonzero(np.diff(values, prepend=previous) != 0):
        changes.append((first_row + int(i), float(values[i])))


def _timebase(source: Source, writer: ColumnWriter, intake: _Intake, timed: bool, rate_hz: float | None) -> Timebase:
    """Rate, pauses, jitter; even times are written over rounded ones."""
    n = writer.n_samples
    if timed:
        base = timebase_of(lambda a, b: writer.read("timestamp", a, b) * 1e-9, n, intake.rounding_s)
        if intake.repeated and not base.uniform:
            raise InputError(f"{source.path}: {intake.repeated} comes twice; wanted times that rise.")
        if rate_hz is not None and abs(base.rate_hz / rate_hz - 1.0) > 0.01:
            raise InputError(
                f"{source.path}: the time column says {base.rate_hz:.6g} samples/s, not {rate_hz:.6g}; is the unit of "
                "time right (--map time=COLUMN:ms)?"
            )
    else:
        base = Timebase(float(rate_hz or 0.0), True, 0.0, np.zeros((0, 3), np.int64))
    if base.uniform:
        writer.replace_timestamps(lambda a, b: timestamps_ns(a, b, base.rate_hz, base.gaps[:, :2]))
    return base


def _volts(writer: ColumnWriter, scales: Mapping[str, tuple[float, float]], role: str) -> Read:
    """Gives volts of samples ``a .. b`` of a channel."""
    factor, offset = scales[role]
    return lambda a, b: np.asarray(writer.read(role, a, b) * factor + offset, np.float64)


def _find(
    writer: ColumnWriter, scales: Mapping[str, tuple[float, float]], setup: Setup, base: Timebase, intake: _Intake,
    progress: Progress | None,
) -> tuple[NDArray[np.void], bool]:
    """Step table, and whether it comes from the drive: a drive that is absent or flat leaves the accelerometer."""

    def volts(role: str) -> Read:
        return _volts(writer, scales, role)

    found: list[FoundStep] = []
    for role in ("drive", "accelerometer"):
        if role in scales and not found:
            from_drive = role == "drive"
            found = _found(volts(role), writer.n_samples, setup, base, intake, progress)
            if not from_drive and not intake.set_values:
                shortest = SHORTEST_FELT_CYCLES * base.rate_hz
                found = [s for s in found if (s.stop - s.hold) * s.frequency_hz >= shortest]
    achieved = np.array([_achieved(volts("accelerometer"), s, base.rate_hz, setup) for s in found]).reshape(-1, 2)
    g_per_volt = setup.drive.g_per_volt
    if from_drive and g_per_volt is not None:
        gammas = np.array([gamma_of(s.tones.amplitudes, setup.forcing) for s in found]) * g_per_volt.value
    else:
        gammas = achieved[:, 0]
    return step_table(found, setup.forcing, base.rate_hz, gammas, achieved), from_drive


def _found(
    read: Callable[[int, int], Floats], n_samples: int, setup: Setup, base: Timebase, intake: _Intake,
    progress: Progress | None,
) -> list[FoundStep]:
    """Steps of one channel: cut where the file says that something was set, else where the channel changes."""
    set_hz = dict(intake.set_values.get("frequency", []))
    changes = {row for values in intake.set_values.values() for row, _ in values}
    cuts = sorted({0, n_samples, *changes, *(int(g) for g in base.gaps[:, 0])})
    found: list[FoundStep] = []
    near_hz = setup.forcing.frequency_hz
    for a, b in pairwise(cuts):
        near_hz = set_hz.get(a, near_hz)
        if intake.set_values:
            found += given_step(read, a, b, base.rate_hz, setup.forcing, near_hz)
        else:
            found += find_steps(read, a, b, base.rate_hz, setup.forcing)
        if progress is not None:
            progress("finding steps", b)
    return found


def _achieved(read: Callable[[int, int], Floats], step: FoundStep, rate_hz: float, setup: Setup) -> tuple[float, float]:
    """Gamma at the plate over a step's hold, from the accelerometer's tones, and its uncertainty."""
    settled = step.settled(rate_hz)
    tones = fit(read, settled, step.stop, rate_hz, step.frequency_hz, setup.forcing)
    sensor = setup.channels.accelerometer
    volts_per_g = sensor.volts_per_mps2 * setup.g_mps2.value
    gamma = gamma_of(tones.amplitudes / volts_per_g, setup.forcing)
    noise = gamma_of(tones.amplitude_sigma() / volts_per_g + 0j, setup.forcing)
    return gamma, float(np.hypot(noise, gamma * sensor.sensitivity.uncertainty / sensor.sensitivity.value))


def _blocks(base: Timebase, n_samples: int) -> NDArray[np.void]:
    """One block for each unbroken run."""
    starts = [0, *(int(g) for g in base.gaps[:, 0])]
    rows = np.zeros(len(starts), BLOCK_DTYPE)
    rows["first_sample"] = starts
    rows["n_samples"] = np.diff([*starts, n_samples])
    rows["lost_before"][1:] = base.gaps[:, 1]
    rows["lost_uncertainty"][1:] = base.gaps[:, 2]
    return rows


def _late_attributes(
    source: Source, columns: Mapping[str, Column], setup: Setup, base: Timebase, intake: _Intake,
    extra: Mapping[str, Any] | None,
) -> dict[str, Any]:
    started = ""
    if intake.origin_s > EPOCH_S:
        when = datetime.datetime.fromtimestamp(intake.origin_s, datetime.UTC)
        started = when.isoformat(timespec="microseconds").removesuffix("+00:00") + "Z"
    return {
        "setup_json": setup.model_dump_json(),
        "rate_hz": base.rate_hz,
        "uniform": base.uniform,
        "jitter_s": base.jitter_s,
        "started": started,
        "imported_at": now_utc(),
        "imported_from": source.path.name,
        "imported_sha256": _sha256(source.path),
        "imported_columns": [f"{role}={column.name}" + (f":{column.unit}" if column.unit else "")
                             for role, column in columns.items()],
        "time_origin_s": intake.origin_s,
        "extra_json": json.dumps(dict(extra or {})),
    }


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
