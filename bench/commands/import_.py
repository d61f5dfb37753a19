"""`bench import`: somebody's file into a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import HDF5, JSON, File, Overwrite, check_outputs
from bench.terminal.console import (
    ACHIEVED,
    EXIT_USAGE,
    fail,
    next_command,
    print_lines,
    print_table,
    readable,
    write_json,
)

if TYPE_CHECKING:
    from daq.instrument.instrument import Instrument


def command(
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
    note: str = typer.Option(None, "--note", help="Kept in the recording."),
    json_out: str = typer.Option(None, "--json", metavar="FILE", help="Write the summary as JSON; - is the screen."),
    overwrite: Overwrite = False,
) -> None:
    """Turn somebody's file into a recording. Values are stored as they are; steps are found from the drive.

    Columns named time_s, continuity_v, accelerometer_v, drive_v (and the like) are recognised. Without a continuity
    column only the plate is analysed. Universal files (UFF58), TDMS and MDF4 need the extra interchange.

    Example: bench import run.csv --profile rig.toml --out run.h5 --map drive="CH 3:mV"

    Example: bench import os.csv -p shaker.toml -o os.h5 --channel 0 --map accelerometer=Z:g --map frequency=Freq
    """
    from bench.profiles.find import load_measuring
    from daq.importers.formats.columns import parse_map
    from daq.importers.formats.open import open_source
    from daq.importers.import_recording import ImportOptions, import_recording
    from daq.setup.errors import InputError

    try:
        check_outputs(
            File("--out", out, HDF5, kept=True), File("--json", json_out, JSON), inputs=[raw, profile],
            overwrite=overwrite,
        )  # fmt: skip
        setup, text = load_measuring(profile)
        source = open_source(raw, _selection(channel), channel_column)
        options = ImportOptions(parse_map(mapping), rate, readable(note))
        with _progress(json_out == "-") as progress:
            summary = import_recording(source, out, setup, text, options, progress=progress)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{out}: {error.strerror or error}")
    payload = _payload(summary)
    if json_out != "-":
        _print(payload, summary.instrument)
        print_lines(next_command(out))
    write_json(payload, json_out)


def _selection(channel: list[str]) -> dict[str, str]:
    """``--channel`` as ``{"": value}`` or ``{role: value}``."""
    from daq.channels.registry import KINDS
    from daq.setup.errors import InputError

    if len(channel) == 1 and channel[0].partition("=")[0] not in KINDS:
        return {"": channel[0]}
    chosen = {role: value for role, _, value in (item.partition("=") for item in channel)}
    if len(chosen) != len(channel) or not set(chosen) <= set(KINDS):
        raise InputError(
            f"--channel {' '.join(channel)}: wanted one value, or role=value for each of {', '.join(KINDS)}."
        )
    return chosen


def _progress(quiet: bool) -> Any:
    """A context that gives a progress callback ``(what, rows)``."""
    import contextlib

    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)

    @contextlib.contextmanager
    def shown() -> Any:
        if quiet or not console.is_terminal:
            yield None
            return
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TextColumn("{task.completed:,} rows"))
        with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bar:
            task = bar.add_task("reading", total=None)
            yield lambda what, rows: bar.update(task, description=what, completed=rows)

    return shown()


def _payload(summary: Any) -> dict[str, Any]:
    """The summary as JSON knows it; unknown numbers are null."""
    steps = [
        {name: None if row[name] != row[name] else row[name].item() for name in summary.steps.dtype.names}
        for row in summary.steps
    ]
    base = summary.timebase
    return {
        "recording": str(summary.path),
        "n_samples": summary.n_samples,
        "rate_hz": base.rate_hz,
        "duration_s": summary.n_samples / base.rate_hz,
        "uniform": base.uniform,
        "jitter_s": base.jitter_s,
        "gaps": base.gaps.tolist(),
        "columns": summary.columns,
        "steps": steps,
        "remarks": summary.remarks,
        "instrument": summary.instrument.as_json(),
    }


def _print(payload: dict[str, Any], instrument: Instrument) -> None:
    """The summary as a person reads it."""
    from rich.console import Console
    from rich.table import Table

    from daq.importers.formats.columns import listed

    console = Console(highlight=False, markup=False, emoji=False)
    console.print(
        f"{payload['recording']}: {payload['n_samples']} samples at {payload['rate_hz']:.9g} samples/s "
        f"({payload['duration_s']:.3f} s), {len(payload['steps'])} steps",
        soft_wrap=True,
    )
    roles = [f"{role} from {listed([name])}" for role, name in payload["columns"].items()]
    console.print(", ".join(roles), soft_wrap=True)
    for line in instrument.in_words():
        console.print(line, soft_wrap=True)
    for remark in payload["remarks"]:
        console.print(f"note: {remark}", soft_wrap=True)
    for doubt in instrument.doubts:
        console.print(f"doubt: {doubt.sentence}", soft_wrap=True)
    if not payload["steps"]:
        return
    table = Table("step", "from s", "hold s", "frequency Hz", "gamma", "at the plate")
    for i, step in enumerate(payload["steps"]):
        hold = step["n_samples"] - step["settle_samples"]
        shown = ["-" if v is None else f"{v:.4g}" for v in (step["gamma"], step["achieved_gamma"])]
        table.add_row(
            str(i),
            f"{step['first_sample'] / payload['rate_hz']:.3f}",
            f"{hold / payload['rate_hz']:.3f}",
            f"{step['frequency_hz']:.5f}",
            *shown,
        )
    print_table(table)
    print_lines(ACHIEVED)
