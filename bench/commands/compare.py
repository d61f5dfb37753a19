"""`bench compare`: a recording held against the model, step by step, at the gamma that the plate achieved."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import JSON, Figures, File, Folder, Json, Overwrite, check_outputs
from bench.terminal.console import print_lines, write_json
from daq.setup.errors import InputError


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
    from bench.terminal.comparison import comparison_json, show
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
        show(held, recording.name, simulated, scale)
        print_lines(*(f"note: {line}" for line in odd))
