"""`bench drop`: restitution, friction and drag from films, tracked positions, sounds and impact times."""

from __future__ import annotations

import datetime
import glob
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.outputs import JSON, Edited, File, Folder, Overwrite, check_or_leave
from bench.terminal.console import EXIT_USAGE, fail, write_json

if TYPE_CHECKING:
    from analysis.drop.outcome import Outcome

Files = Annotated[list[Path], typer.Argument(help="Films, folders of frames, tables, WAV files or recordings.")]
Fps = Annotated[float | None, typer.Option(help="Frames per second at which it was filmed (default: the file's own).")]
Scale = Annotated[float | None, typer.Option(help="Metres a pixel (or a unit of the table).")]
Sigma = Annotated[float, typer.Option(help="Relative uncertainty, one standard deviation.")]
Size = Annotated[float | None, typer.Option(help="The ball's height in metres, as a scale (films only).")]
Heights = Annotated[list[float] | None, typer.Option(help="Stated drop height, m: one for all, or one for each file.")]
HeightSigma = Annotated[float, typer.Option(help="Uncertainty of the stated height, m.")]
Use = Annotated[str, typer.Option(help="check the stated height, or use it as data.")]
Gravity = Annotated[float, typer.Option(help="Local gravity, m/s^2.")]
Json = Annotated[str | None, typer.Option("--json", help="Write the result as JSON here; - prints it.")]
Out = Annotated[Path, typer.Option(help="Folder for the pictures.")]
Pictures = Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw the check picture and the residuals.")]
Into = Annotated[Path | None, typer.Option(help="Write the result into this rig profile.")]
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
    json_target: Json = None,
    out: Out = Path(),
    pictures: Pictures = True,
    into: Into = None,
    seed: Seed = 1,
    overwrite: Overwrite = False,
) -> None:
    """Drop tests by camera, sound or contact: restitution, friction, drag, and what the data cannot tell.

    Several files of one ball are fitted together. Example: bench drop drop.avi --fps 1000 --scale 0.0002 --json -
    """
    from bench.jobs.drop_test import Request, check_request, run

    made = tuple(f"{glob.escape(path.stem)}-{what}.png" for path in files for what in ("residuals", "track"))
    check_or_leave(
        File("--json", json_target, JSON), Folder("--out", out if pictures else None, made), Edited("--into", into),
        inputs=files, overwrite=overwrite,
    )  # fmt: skip
    request = Request(
        tuple(files), fps, scale, ball_size, scale_uncertainty, fps_uncertainty, tuple(drop_height or ()),
        height_uncertainty, use_height, gravity, seed,
    )  # fmt: skip
    try:
        check_request(request)
        outcome = run(request, out if pictures else None, _bar)
        if into is not None:
            _declare(into, outcome)
    except ValueError as error:
        fail(str(error), EXIT_USAGE)
    outcome.payload["in_words"] = outcome.sentences
    write_json(outcome.payload, json_target)
    if json_target != "-":
        for sentence in outcome.sentences:
            sys.stdout.write(sentence + "\n")


def _bar(what: str, done: int, total: int) -> None:
    """A progress line on a terminal; nothing in a pipe."""
    if sys.stderr.isatty() and (done % 10 == 0 or done >= total):
        sys.stderr.write(f"\r{what}: {done} of {total} frames" + ("\n" if done >= total else ""))


def _declare(profile: Path, outcome: Outcome) -> None:
    """Write what was measured into a rig profile, and check that the profile still reads."""
    from bench.profiles.edit import declare
    from daq.recording.whole_file import write_whole
    from daq.setup.errors import InputError
    from rig.profile import parse_profile

    try:
        text = profile.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{profile}: cannot be read ({error.strerror})") from error
    edited = declare(text, outcome.measured, datetime.date.today(), str(profile))
    parse_profile(edited, str(profile))
    write_whole(profile, edited)
    effects = ", ".join(sorted({item.effect for item in outcome.measured}))
    outcome.sentences.append(f"{profile}: declared {effects}")
