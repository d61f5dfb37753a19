"""`bench export`: a recording for readers that know nothing of it."""

from __future__ import annotations

import enum
from pathlib import Path

import typer

from bench import outputs
from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_USAGE, fail, write_json

FORMS = {
    "csv": outputs.PACKED_CSV, "npz": outputs.NPZ, "h5": outputs.HDF5, "parquet": outputs.PARQUET, "nc": outputs.NETCDF,
    "mat": outputs.MATLAB, "uff": outputs.UFF, "tdms": outputs.TDMS,
}  # fmt: skip
Kind = enum.StrEnum("Kind", ["csv", "npz", "h5", "parquet", "nc", "mat", "uff", "tdms"])
OTHER_ENDINGS = {"hdf5": "h5", "pq": "parquet", "unv": "uff"}


def command(
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
    from daq.export.export import export
    from daq.export.resample import Resampled
    from daq.files.disk import write_whole
    from daq.recording import open_recording
    from daq.recording.header import header_of
    from daq.recording.notebook import as_text, read_remarks, side_file

    kind = to.value if to is not None else out.name.removesuffix(".gz").rpartition(".")[2].lower()
    kind = OTHER_ENDINGS.get(kind, kind)
    if kind not in FORMS:
        fail(f"{out}: the ending does not say what to write; wanted --to {', '.join(FORMS)}.", EXIT_USAGE)
    notes = out.with_name(f"{out.name}.notes.txt")
    check_outputs(
        File("--out", out, FORMS[kind]), File("--json", json, JSON), File("--out", notes, outputs.NOTES),
        inputs=[recording], overwrite=overwrite,
    )  # fmt: skip
    with open_recording(recording) as opened:
        source = opened if rate is None else Resampled(opened, rate)
        export(source, out, kind, overwrite=overwrite)  # type: ignore[arg-type]
        noted = as_text(header_of(opened, all_bytes=True), read_remarks(side_file(recording)))
        if noted:
            write_whole(notes, noted)
        summary = {"file": out, "kind": kind, "n_samples": source.n_samples, "bytes": out.stat().st_size}
    if write_json(summary, json):
        typer.echo(f"{out}: {summary['n_samples']} samples, {summary['bytes']} bytes")
