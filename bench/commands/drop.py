"""`bench drop`: restitution, friction and drag from films, tracked positions, sounds, impact times and falls."""

from __future__ import annotations

import glob
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.outputs import JSON, Edited, File, Folder, Json, Overwrite, Port, check_outputs
from bench.terminal.console import print_lines, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from bench.jobs.drop_test import Request

Files = Annotated[list[Path], typer.Argument(help="Films, folders of frames, tables, WAV files or recordings.")]
Fps = Annotated[float | None, typer.Option(help="Frames per second at which it was filmed (default: the file's own).")]
Scale = Annotated[float | None, typer.Option(help="Metres a pixel (or a unit of the table).")]
Sigma = Annotated[float, typer.Option(help="Relative uncertainty, one standard deviation.")]
Size = Annotated[float | None, typer.Option(help="The ball's height in metres, as a scale (films only).")]
Heights = Annotated[list[float] | None, typer.Option(help="Stated drop height, m: one for all, or one for each file.")]
HeightSigma = Annotated[float, typer.Option(help="Uncertainty of the stated height, m.")]
Use = Annotated[str, typer.Option(help="check the stated height, or use it as data.")]
Gravity = Annotated[float, typer.Option(help="Local gravity, m/s^2.")]
Mass = Annotated[float | None, typer.Option(help="The ball's mass, kg; with --diameter: bounds of its air drag.")]
Diameter = Annotated[float | None, typer.Option(help="The ball's diameter, m.")]
Balls = Annotated[Path | None, typer.Option(help="Table of balls with mass and size, for falls without a bounce.")]
From = Annotated[float | None, typer.Option("--from", help="Leave out what is before this time of the file, s.")]
Until = Annotated[float | None, typer.Option("--until", help="Leave out what is after this time of the file, s.")]
Ignore = Annotated[list[float] | None, typer.Option(help="Leave out the event or frame nearest to this time, s.")]
Add = Annotated[list[float] | None, typer.Option(help="Add an impact at this time, s.")]
Region = Annotated[str | None, typer.Option(help="Part of the picture to look at: LEFT,TOP,RIGHT,BOTTOM in pixels.")]
Axis = Annotated[float | None, typer.Option(help="Direction of the fall in the picture: degrees right of down.")]
Out = Annotated[Path, typer.Option(help="Folder for the pictures.")]
Pictures = Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw the check picture and the residuals.")]
Into = Annotated[Path | None, typer.Option(help="Write the result into this rig profile.")]
Stale = Annotated[
    str, typer.Option(help="Effects declared before that this result does not measure: ask, keep or remove.")
]
Page = Annotated[bool, typer.Option("--page", help="Open the desk's page, where impacts are moved, added and removed.")]
Seed = Annotated[int, typer.Option(help="Seed of the bootstrap.")]


def command(
    files: Files,
    fps: Fps = None,
    scale: Scale = None,
    ball_size: Size = None,
    scale_uncertainty: Sigma = 0.0,
    fps_uncertainty: Sigma = 0.0,
    drop_height: Heights = None,
    height_uncertainty: HeightSigma = 0.005,
    use_height: Use = "check",
    gravity: Gravity = 9.80665,
    mass: Mass = None,
    diameter: Diameter = None,
    balls: Balls = None,
    from_s: From = None,
    until_s: Until = None,
    ignore: Ignore = None,
    add: Add = None,
    region: Region = None,
    axis: Axis = None,
    json_target: Json = None,
    out: Out = Path(),
    pictures: Pictures = True,
    into: Into = None,
    stale: Stale = "ask",
    seed: Seed = 1,
    page: Page = False,
    port: Port = None,
    overwrite: Overwrite = False,
) -> None:
    """Drop tests by camera, sound or contact: restitution, friction, drag, and what the data cannot tell.

    Several files of one ball are fitted together. Example: bench drop drop.avi --fps 1000 --scale 0.0002 --json -
    """
    from analysis.drop.corrections import Corrections
    from bench.jobs.drop_test import Request, check_request, parse_region

    made = tuple(f"{glob.escape(path.stem)}-{what}.png" for path in files for what in ("residuals", "track", "sound"))
    check_outputs(
        File("--json", json_target, JSON), Folder("--out", out if pictures and not page else None, made),
        Edited("--into", into), inputs=[*files, balls], overwrite=overwrite,
    )  # fmt: skip
    by_hand = Corrections(from_s, until_s, tuple(ignore or ()), tuple(add or ()), parse_region(region), axis)
    request = Request(
        tuple(files), fps, scale, ball_size, scale_uncertainty, fps_uncertainty, tuple(drop_height or ()),
        height_uncertainty, use_height, gravity, mass, diameter, (by_hand,), seed, balls,
    )  # fmt: skip
    check_request(request)
    if page:
        _serve(request, json_target, into, port)
    else:
        _measure(request, json_target, out if pictures else None, into, stale)


def _serve(request: Request, json_target: str | None, into: Path | None, port: int | None) -> None:
    """The desk's page of this drop test, until Ctrl-C."""
    from bench.web.packages import serve_pages

    if into is not None or json_target == "-":
        raise InputError("--page: the page writes JSON into the file of --json; --into and --json - go without it")
    target = None if json_target is None else Path(json_target)
    folder, options = request.files[0].resolve().parent, {"drop": {"request": request, "target": target}}
    serve_pages(["bench.drops.desk"], folder, port=port, options=options)


def _measure(request: Request, json_target: str | None, out: Path | None, into: Path | None, stale: str) -> None:
    """The drop test itself: sentences, JSON, pictures, profile."""
    from bench.jobs.drop_test import declare_into, draw, measure

    if stale not in ("ask", "keep", "remove"):
        raise InputError(f"--stale {stale}: expected ask, keep or remove")

    def bar(what: str, done: int, total: int) -> None:  # nothing in a pipe
        if sys.stderr.isatty() and (done % 10 == 0 or done >= total):
            sys.stderr.write(f"\r{what}: {done} of {total}" + ("\n" if done >= total else ""))

    def answer_to(question: str) -> bool | None:  # None without a terminal
        return typer.confirm(question) if sys.stdin.isatty() else None

    done = measure(request, bar)
    outcome = done.outcome
    if out is not None:
        draw(done, out)
    refused = declare_into(into, outcome, stale, answer_to) if into is not None else None
    write_json(outcome.payload, json_target)
    if json_target != "-":
        print_lines(*outcome.sentences)
    if refused is not None:
        raise InputError(refused)
