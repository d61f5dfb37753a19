"""One drop test: files read, fitted and judged; pictures drawn; the result declared in a rig profile."""

from __future__ import annotations

import datetime
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.drop.corrections import NOTHING, Corrections, Progress
from analysis.drop.falls.fit import AIR_KG_PER_M3, Fall, with_balls
from analysis.drop.falls.outcome import judge_falls, of_falls
from analysis.drop.figures import FitPlot, camera_plot, draw_fit, draw_sound, draw_track, falls_plot, times_plot
from analysis.drop.film.camera_fit import fit_camera
from analysis.drop.film.outcome import Units, of_camera
from analysis.drop.load import Known, Path2D, load_all
from analysis.drop.outcome import Outcome
from analysis.drop.read.balls import read_balls
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.outcome import judge, of_times
from bench.profiles.edit import declare, with_values
from daq.files.disk import write_whole
from daq.files.json_values import json_object
from daq.setup.errors import InputError
from daq.setup.values import STANDARD_GRAVITY_MPS2
from rig.profile import parse_profile

# what `bench drop` calls each number of a request, the positive ones first, and each of its corrections
POSITIVE = {
    "fps": "fps", "scale_m": "scale", "ball_size_m": "ball-size", "gravity_mps2": "gravity", "mass_kg": "mass",
    "diameter_m": "diameter",
}  # fmt: skip
NUMBERS = POSITIVE | {
    "heights_m": "drop-height", "height_uncertainty_m": "height-uncertainty",
    "scale_uncertainty": "scale-uncertainty", "fps_uncertainty": "fps-uncertainty", "seed": "seed",
}  # fmt: skip
MARKS = {"from_s": "from", "until_s": "until", "ignore_s": "ignore", "add_s": "add", "axis_deg": "axis"}
Height = tuple[float, float]


@dataclass(frozen=True)
class Request:
    """A drop test asked for: the options of `bench drop` by their names; ``corrections`` of all files, or of each."""

    files: tuple[Path, ...]
    fps: float | None = None
    scale_m: float | None = None
    ball_size_m: float | None = None
    scale_uncertainty: float = 0.0
    fps_uncertainty: float = 0.0
    heights_m: tuple[float, ...] = ()
    height_uncertainty_m: float = 0.005
    use_height: str = "check"
    gravity_mps2: float = STANDARD_GRAVITY_MPS2
    mass_kg: float | None = None
    diameter_m: float | None = None
    corrections: tuple[Corrections, ...] = (NOTHING,)
    seed: int = 1
    balls: Path | None = None

    @property
    def stated(self) -> list[Height | None]:
        """Stated height of each file."""
        if not self.heights_m:
            return [None] * len(self.files)
        heights = self.heights_m * (len(self.files) if len(self.heights_m) == 1 else 1)
        return [(height, self.height_uncertainty_m) for height in heights]

    @property
    def corrected(self) -> tuple[Corrections, ...]:
        """Corrections of each file."""
        return self.corrections * (len(self.files) if len(self.corrections) == 1 else 1)

    @property
    def drag_limits(self) -> tuple[float, float]:
        """Smallest and largest drag of a sphere of this mass and size, 1/m."""

        if self.mass_kg is None or self.diameter_m is None:
            return 0.0, np.inf
        area = 0.25 * np.pi * self.diameter_m**2
        # drag coefficients of a sphere, smooth or rough, at Reynolds numbers of 100 to 100 000 (Clift 1978)
        low, high = (0.5 * AIR_KG_PER_M3 * c * area / self.mass_kg for c in (0.3, 1.2))
        return low, high

    def as_json(self) -> dict[str, Any]:
        """All options, for the record."""
        return json_object(vars(replace(self, corrections=self.corrected)))


def check_request(request: Request) -> None:
    """Refuse options that contradict each other or mean nothing: an `InputError` says what was wanted."""
    if request.use_height not in ("check", "data"):
        raise InputError(f"--use-height {request.use_height}: expected check or data")
    if request.use_height == "data" and not request.heights_m:
        raise InputError("--use-height data: there is no height to use; say it with --drop-height")
    for name, option in POSITIVE.items():
        value = getattr(request, name)
        if value is not None and not 0.0 < value < float("inf"):
            raise InputError(f"--{option} {value}: expected a positive number")
    if (request.mass_kg is None) != (request.diameter_m is None):
        raise InputError("--mass and --diameter: give both; together they bound the air drag")
    if any(not 0.0 < height < float("inf") for height in (*request.heights_m, request.height_uncertainty_m)):
        raise InputError("--drop-height and --height-uncertainty: expected positive metres")
    if any(not 0.0 <= sigma < 1.0 for sigma in (request.scale_uncertainty, request.fps_uncertainty)):
        raise InputError("--scale-uncertainty and --fps-uncertainty: expected parts of one, such as 0.01")
    if request.heights_m and len(request.heights_m) not in (1, len(request.files)):
        raise InputError(
            f"--drop-height: {len(request.heights_m)} heights for {len(request.files)} files; give one, or one each"
        )
    for part in request.corrections:
        for name, option in MARKS.items():
            if not np.isfinite([value for value in numbers_of(getattr(part, name)) if value is not None]).all():
                raise InputError(f"--{option}: expected numbers, found one that is none")
        if part.from_s is not None and part.until_s is not None and part.from_s >= part.until_s:
            raise InputError(f"--from {part.from_s} --until {part.until_s}: nothing is left between them")
    _refuse_twice(request.files)


def numbers_of(value: Any) -> tuple[Any, ...]:
    """What an option was given: one value, or several."""
    return value if isinstance(value, tuple) else (value,)


def parse_region(text: str | None) -> tuple[int, int, int, int] | None:
    """``LEFT,TOP,RIGHT,BOTTOM``; raises `InputError` where it is no rectangle."""
    if text is None:
        return None
    try:
        left, top, right, bottom = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--region {text}: expected LEFT,TOP,RIGHT,BOTTOM in whole pixels") from None
    if not (0 <= left < right and 0 <= top < bottom):
        raise InputError(f"--region {text}: expected LEFT < RIGHT and TOP < BOTTOM")
    return left, top, right, bottom


def _refuse_twice(files: Sequence[Path]) -> None:
    """One drop given twice would count twice."""
    seen: dict[object, Path] = {}
    for path in files:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        key: object = path.resolve()
        if path.is_file():
            with path.open("rb") as file:
                key = hashlib.file_digest(file, "sha256").hexdigest()
        if key in seen:
            raise InputError(f"{path}: the same recording as {seen[key]}; give each drop once, or it counts twice")
        seen[key] = path


@dataclass
class DropTest:
    """A drop test: what was asked for and read, what came out, and what a figure of it shows."""

    request: Request
    items: list[tuple[int, Drop | Path2D]]  # (file number, Drop or Path2D) what was read
    outcome: Outcome  # the result; `draw` adds to its sentences
    plot: FitPlot  # data and models
    # impacts of films and paths: item, time in the file, and whether a flight was measured on both sides
    fitted_impacts_s: list[tuple[int, float, bool]] = field(default_factory=list)


def measure(request: Request, progress: Progress | None = None, known: Known | None = None) -> DropTest:
    """Read, fit and judge (raises `InputError`); ``known`` has what is slow and does not depend on corrections."""
    loaded: list[tuple[int, Any]]
    loaded = [
        (number, item)
        for number, (path, part) in enumerate(zip(request.files, request.corrected, strict=True))
        for item in load_all(path, progress, part, known)
    ]
    bounced = [item.name for _, item in loaded if isinstance(item, Path2D) and item.fall is None]
    falls = [item for _, item in loaded if isinstance(item, Path2D) and item.fall is not None]
    if 0 < len(bounced) + len(falls) < len(loaded):
        raise InputError("impact times and filmed paths cannot be fitted together; run them one kind at a time")
    left_out: list[str] = []
    if bounced and falls:
        if len(request.files) > 1 or len(bounced) > len(falls):
            raise InputError(f"{bounced[0]}: bounces, and other drops do not; run falls without a bounce by themselves")
        left_out = [f"not read: {name}: no fall without a bounce, as the others are" for name in bounced]
        loaded = [(number, item) for number, item in loaded if item.name not in bounced]
    items, numbers = [item for _, item in loaded], [number for number, _ in loaded]
    fit_of: Callable[..., Any] = _from_falls if falls else _from_paths if bounced else _from_times
    done = DropTest(request, loaded, *fit_of(items, numbers, request))
    outcome = done.outcome
    not_read = [words for _, item in loaded for words in item.not_read] + left_out
    outcome.sentences += [words for _, item in loaded for words in item.remarks] + not_read
    outcome.payload |= {"not_read": not_read, "options": request.as_json(), "in_words": outcome.sentences}
    return done


def draw(done: DropTest, out: Path) -> None:
    """Check pictures of sounds and films, and the fit with its residuals, into the folder ``out``; each is said."""

    def target(name: str, what: str) -> Path:
        return out / f"{Path(name).stem}-{what}.png"

    out.mkdir(parents=True, exist_ok=True)
    said = done.outcome.sentences
    for number, path in enumerate(done.request.files):
        own = [item for n, item in done.items if n == number]
        drops = [item for item in own if isinstance(item, Drop) and item.sound]
        if drops:
            said.append(f"check picture: {draw_sound(path, drops, target(path.name, 'sound'))}")
        for item in own:
            if not isinstance(item, Drop) and item.tracked is not None:
                said.append(f"check picture: {draw_track(item.tracked, item.name, target(item.name, 'track'))}")
    names = [item.name for _, item in done.items]
    title = names[0] if len(names) == 1 else f"{len(names)} drops ({names[0]} ...)"
    said.append(f"picture: {draw_fit(done.plot, title, target(names[0], 'residuals'))}")


def _from_times(drops: list[Drop], numbers: list[int], request: Request) -> tuple[Outcome, FitPlot]:
    """Impact times: the models, judged on held-out bounces."""
    rng, stated = np.random.default_rng(request.seed), [request.stated[number] for number in numbers]
    g, without_heights = request.gravity_mps2, None
    verdict = judge(drops, g, rng, request.drag_limits)
    if request.use_height == "data":
        without_heights = verdict
        drops = [replace(drop, height_m=height) for drop, height in zip(drops, stated, strict=True)]
        verdict = judge(drops, g, rng, request.drag_limits)
    return of_times(drops, verdict, g, stated, rng, without_heights), times_plot(drops, verdict, g)


def _from_falls(paths: list[Path2D], numbers: list[int], request: Request) -> tuple[Outcome, FitPlot]:
    """Falls without a bounce: the causes, judged on the other drops of each ball."""
    falls = []
    for item in paths:
        if item.fall is None:
            continue
        (time, height), frame_s, scale = item.fall, item.frame_s, request.scale_m
        if frame_s is None and request.fps is None:
            raise InputError(f"{item.name}: a fall counted in frames; say --fps")
        if not item.metres and scale is None:
            raise InputError(f"{item.name}: heights without a unit; head them height (m), or say --scale")
        step_s = frame_s if frame_s is not None else 1.0 / float(request.fps or 1.0)
        falls.append(Fall(item.name, "", time * step_s, height * (scale if scale is not None else 1.0)))
    falls = with_balls(falls)
    names = list(dict.fromkeys(fall.ball for fall in falls))
    sizes = read_balls(request.balls, names) if request.balls is not None else {}
    if request.mass_kg is not None and request.diameter_m is not None:
        if len(names) > 1:
            raise InputError(f"--mass and --diameter: of one ball, and these are {len(names)}; give a table as --balls")
        sizes[names[0]] = (request.mass_kg, request.diameter_m)
    judged = judge_falls(falls, request.gravity_mps2, sizes)
    return of_falls(judged), falls_plot(judged, numbers)


def _from_paths(
    paths: list[Path2D], numbers: list[int], request: Request
) -> tuple[Outcome, FitPlot, list[tuple[int, float, bool]]]:
    """Films and tracked positions: flights, restitution, the models; and the impacts in each file's own time."""
    if request.use_height == "data":
        raise InputError("--use-height data: a film or a path measures the height itself; say --use-height check")
    units = _units(paths, request)
    rng = np.random.default_rng(request.seed)
    fit = fit_camera([item.clip for item in paths], rng)
    height = next((height for number in numbers if (height := request.stated[number]) is not None), None)
    outcome = of_camera([item.name for item in paths], fit, units, rng, height)
    films = [item.tracked for item in paths if item.tracked is not None]
    if films:
        outcome.payload["lost_frames"] = [(film.lost + film.first).tolist() for film in films]
    shape = next(one.model.shape for one in fit.candidates if one.model.name == outcome.payload["best"])
    seen, steps = fit.impacts[shape], [item.frame_s for item in paths]
    impacts = [
        (int(clip), float(frame) * (steps[int(clip)] or 1.0), bool(both))
        for clip, frame, both in zip(seen.clip, seen.frame, seen.bounced, strict=True)
    ]
    return outcome, camera_plot(fit, shape, steps), impacts


def _units(paths: list[Path2D], request: Request) -> Units:
    """Seconds a frame and metres a unit: what was said on the command line first, then what the files say."""
    rates = [item.frame_s or 0.0 for item in paths]
    if request.fps is None and max(rates) > 1.01 * min(rates):
        raise InputError("the files have different frame rates; say --fps, or run them one by one")
    first = paths[0]
    is_clocked = first.tracked is None and first.frame_s is not None  # a table in seconds knows better than --fps
    frame_s = first.frame_s if is_clocked or request.fps is None else 1.0 / request.fps
    scale, ball = request.scale_m, None
    if first.tracked is not None:
        ball = float(np.median(np.minimum(first.tracked.tall_px, first.tracked.width_px)))
    if request.ball_size_m is not None and scale is None:
        if ball is None:
            raise InputError("--ball-size: only a film shows the ball's size; say --scale")
        scale = request.ball_size_m / ball
    if scale is None and all(item.metres for item in paths):
        scale = 1.0
    is_assumed = request.fps is None and first.tracked is not None
    uncertainties = request.scale_uncertainty, request.fps_uncertainty
    return Units(frame_s, scale, request.gravity_mps2, *uncertainties, is_assumed, ball)


def declare_into(profile: Path, outcome: Outcome, stale: str, ask: Callable[[str], bool | None]) -> str | None:
    """Write what was measured into a profile that still reads afterwards; returns why nothing was written.

    ``stale``: "keep" or "remove" effects that are declared and that this result was measured without; "ask" about
    them, by ``ask``, whose answer is None where there is none.

    Raises `InputError` where the profile cannot be read, or would be none any more.
    """
    if not outcome.measured:
        reasons = "; ".join(outcome.payload["unexplained_because"]) or "every value is compatible with zero"
        return f"{profile}: nothing was written into it: {reasons}"
    try:
        text = profile.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{profile}: cannot be read ({error.strerror})") from error
    before = parse_profile(text, str(profile)).declared
    effects = sorted({item.key.split(".")[1] for item in outcome.measured})
    left = [name for name in ("coulomb_friction", "quadratic_drag") if name in before and name not in effects]
    if left and stale == "ask":
        names = " and ".join(left)
        answer = ask(f"{profile} declares {names}; the restitution was measured without. Remove it?")
        if answer is None:
            return (
                f"{profile}: nothing was written into it: it declares {names}, and the restitution found here was "
                "measured without; say --stale remove or --stale keep"
            )
        stale = "remove" if answer else "keep"
    edited = declare(text, outcome.measured, datetime.date.today(), str(profile))
    if left and stale == "remove":
        edited = with_values(edited, {f"declared.{name}": None for name in left}, str(profile))
        outcome.sentences.append(f"{profile}: removed {', '.join(left)}")
    parse_profile(edited, str(profile))
    write_whole(profile, edited)
    outcome.sentences.append(f"{profile}: declared {', '.join(effects)}")
    return None
