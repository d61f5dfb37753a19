"""Import of a foreign file: rows streamed in, time base and steps found, everything checked, then renamed.

The recording appears under its name only when everything in it was read, found
consistent, written and read back; values are stored as they came, never requantised.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import ColumnWriter
from daq.files.tables import BLOCK_DTYPE
from daq.importers.achieved import achieved_gamma
from daq.importers.background import Digest
from daq.importers.diagnostics import range_warnings, rate_warnings, remarks
from daq.importers.formats.columns import (
    ACCELERATION_UNITS,
    CHANNEL_ROLES,
    VOLT_UNITS,
    Column,
    Source,
    assign,
    left_out_remarks,
)
from daq.importers.implausible_rates import refuse_mixed_rates, refuse_other_unit
from daq.importers.intake import Intake, Progress, take_in
from daq.importers.lost_rows import lost_rows
from daq.importers.scratch import Scratch
from daq.importers.timebase import Timebase, timebase_of
from daq.instrument.instrument import STORED, Instrument
from daq.instrument.stored import examine
from daq.recording.reader import timestamps_ns
from daq.recording.writer import now_utc, root_attributes
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from daq.steps.find_steps import FoundStep, find_steps, gamma_of, given_step, step_table
from daq.steps.forcing_detection import Read

Floats = NDArray[np.float64]

LEAST_HZ, MOST_HZ = 0.01, 1e8  # range of sample rates: times are kept in nanoseconds, in 64 bits
YEAR_9999_S = 2.5e11
EPOCH_S = 1e9  # first time from which it counts as seconds since 1970
RANGE_OF_UNIT = {"g": 1e3, "m/s^2": 1e4, "m/s2": 1e4, "mps2": 1e4}  # range of an acceleration already in its unit
EARLY_CYCLES = 2.0  # by which steps found in the accelerometer end early
SHORTEST_PLATE_STEP_CYCLES = 6.0  # shortest step found in the accelerometer; shorter, it may be the middle of a fade


@dataclass(frozen=True)
class ImportSummary:
    """Outcome of an import: size, time base, steps, column of each role, remarks, instrument and its doubts."""

    path: Path
    n_samples: int
    timebase: Timebase
    steps: NDArray[np.void]
    columns: dict[str, str]
    remarks: list[str]
    instrument: Instrument


@dataclass(frozen=True)
class ImportOptions:
    """Choices of the caller for an import.

    Attributes
    ----------
    mapping
        Columns by role where their names do not tell.
    rate_hz
        Sample rate where there is no time column.
    note, extra
        Kept in the recording.
    """

    mapping: Mapping[str, Column] = field(default_factory=dict)
    rate_hz: float | None = None
    note: str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)


def import_recording(
    source: Source,
    out: Path,
    setup: Setup,
    profile_text: str,
    options: ImportOptions | None = None,
    *,
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
        Setup of the measurement, and the profile's text.
    options
        The caller's choices; None: all defaults.
    progress
        Called with the stage and the number of rows done.

    Raises
    ------
    InputError
        Naming file and row of what cannot be used; nothing is left behind.
    """
    options = options or ImportOptions()
    columns, rate_hz = _assigned(source, options)
    channels = [role for role in CHANNEL_ROLES if role in columns]
    setup = _adapted(setup, columns, channels)
    attributes = root_attributes(setup, profile_text=profile_text, backend="import", simulated=False, note=options.note)
    scales = {role: _scale(source, columns[role], role, setup) for role in channels}
    writer = _begun(source, columns, out, setup, scales, attributes)
    try:
        with _scratch(source, columns, out) as scratch:
            intake = take_in(source, columns, scales, setup, writer, scratch, progress)
            with Digest(source.path, source.sha256) as digest:
                volts = _Volts(scratch, scales)
                base = _timebase(source, writer, scratch, intake, columns.get("time"), setup, rate_hz)
                found, channel = _find(volts, writer.n_samples, setup, base, intake, progress)
                if "time" not in columns and len(lost := lost_rows(volts.of(channel), found, base.rate_hz)):
                    base = replace(base, gaps=lost)
                    found, channel = _find(volts, writer.n_samples, setup, base, intake, progress)
                steps = _table(found, volts, channel, setup, base.rate_hz)
                warnings = [*rate_warnings(base.rate_hz, setup, steps), *range_warnings(intake.peak_v, setup)]
                setup = _at_rate(setup, base.rate_hz)
                read = {role: volts.of(role) for role in channels}
                instrument = examine(read, writer.n_samples, base.rate_hz, steps, base.gaps, setup)
                late = _late_attributes(source, columns, setup, base, intake, options.extra)
                late[STORED] = json.dumps(instrument.as_json())
                writer.check(steps, _blocks(base, writer.n_samples), **late, imported_sha256=digest.result())
    except BaseException:
        writer.abandon()
        raise
    writer.rename()
    named = {role: column.name for role, column in columns.items()}
    said = remarks(base, steps, channels, from_drive=channel == "drive", timed="time" in columns)
    return ImportSummary(
        out, writer.n_samples, base, steps, named, [*left_out_remarks(source), *said, *warnings], instrument
    )


def _assigned(source: Source, options: ImportOptions) -> tuple[dict[str, Column], float | None]:
    """Columns by role, and the sample rate where it is given; raises `InputError` where neither tells the times."""
    if options.rate_hz is not None and not LEAST_HZ <= options.rate_hz <= MOST_HZ:
        raise InputError(f"--rate {options.rate_hz:g}: wanted samples a second, from {LEAST_HZ:g} to {MOST_HZ:g}.")
    columns = assign(source, options.mapping)
    rate_hz = options.rate_hz or source.rate_hz
    if "time" not in columns and rate_hz is None:
        raise InputError(
            f"{source.path}: no time column among {', '.join(source.names)}; name it with --map time=COLUMN or give "
            "the sample rate with --rate HZ."
        )
    return columns, rate_hz


def _begun(
    source: Source,
    columns: Mapping[str, Column],
    out: Path,
    setup: Setup,
    scales: Mapping[str, tuple[float, float]],
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
            update={"sensitivity": sensitivity, "unit": ACCELERATION_UNITS[unit], "range_v": RANGE_OF_UNIT[unit]}
        )
    return setup.model_copy(update={"channels": setup.channels.model_copy(update=changed)})


def _scratch(source: Source, columns: Mapping[str, Column], out: Path) -> Scratch:
    """For the times in nanoseconds, and the channels as they come."""
    channels = {role: source.dtype(columns[role].name) for role in CHANNEL_ROLES if role in columns}
    return Scratch(out.parent, ({"timestamp": np.dtype("<i8")} if "time" in columns else {}) | channels)


def _at_rate(setup: Setup, rate_hz: float) -> Setup:
    """The set-up with the rate that was found."""
    return setup.model_copy(update={"sampling": setup.sampling.model_copy(update={"rate_hz": rate_hz})})


def _timebase(
    source: Source,
    writer: ColumnWriter,
    scratch: Scratch,
    intake: Intake,
    time: Column | None,
    setup: Setup,
    rate_hz: float | None,
) -> Timebase:
    """Rate, pauses, jitter; the times are written: even ones where they are even, else as they came."""
    if time is None:
        base = Timebase(float(rate_hz or 0.0), True, 0.0, np.zeros((0, 3), np.int64))
    else:

        def times(start: int, stop: int) -> Floats:
            return np.asarray(scratch.read("timestamp", start, stop) * 1e-9, np.float64)

        refuse_mixed_rates(source.path, times, writer.n_samples, intake.rounding_s)
        base = timebase_of(times, writer.n_samples, intake.rounding_s)
        if intake.repeated and not base.uniform:
            raise InputError(f"{source.path}: {intake.repeated} comes twice; wanted times that rise.")
        if rate_hz is not None and abs(base.rate_hz / rate_hz - 1.0) > 0.01:
            raise InputError(
                f"{source.path}: the time column says {base.rate_hz:.6g} samples/s, not {rate_hz:.6g}; is the unit of "
                "time right (--map time=COLUMN:ms)?"
            )
        refuse_other_unit(source.path, time, base.rate_hz, setup)
    even = base.uniform

    def stamps(start: int, stop: int) -> NDArray[np.int64]:
        if even:
            return timestamps_ns(start, stop, base.rate_hz, base.gaps[:, :2])
        return scratch.read("timestamp", start, stop)

    writer.write_timestamps(stamps)
    return base


@dataclass(frozen=True)
class _Volts:
    """Volts of the channels taken in."""

    scratch: Scratch
    scales: Mapping[str, tuple[float, float]]

    def of(self, role: str) -> Read:
        """Gives volts of samples ``a .. b`` of a channel."""
        factor, offset = self.scales[role]

        def volts(a: int, b: int) -> Floats:
            values = self.scratch.read(role, a, b)
            if (factor, offset) == (1.0, 0.0):  # text holds the volts themselves
                return values.astype(np.float64, copy=False)
            return np.asarray(values * factor + offset, np.float64)

        return volts


def _find(
    volts: _Volts,
    n_samples: int,
    setup: Setup,
    base: Timebase,
    intake: Intake,
    progress: Progress | None,
) -> tuple[list[FoundStep], str]:
    """Steps, and the channel that shows them: a drive that is absent or flat leaves the accelerometer."""
    if "drive" in volts.scales and (found := _found(volts.of("drive"), n_samples, setup, base, intake, progress)):
        return found, "drive"
    found = _found(volts.of("accelerometer"), n_samples, setup, base, intake, progress)
    if not intake.set_values:
        shortest = SHORTEST_PLATE_STEP_CYCLES * base.rate_hz
        found = _ended_early([s for s in found if (s.stop - s.hold) * s.frequency_hz >= shortest], base.rate_hz)
    return found, "accelerometer"


def _ended_early(found: list[FoundStep], rate_hz: float) -> list[FoundStep]:
    """Steps without their last cycles, which go to the next one's fade: its slow beginning drowns in the noise."""
    cut = [replace(s, stop=max(s.stop - round(EARLY_CYCLES * rate_hz / s.frequency_hz), s.hold)) for s in found]
    starts = [
        last.stop if step.start == before.stop else step.start
        for before, last, step in zip(found, cut, cut[1:], strict=False)
    ]
    return cut[:1] + [replace(step, start=start) for step, start in zip(cut[1:], starts, strict=True)]


def _table(found: list[FoundStep], volts: _Volts, channel: str, setup: Setup, rate_hz: float) -> NDArray[np.void]:
    """Step table; gamma is the drive's where its steps and its scale are known, else the plate's."""
    read = {role: volts.of(role) for role in volts.scales}
    achieved = np.array([achieved_gamma(read, s, rate_hz, setup) for s in found]).reshape(-1, 2)
    g_per_volt = setup.drive.g_per_volt
    if channel == "drive" and g_per_volt is not None:
        gammas = np.array([gamma_of(s.tones.amplitudes, setup.forcing) for s in found]) * g_per_volt.value
    else:
        gammas = achieved[:, 0]
    return step_table(found, setup.forcing, rate_hz, gammas, achieved)


def _found(
    read: Callable[[int, int], Floats],
    n_samples: int,
    setup: Setup,
    base: Timebase,
    intake: Intake,
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
        if near_hz > 0.5 * base.rate_hz and set_hz:
            raise InputError(
                f"set frequency {near_hz:.6g} from sample {a} on: wanted less than half the sample rate, "
                f"{0.5 * base.rate_hz:.6g} Hz; is --map frequency=COLUMN the right column, in Hz?"
            )
        if intake.set_values:
            found += given_step(read, a, b, base.rate_hz, setup.forcing, near_hz)
        else:
            found += find_steps(read, a, b, base.rate_hz, setup.forcing)
        if progress is not None:
            progress("finding steps", b)
    return found


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
    source: Source,
    columns: Mapping[str, Column],
    setup: Setup,
    base: Timebase,
    intake: Intake,
    extra: Mapping[str, Any],
) -> dict[str, Any]:
    started = ""
    if EPOCH_S < intake.origin_s < YEAR_9999_S:
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
        "imported_columns": [
            f"{role}={column.name}" + (f":{column.unit}" if column.unit else "") for role, column in columns.items()
        ],
        "time_origin_s": intake.origin_s,
        "extra_json": json.dumps(dict(extra)),
    }
