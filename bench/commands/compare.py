"""`bench compare`: a recording held against the model, step by step, at the gamma that the plate achieved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, Figures, File, Folder, Json, Overwrite, check_outputs
from bench.terminal.console import CYCLES, new_table, print_lines, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from analysis.flights.compare import Comparison
    from analysis.report.wording import GammaScale

COLUMNS = (
    "n: measured flights; ratio: their mean time over the model's; rms: of their distance to the nearest time predicted"
)


def command(
    recording: Path = typer.Argument(help="The recording (HDF5)."),
    json: Json = None,
    figures: Figures = None,
    profile: str | None = typer.Option(None, "--profile", help="A profile that replaces the recording's own."),
    ideal: bool = typer.Option(False, "--ideal", help="Leave the declared effects out of the model."),
    overwrite: Overwrite = False,
) -> None:
    """Measured against predicted: flight times, double hits, and the first bifurcation.

    Example: bench compare run.h5 --profile better.toml --figures pictures
    """
    from analysis.flights.compare import compare, plausibility_warnings
    from analysis.report.wording import gamma_scale
    from bench.jobs.report import draw, flights_with_progress
    from bench.profiles.find import load_measuring
    from bench.terminal.comparison import comparison_json
    from daq.instrument.instrument import instrument_of
    from daq.recording import open_recording

    check_outputs(
        File("--json", json, JSON), Folder("--figures", figures), inputs=[recording, profile], overwrite=overwrite
    )
    with open_recording(recording) as opened:
        if profile is not None:
            opened.measure_with(load_measuring(profile)[0])
        table = flights_with_progress(opened, quiet=json == "-")
        if "continuity" not in opened.channels:
            raise InputError(
                f"{recording}: wanted a channel 'continuity' (take-offs and landings), found "
                f"{', '.join(opened.channels)}; `bench reprocess` analyses only the plate"
            )
        held = compare(table, opened.setup, effects={} if ideal else None, steps_table=opened.steps)
        if figures is not None:
            draw(opened, table, figures, None if ideal else held)
        odd = plausibility_warnings(opened, table, instrument_of(opened))
        scale = gamma_scale(opened.setup.forcing, held.ratio)
        simulated = bool(opened.attrs.get("simulated"))
    if write_json(comparison_json(held) | {"warnings": odd}, json):
        _print(held, recording.name, simulated, scale)
        print_lines(*(f"note: {line}" for line in odd))


def _print(held: Comparison, name: str, simulated: bool, scale: GammaScale) -> None:
    """Tables for a person."""
    from rich.console import Console

    from bench.terminal.comparison import sentences, unfit_steps

    title = f"{name}{' (simulated rig)' if simulated else ''} against the model"
    headings = ("step", scale.name.replace("_", "\n"), "measured", "model", "n", "ratio", "rms us", "")
    table = new_table(*headings, words=("measured", "model"), title=title)  # only these are folded
    for s in held.steps:
        model = s.predicted.removesuffix(f", period {s.predicted.partition('-')[0]}")
        ratio = f"{s.mean_ratio:.4f}" if s.mean_ratio == s.mean_ratio else ""
        rms = f"{1e6 * s.rms_s:.1f}" if s.rms_s == s.rms_s else ""
        table.add_row(
            str(s.step), f"{scale.factor * s.gamma:.4f}", s.measured.label, model,
            str(s.measured.flights), ratio, rms, "?" if s.unfit_reason else "",
        )  # fmt: skip
    Console().print(table)
    print_lines(*unfit_steps(held), *sentences(held, scale), COLUMNS, CYCLES)
