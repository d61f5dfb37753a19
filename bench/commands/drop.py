"""`bench drop`: restitution, friction and drag from films, tracked positions, sounds and impact times."""

from __future__ import annotations

import datetime
import glob
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bench.outputs import JSON, Edited, File, Folder, Overwrite, check_or_leave
from bench.terminal.console import EXIT_USAGE, fail, write_json

if TYPE_CHECKING:
    from analysis.drop.outcome import Outcome
    from analysis.drop.rows import Drop
    from analysis.drop.sources import Path2D

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
    import numpy as np

    from analysis.drop.rows import Drop
    from analysis.drop.sources import load_all

    made = tuple(f"{glob.escape(path.stem)}-{what}.png" for path in files for what in ("residuals", "track"))
    check_or_leave(
        File("--json", json_target, JSON), Folder("--out", out if pictures else None, made), Edited("--into", into),
        inputs=files, overwrite=overwrite,
    )  # fmt: skip
    if use_height not in ("check", "data"):
        fail(f"--use-height {use_height}: expected check or data", EXIT_USAGE)
    for name, value in (("fps", fps), ("scale", scale), ("ball-size", ball_size), ("gravity", gravity)):
        if value is not None and not 0.0 < value < float("inf"):
            fail(f"--{name} {value}: expected a positive number", EXIT_USAGE)
    if any(height <= 0.0 for height in drop_height or []) or height_uncertainty <= 0.0:
        fail("--drop-height and --height-uncertainty: expected positive metres", EXIT_USAGE)
    if drop_height and len(drop_height) not in (1, len(files)):
        fail(f"--drop-height: {len(drop_height)} heights for {len(files)} files; give one, or one each", EXIT_USAGE)
    heights: list[Any] = [(h, height_uncertainty) for h in drop_height or [None]]  # type: ignore[list-item]
    stated = [h if h[0] is not None else None for h in heights * (len(files) if len(heights) == 1 else 1)]
    rng = np.random.default_rng(seed)
    try:
        loaded = [(item, height) for path, height in zip(files, stated, strict=True) for item in load_all(path, _bar)]
        times = [item for item, _ in loaded if isinstance(item, Drop)]
        paths = [item for item, _ in loaded if not isinstance(item, Drop)]
        stated = [height for _, height in loaded]
        if times and paths:
            fail("impact times and filmed paths cannot be fitted together; run them one kind at a time", EXIT_USAGE)
        if times:
            outcome = _from_times(times, stated, use_height == "data", gravity, rng, out if pictures else None)
        else:
            options = (fps, scale, ball_size, scale_uncertainty, fps_uncertainty, gravity)
            outcome = _from_paths(paths, options, rng, out if pictures else None)
            _check_height(outcome, stated)
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


def _from_times(
    drops: list[Drop], stated: list[Any], as_data: bool, gravity: float, rng: Any, out: Path | None
) -> Outcome:
    """Impact times: the ladder, judged on held-out bounces."""
    from dataclasses import replace

    from analysis.drop.attribution import judge
    from analysis.drop.outcome import of_times
    from analysis.drop.pictures import draw_times

    if as_data:
        drops = [replace(drop, height_m=height) for drop, height in zip(drops, stated, strict=True)]
    verdict = judge(drops, gravity, rng)
    outcome = of_times(drops, verdict, gravity, stated, rng)
    if out is not None:
        outcome.sentences.append(f"picture: {draw_times(drops, verdict, _target(out, drops[0].name, 'residuals'))}")
    return outcome


def _from_paths(paths: list[Path2D], options: tuple[Any, ...], rng: Any, out: Path | None) -> Outcome:
    """Films and tracked positions: flights, restitution, the ladder."""
    from analysis.drop.camera import fit_camera
    from analysis.drop.filmed import of_camera
    from analysis.drop.pictures import draw_camera, draw_track

    units = _units(paths, options)
    names = [item.clip.name for item in paths]
    fit = fit_camera([item.clip for item in paths], rng)
    outcome = of_camera(names, fit, units, rng)
    for item in paths:
        if item.tracked is not None:
            outcome.payload.setdefault("lost_frames", []).append(item.tracked.lost.tolist())
    if out is not None:
        for item in paths:
            if item.tracked is not None:
                drawn = draw_track(item.tracked, item.clip.name, _target(out, item.clip.name, "track"))
                outcome.sentences.append(f"check picture: {drawn}")
        shape = next(r.shape for r in fit.rungs if r.model.name == outcome.payload["chosen"])
        drawn = draw_camera(fit, shape, ", ".join(names[:3]), _target(out, names[0], "residuals"), units.frame_s)
        outcome.sentences.append(f"picture: {drawn}")
    return outcome


def _units(paths: list[Path2D], options: tuple[Any, ...]) -> Any:
    """Seconds a frame and metres a unit: what was said on the command line first, then what the files say."""
    import numpy as np

    from analysis.drop.filmed import Units
    from daq.setup.errors import InputError

    fps, scale, ball_size, scale_sigma, fps_sigma, gravity = options
    stated = {item.frame_s for item in paths}
    if fps is None and len(stated) > 1 and max(s or 0.0 for s in stated) > 1.01 * min(s or 0.0 for s in stated):
        raise InputError("the files have different frame rates; say --fps, or run them one by one")
    first = paths[0]
    frame_s = first.frame_s if fps is None or (first.tracked is None and first.frame_s is not None) else 1.0 / fps
    if ball_size is not None and scale is None:
        if first.tracked is None:
            raise InputError("--ball-size: only a film shows the ball's size; say --scale")
        scale = ball_size / float(np.median(np.minimum(first.tracked.tall_px, first.tracked.width_px)))
    if scale is None and all(item.metres for item in paths):
        scale = 1.0
    return Units(frame_s, scale, gravity, scale_sigma, fps_sigma)


def _check_height(outcome: Outcome, stated: list[Any]) -> None:
    """Hold the filmed fall against the stated height."""
    given = [height for height in stated if height is not None]
    found = outcome.payload["drop_height_m"]
    if given and found["value"] is not None:
        value, sigma = given[0]
        own = (found["high"] - found["low"]) / 3.92
        off = (found["value"] - value) / (own**2 + sigma**2) ** 0.5
        outcome.payload["stated_height_m"] = {"value": value, "uncertainty": sigma, "sigmas_off": off}
        outcome.sentences.append(f"stated height {value:.3f} m: the filmed fall is {off:+.1f} sigma from it")


def _target(out: Path, name: str, what: str) -> Path:
    out.mkdir(parents=True, exist_ok=True)
    return out / f"{Path(name).stem}-{what}.png"


def _declare(profile: Path, outcome: Outcome) -> None:
    """Write what was measured into a rig profile, and check that the profile still reads."""
    from bench.profiles.edit import declare
    from daq.setup.errors import InputError
    from rig.profile import parse_profile

    try:
        text = profile.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{profile}: cannot be read ({error.strerror})") from error
    edited = declare(text, outcome.measured, datetime.date.today(), str(profile))
    parse_profile(edited, str(profile))
    profile.write_text(edited, encoding="utf-8")
    effects = ", ".join(sorted({item.effect for item in outcome.measured}))
    outcome.sentences.append(f"{profile}: declared {effects}")
