"""`bench import` and `bench export`: somebody's file into a recording, and a recording for other readers."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.table import Table

from bench import outputs
from bench.outputs import HDF5, JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import ACHIEVED, next_command, print_lines, print_table, progress_bar, readable, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from daq.importers.import_recording import ImportSummary

FORMS = {
    "csv": outputs.PACKED_CSV, "npz": outputs.NPZ, "h5": outputs.HDF5, "parquet": outputs.PARQUET, "nc": outputs.NETCDF,
    "mat": outputs.MATLAB, "uff": outputs.UFF, "tdms": outputs.TDMS,
}  # fmt: skip
Kind = enum.StrEnum("Kind", ["csv", "npz", "h5", "parquet", "nc", "mat", "uff", "tdms"])
OTHER_ENDINGS = {"hdf5": "h5", "pq": "parquet", "unv": "uff"}


def import_(
    raw: Path = typer.Argument(..., metavar="RAW", help="CSV (also .gz), HDF5, NPZ, WAV, MAT, UFF58, TDMS, MDF4."),
    profile: str = typer.Option(
        ..., "--profile", "-p", metavar="P.toml", help="What was measured with what; or the name of a shipped profile."
    ),
    out: Path = typer.Option(..., "--out", "-o", metavar="REC.h5", help="Recording to create; never overwritten."),
    mapping: list[str] = typer.Option(
        [],
        "--map",
        metavar="ROLE=COLUMN[:UNIT]",
        help="Column of time, continuity, accelerometer, drive; or of the set frequency or set level, whose every "
        "change starts a step. "
        "Units: s ms us ns; V mV; fs (fraction of the channel's range); g m/s^2 (acceleration).",
    ),
    rate: float = typer.Option(None, "--rate", metavar="HZ", help="Sample rate where there is no time column."),
    channel: list[str] = typer.Option(
        [],
        "--channel",
        metavar="[ROLE=]VALUE",
        help="Long table: use the rows of this sensor; with a role, make the rows of each value a column.",
    ),
    channel_column: str = typer.Option(None, "--channel-column", help="Its selecting column (default: channel)."),
    note: str = typer.Option(None, "--note", help="Stored in the recording."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Turn somebody's file into a recording. Values are stored as they are; steps are found from the drive.

    Columns named time_s, continuity_v, accelerometer_v, drive_v (and the like) are recognised. Without a continuity
    column only the plate is analysed. Universal files (UFF58), TDMS and MDF4 need the extra interchange.

    Example: bench import run.csv --profile rig.toml --out run.h5 --map drive="CH 3:mV"

    Example: bench import os.csv -p shaker.toml -o os.h5 --channel 0 --map accelerometer=Z:g --map frequency=Freq
    """
    from bench.profiles.find import load_measuring
    from daq.files.tables import STEP_DTYPE
    from daq.importers.formats.columns import parse_map
    from daq.importers.formats.open import open_source
    from daq.importers.import_recording import ImportOptions, import_recording

    files = File("--out", out, HDF5, lasting=True), File("--json", json, JSON)
    check_outputs(*files, inputs=[raw, profile], overwrite=overwrite)
    setup, text = load_measuring(profile)
    source = open_source(raw, _selected(channel), channel_column)
    options = ImportOptions(parse_map(mapping), rate, readable(note))
    with progress_bar(json == "-") as bar:
        summary = import_recording(source, out, setup, text, options, progress=lambda what, n: bar(f"{what} {n:,}", 0))
    base = summary.timebase
    answer = {
        "recording": summary.path, "n_samples": summary.n_samples, "rate_hz": base.rate_hz,
        "duration_s": summary.n_samples / base.rate_hz, "uniform": base.uniform, "jitter_s": base.jitter_s,
        "gaps": base.gaps, "columns": summary.columns,
        "steps": [{name: row[name] for name in STEP_DTYPE.names or ()} for row in summary.steps],
        "remarks": summary.remarks, "instrument": summary.instrument.as_json(),
    }  # fmt: skip
    if write_json(answer, json):
        _print(summary)
        print_lines(next_command(out))


def _selected(channel: list[str]) -> dict[str, str]:
    """``--channel`` as ``{"": value}`` or ``{role: value}``; raises `InputError`."""
    from daq.channels.registry import KINDS

    if len(channel) == 1 and channel[0].partition("=")[0] not in KINDS:
        return {"": channel[0]}
    selected = {role: value for role, _, value in (item.partition("=") for item in channel)}
    if len(selected) != len(channel) or not set(selected) <= set(KINDS):
        raise InputError(
            f"--channel {' '.join(channel)}: wanted one value, or role=value for each of {', '.join(KINDS)}."
        )
    return selected


def _print(summary: ImportSummary) -> None:
    """The summary as a person reads it."""
    from daq.importers.formats.columns import listed

    rate_hz, steps = summary.timebase.rate_hz, summary.steps
    print_lines(
        f"{summary.path}: {summary.n_samples} samples at {rate_hz:.9g} samples/s "
        f"({summary.n_samples / rate_hz:.3f} s), {len(steps)} steps",
        ", ".join(f"{role} from {listed([name])}" for role, name in summary.columns.items()),
        *summary.instrument.in_words(),
        *(f"note: {remark}" for remark in summary.remarks),
        *(f"doubt: {doubt.sentence}" for doubt in summary.instrument.doubts),
    )
    if not len(steps):
        return

    def known(value: Any) -> str:
        return "-" if value != value else f"{value:.4g}"

    table = Table("step", "from s", "hold s", "frequency Hz", "gamma", "at the plate")
    for i, step in enumerate(steps):
        table.add_row(
            str(i), f"{step['first_sample'] / rate_hz:.3f}",
            f"{(int(step['n_samples']) - int(step['settle_samples'])) / rate_hz:.3f}",
            f"{step['frequency_hz']:.5f}", known(step["gamma"]), known(step["achieved_gamma"]),
        )  # fmt: skip
    print_table(table)
    print_lines(ACHIEVED)


def export(
    recording: Path = typer.Argument(..., metavar="REC.h5", help="Recording to read."),
    out: Path = typer.Option(..., "--out", "-o", metavar="FILE", help="File to create."),
    to: Kind = typer.Option(None, "--to", help="Kind of file; by default what the ending of FILE says."),
    rate: float = typer.Option(None, "--rate", metavar="HZ", help="Another rate, as 20000; not for h5, uff, tdms."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a recording as CSV (also .csv.gz), NPZ, Parquet, NetCDF, MATLAB 7.3, UFF58, TDMS, or HDF5 with gzip.

    CSV, NPZ, Parquet and MATLAB hold time_s and each channel in volts, HDF5, NetCDF and TDMS the codes with their
    scale; each can be imported again but Parquet. Parquet, NetCDF and TDMS need the extra interchange. h5 is for
    readers without the LZ4 plugin. A sound card's recording keeps the card's own rate; --rate 20000 writes a view at
    20 kHz (needs the package soxr).

    The notebook, where anything was noted, goes to FILE.notes.txt.

    Example: bench export run.h5 --to csv --out run.csv
    """
    from daq.export.export import export as written
    from daq.export.resample import Resampled
    from daq.files.disk import write_whole
    from daq.recording import open_recording
    from daq.recording.header import header_of
    from daq.recording.notebook import as_text, read_remarks, side_file

    kind = to.value if to is not None else out.name.removesuffix(".gz").rpartition(".")[2].lower()
    kind = OTHER_ENDINGS.get(kind, kind)
    if kind not in FORMS:
        raise InputError(f"{out}: the ending does not say what to write; wanted --to {', '.join(FORMS)}.")
    notes = out.with_name(f"{out.name}.notes.txt")
    check_outputs(
        File("--out", out, FORMS[kind]), File("--json", json, JSON), File("--out", notes, outputs.NOTES),
        inputs=[recording], overwrite=overwrite,
    )  # fmt: skip
    with open_recording(recording) as opened:
        source = opened if rate is None else Resampled(opened, rate)
        written(source, out, kind, overwrite=overwrite)  # type: ignore[arg-type]
        noted = as_text(header_of(opened, all_bytes=True), read_remarks(side_file(recording)))
        if noted:
            write_whole(notes, noted)
        summary = {"file": out, "kind": kind, "n_samples": source.n_samples, "bytes": out.stat().st_size}
    if write_json(summary, json):
        typer.echo(f"{out}: {summary['n_samples']} samples, {summary['bytes']} bytes")
