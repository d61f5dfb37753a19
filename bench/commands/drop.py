"""`bench drop`: restitution, friction and drag from films, tracked positions, sounds, impact times and falls."""

from __future__ import annotations

import glob
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, PROFILE, File, Folder, Json, Overwrite, Port, check_outputs
from bench.terminal.console import print_lines, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from bench.jobs.drop_test import Request


def command(
    files: list[Path] = typer.Argument(help="Films, folders of frames, tables, WAV files or recordings."),
    fps: float | None = typer.Option(None, help="Frames per second at which it was filmed (default: the file's own)."),
    scale: float | None = typer.Option(None, help="Metres a pixel (or a unit of the table)."),
    ball_size: float | None = typer.Option(None, help="The ball's height in metres, as a scale (films only)."),
    scale_uncertainty: float = typer.Option(0.0, help="Relative uncertainty, one standard deviation."),
    fps_uncertainty: float = typer.Option(0.0, help="Relative uncertainty, one standard deviation."),
    drop_height: list[float] | None = typer.Option(
        None, help="Stated drop height, m: one for all, or one for each file."
    ),
    height_uncertainty: float = typer.Option(0.005, help="Uncertainty of the stated height, m."),
    use_height: str = typer.Option("check", help="check the stated height, or use it as data."),
    gravity: float = typer.Option(9.80665, help="Local gravity, m/s^2."),
    mass: float | None = typer.Option(None, help="The ball's mass, kg; with --diameter: bounds of its air drag."),
    diameter: float | None = typer.Option(None, help="The ball's diameter, m."),
    balls: Path | None = typer.Option(None, help="Table of balls with mass and size, for falls without a bounce."),
    from_s: float | None = typer.Option(None, "--from", help="Leave out what is before this time of the file, s."),
    until_s: float | None = typer.Option(None, "--until", help="Leave out what is after this time of the file, s."),
    ignore: list[float] | None = typer.Option(None, help="Leave out the event or frame nearest to this time, s."),
    add: list[float] | None = typer.Option(None, help="Add an impact at this time, s."),
    region: str | None = typer.Option(None, help="Part of the picture to look at: LEFT,TOP,RIGHT,BOTTOM in pixels."),
    axis: float | None = typer.Option(None, help="Direction of the fall in the picture: degrees right of down."),
    json_target: Json = None,
    out: Path = typer.Option(Path(), help="Folder for the pictures."),
    pictures: bool = typer.Option(True, "--pictures/--no-pictures", help="Draw the check picture and the residuals."),
    into: Path | None = typer.Option(None, help="Write the result into this rig profile."),
    stale: str = typer.Option(
        "ask", help="Effects declared before that this result does not measure: ask, keep or remove."
    ),
    seed: int = typer.Option(1, help="Seed of the bootstrap."),
    page: bool = typer.Option(
        False, "--page", help="Open the desk's page, where impacts are moved, added and removed."
    ),
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
        File("--into", into, PROFILE, edited=True), inputs=[*files, balls], overwrite=overwrite,
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
