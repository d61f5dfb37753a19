"""Import of a foreign file: rows streamed in, time base and steps found, everything checked, then renamed.

The recording appears under its name only when everything in it was read, found consistent, written and read back;
values are stored as they came, never requantised.
"""

from __future__ import annotations

import datetime
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.channels.registry import KINDS
from daq.files.column_file import ColumnWriter
from daq.files.tables import BLOCK_DTYPE
from daq.importers.formats.columns import ACCELERATION_UNITS, SET_ROLES, VOLT_UNITS, Column, Source, assign, reasons
from daq.importers.intake import Intake, Progress, Scratch, take_in
from daq.importers.plausibility import (
    achieved_gamma,
    lost_rows,
    range_warnings,
    rate_warnings,
    refuse_mixed_rates,
    refuse_other_unit,
    remarks,
)
from daq.importers.timebase import Timebase, of_packets, timebase_of
from daq.instrument.instrument import STORED, Instrument, examine
from daq.recording.reader import timestamps_ns
from daq.recording.writer import root_attributes
from daq.setup.clock import now_utc
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from daq.steps.find_steps import FoundStep, find_steps, given_step, step_table
from daq.steps.forcing_detection import Read, Signal, gamma_of
from kernels.arrays import Floats

LEAST_HZ, MOST_HZ = 0.01, 1e8  # range of sample rates: times are stored in nanoseconds, in 64 bits
RANGE_OF_UNIT = {"g": 1e3, "m/s^2": 1e4, "m/s2": 1e4, "mps2": 1e4}  # range of an acceleration already in its unit
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
    """Choices of the caller for an import."""

    mapping: Mapping[str, Column] = field(default_factory=dict)  # columns by role where their names do not say it
    rate_hz: float | None = None  # sample rate where there is no time column
    note: str | None = None  # stored in the recording
    extra: Mapping[str, Any] = field(default_factory=dict)  # stored as well


def _columns_and_rate(source: Source, options: ImportOptions, setup: Setup) -> tuple[dict[str, Column], float | None]:
    """Column of each role, and samples a second where they are stated."""
    if options.rate_hz is not None and not LEAST_HZ <= options.rate_hz <= MOST_HZ:
        raise InputError(f"--rate {options.rate_hz:g}: wanted samples a second, from {LEAST_HZ:g} to {MOST_HZ:g}.")
    columns = assign(source, options.mapping, setup.channels.recorded())
    rate_hz = options.rate_hz or source.rate_hz
    if "time" not in columns and rate_hz is None:
        raise InputError(
            f"{source.path}: no time column among {', '.join(source.names)}; name it with --map time=COLUMN or give "
            "the sample rate with --rate HZ."
        )
    return columns, rate_hz


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

    Raises `InputError`, naming file and row of what cannot be used; nothing is left behind.

    Parameters
    ----------
    source, out
        The open foreign file, and the recording to create.
    setup, profile_text
        Setup of the measurement, and the profile's text.
    options
        The caller's choices; None: all defaults.
    progress
        Called with the stage and the number of rows done.
    """
    options = options or ImportOptions()
    columns, rate_hz = _columns_and_rate(source, options, setup)
    channels = [role for role in KINDS if role in columns]
    setup = _adapted(setup, columns)
    attributes = root_attributes(setup, profile_text=profile_text, backend="import", simulated=False, note=options.note)
    attributes |= {"channels": channels, "started": "", "ended": "complete", "why": "", "ended_at": ""}
    dtypes = {role: source.dtype(columns[role].name) for role in channels}  # values are stored as they came
    scales = {role: _scale(source, columns[role], role, setup) for role in channels}
    intake = Intake(source, columns, scales, setup, set_values={r: [] for r in SET_ROLES if r in columns})
    writer = ColumnWriter(out, setup, dtypes, scales, attributes)
    try:
        with Scratch(out.parent, ({"timestamp": np.dtype("<i8")} if "time" in columns else {}) | dtypes) as scratch:
            take_in(intake, writer, scratch, progress)
            volts = {role: partial(_volts, scratch, role, scales[role]) for role in channels}
            base = _timebase(intake, scratch, rate_hz)
            even = partial(timestamps_ns, rate_hz=base.rate_hz, gaps=base.gaps[:, :2])
            writer.write_timestamps(even if base.uniform else partial(scratch.read, "timestamp"))
            found, channel = _find(volts, base, intake, progress)
            if "time" not in columns and len(lost := lost_rows(volts[channel], found, base.rate_hz)):
                base = replace(base, gaps=lost)  # without a time column missing rows become gaps: the steps end there
                found, channel = _find(volts, base, intake, progress)
            steps = _table(found, volts, channel, setup, base.rate_hz)
            warnings = [*rate_warnings(base.rate_hz, setup, steps), *range_warnings(intake.peak_v, setup)]
            sampling = setup.sampling.model_copy(update={"rate_hz": base.rate_hz})
            setup = setup.model_copy(update={"sampling": sampling})
            instrument = examine(volts, writer.n_samples, base.rate_hz, steps, base.gaps, setup)
            late = _late_attributes(intake, setup, base) | {STORED: json.dumps(instrument.as_json())}
            late["extra_json"] = json.dumps(dict(options.extra))
            writer.check(steps, _blocks(base, writer.n_samples), **late)
    except BaseException:
        writer.abandon()
        raise
    writer.rename()
    lines = [f"not imported: {reasons(source)}"] if source.left_out else []
    lines += [*remarks(base, steps, channels, from_drive=channel == "drive", timed="time" in columns), *warnings]
    return ImportSummary(out, writer.n_samples, base, steps, {r: c.name for r, c in columns.items()}, lines, instrument)


def _scale(source: Source, column: Column, role: str, setup: Setup) -> tuple[float, float]:
    """Volts of one unit of what is stored, and the offset."""
    described = setup.channels.get(role)
    range_v = described.range_v if described is not None else 10.0
    if column.unit == "fs":  # whole numbers of a WAV are codes of it
        full, unit_v = 1.0, range_v
    else:
        full, unit_v = range_v, VOLT_UNITS.get(column.unit, 1.0)
    factor, offset = source.scale(column.name, full)
    return factor * unit_v, offset * unit_v


def _adapted(setup: Setup, columns: Mapping[str, Column]) -> Setup:
    """The set-up as the file has it: without a contact that is absent; 1 V a unit for a calibrated acceleration."""
    changed: dict[str, Any] = {}
    if "continuity" not in columns:
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


def _volts(scratch: Scratch, role: str, scale: tuple[float, float], a: int, b: int) -> Floats:
    """Volts of samples ``a .. b`` of a channel."""
    values, (factor, offset) = scratch.read(role, a, b), scale
    if scale == (1.0, 0.0):  # text holds the volts themselves
        return values.astype(np.float64, copy=False)
    return np.asarray(values * factor + offset, np.float64)


def _timebase(intake: Intake, scratch: Scratch, rate_hz: float | None) -> Timebase:
    """Rate, pauses and jitter of the times; the given rate where there are none."""
    path, time = intake.source.path, intake.columns.get("time")
    if time is None:
        return Timebase(float(rate_hz or 0.0), True, 0.0, np.zeros((0, 3), np.int64))

    def times(start: int, stop: int) -> Floats:
        return np.asarray(scratch.read("timestamp", start, stop) * 1e-9, np.float64)

    refuse_mixed_rates(path, times, intake.n_rows, intake.rounding_s)
    base = timebase_of(times, intake.n_rows, intake.rounding_s)
    if intake.repeated and not base.uniform:
        packets = of_packets(times, intake.n_rows, intake.rounding_s, intake.setup.sampling.rate_hz)
        if packets is None:
            raise InputError(
                f"{path}: {intake.repeated} comes twice; wanted times that rise, or one time a packet of so many "
                "rows; else take out the row that is there twice, or that column and give --rate HZ."
            )
        base = packets
    if rate_hz is not None and abs(base.rate_hz / rate_hz - 1.0) > 0.01:
        raise InputError(
            f"{path}: the time column says {base.rate_hz:.6g} samples/s, not {rate_hz:.6g}; is the unit of "
            "time right (--map time=COLUMN:ms)?"
        )
    refuse_other_unit(path, time, base.rate_hz, intake.setup)
    return base


def _find(
    volts: Mapping[str, Read], base: Timebase, intake: Intake, progress: Progress | None
) -> tuple[list[FoundStep], str]:
    """Steps, and the channel that shows them: a drive that is absent or flat leaves the accelerometer."""
    if "drive" in volts and (found := _found(volts["drive"], base, intake, progress)):
        return found, "drive"
    found = _found(volts["accelerometer"], base, intake, progress)
    if intake.set_values:
        return found, "accelerometer"
    shortest, rate_hz = SHORTEST_PLATE_STEP_CYCLES * base.rate_hz, base.rate_hz
    found = [s for s in found if (s.stop - s.hold) * s.frequency_hz >= shortest]
    # the last cycles go to the next step's fade, whose slow beginning drowns in the noise
    cut = [replace(s, stop=max(s.stop - round(2.0 * rate_hz / s.frequency_hz), s.hold)) for s in found]
    for i in range(1, len(cut)):
        if found[i].start == found[i - 1].stop:
            cut[i] = replace(cut[i], start=cut[i - 1].stop)
    return cut, "accelerometer"


def _table(
    found: list[FoundStep], volts: Mapping[str, Read], channel: str, setup: Setup, rate_hz: float
) -> NDArray[np.void]:
    """Step table; gamma is the drive's where its steps and its scale are known, else the plate's."""
    achieved = np.array([achieved_gamma(volts, s, rate_hz, setup) for s in found]).reshape(-1, 2)
    g_per_volt = setup.drive.g_per_volt
    if channel == "drive" and g_per_volt is not None:
        gammas = np.array([gamma_of(s.tones.amplitudes, setup.forcing) for s in found]) * g_per_volt.value
    else:
        gammas = achieved[:, 0]
    return step_table(found, setup.forcing, rate_hz, gammas, achieved)


def _found(read: Read, base: Timebase, intake: Intake, progress: Progress | None) -> list[FoundStep]:
    """Steps of one channel: cut where the file says that something was set, else where the channel changes."""
    set_hz = dict(intake.set_values.get("frequency", []))
    changes = {row for values in intake.set_values.values() for row, _ in values}
    cuts = sorted({0, intake.n_rows, *changes, *(int(g) for g in base.gaps[:, 0])})
    found: list[FoundStep] = []
    signal = Signal(read, base.rate_hz, intake.setup.forcing)
    near_hz = signal.forcing.frequency_hz
    for a, b in pairwise(cuts):
        near_hz = set_hz.get(a, near_hz)
        if near_hz > 0.5 * signal.rate_hz and set_hz:
            raise InputError(
                f"set frequency {near_hz:.6g} from sample {a} on: wanted less than half the sample rate, "
                f"{0.5 * signal.rate_hz:.6g} Hz; is --map frequency=COLUMN the right column, in Hz?"
            )
        found += given_step(signal, a, b, near_hz) if intake.set_values else find_steps(signal, a, b)
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


def _late_attributes(intake: Intake, setup: Setup, base: Timebase) -> dict[str, Any]:
    """Root attributes that are known once all rows were read."""
    started, path = "", intake.source.path
    # a first time from 2001 to the year 9999 counts as seconds since 1970
    if 1e9 < intake.origin_s < 2.5e11:
        when = datetime.datetime.fromtimestamp(intake.origin_s, datetime.UTC)
        started = when.isoformat(timespec="microseconds").removesuffix("+00:00") + "Z"
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "setup_json": setup.model_dump_json(),
        "rate_hz": base.rate_hz,
        "uniform": base.uniform,
        "jitter_s": base.jitter_s,
        "started": started,
        "imported_at": now_utc(),
        "imported_from": path.name,
        "imported_sha256": sha256,
        "imported_columns": [
            f"{role}={column.name}" + (f":{column.unit}" if column.unit else "")
            for role, column in intake.columns.items()
        ],
        "time_origin_s": intake.origin_s,
    }
