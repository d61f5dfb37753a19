"""One drop test: files read, fitted and judged; pictures drawn; the result written into a profile."""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.drop.options.corrections import NOTHING, Corrections
from daq.setup.errors import InputError
from daq.setup.setup import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from analysis.drop.filmed import Units
    from analysis.drop.load import Path2D
    from analysis.drop.options.progress import Progress
    from analysis.drop.outcome import Outcome
    from analysis.drop.times.one_ahead import Drop

AIR_KG_PER_M3 = 1.2
DRAG_COEFFICIENTS = (0.3, 1.2)  # of a sphere, smooth or rough, at Reynolds numbers of 100 to 100 000 (Clift 1978)
Height = tuple[float, float]


@dataclass(frozen=True)
class Request:
    """What was asked for; the options of `bench drop` by their names."""

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
    corrections: Corrections = NOTHING
    seed: int = 1

    @property
    def stated(self) -> list[Height | None]:
        """Stated height of each file."""
        if not self.heights_m:
            return [None] * len(self.files)
        heights = self.heights_m * (len(self.files) if len(self.heights_m) == 1 else 1)
        return [(height, self.height_uncertainty_m) for height in heights]

    @property
    def drag_limits(self) -> tuple[float, float]:
        """Smallest and largest drag of a sphere of this mass and size, 1/m."""
        if self.mass_kg is None or self.diameter_m is None:
            return 0.0, np.inf
        area = 0.25 * np.pi * self.diameter_m**2
        low, high = (0.5 * AIR_KG_PER_M3 * c * area / self.mass_kg for c in DRAG_COEFFICIENTS)
        return low, high

    def as_json(self) -> dict[str, Any]:
        """All options, for the record."""
        return {k: list(map(str, v)) if k == "files" else v for k, v in dataclasses.asdict(self).items()}


def check_request(request: Request) -> None:
    """Refuse options that contradict each other or mean nothing.

    Raises
    ------
    InputError
        With the option, and what was wanted.
    """
    if request.use_height not in ("check", "data"):
        raise InputError(f"--use-height {request.use_height}: expected check or data")
    if request.use_height == "data" and not request.heights_m:
        raise InputError("--use-height data: there is no height to use; say it with --drop-height")
    positive = {
        "fps": request.fps, "scale": request.scale_m, "ball-size": request.ball_size_m,
        "gravity": request.gravity_mps2, "mass": request.mass_kg, "diameter": request.diameter_m,
    }  # fmt: skip
    for name, value in positive.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise InputError(f"--{name} {value}: expected a positive number")
    if (request.mass_kg is None) != (request.diameter_m is None):
        raise InputError("--mass and --diameter: give both; together they bound the air drag")
    if any(height <= 0.0 for height in request.heights_m) or request.height_uncertainty_m <= 0.0:
        raise InputError("--drop-height and --height-uncertainty: expected positive metres")
    if request.heights_m and len(request.heights_m) not in (1, len(request.files)):
        raise InputError(
            f"--drop-height: {len(request.heights_m)} heights for {len(request.files)} files; give one, or one each"
        )
    part = request.corrections
    if part.from_s is not None and part.until_s is not None and part.from_s >= part.until_s:
        raise InputError(f"--from {part.from_s} --until {part.until_s}: nothing is left between them")
    _refuse_twice(request.files)


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


def run(request: Request, out: Path | None, progress: Progress | None = None) -> Outcome:
    """Read, fit and judge; draw pictures into ``out`` where there is one.

    Raises
    ------
    InputError
        Anything that is no drop test, with the file and what to do.
    """
    from analysis.drop.load import load_all
    from analysis.drop.times.one_ahead import Drop

    loaded = [
        (item, height)
        for path, height in zip(request.files, request.stated, strict=True)
        for item in load_all(path, progress, request.corrections)
    ]
    times = [item for item, _ in loaded if isinstance(item, Drop)]
    paths = [item for item, _ in loaded if not isinstance(item, Drop)]
    stated = [height for _, height in loaded]
    if times and paths:
        raise InputError("impact times and filmed paths cannot be fitted together; run them one kind at a time")
    outcome = _from_times(times, stated, request, out) if times else _from_paths(paths, stated, request, out)
    not_read = [words for item, _ in loaded for words in item.not_read]
    outcome.payload["not_read"] = not_read
    outcome.sentences += not_read
    outcome.payload["options"] = request.as_json()
    return outcome


def _from_times(drops: list[Drop], stated: list[Height | None], request: Request, out: Path | None) -> Outcome:
    """Impact times: the models, judged on held-out bounces."""
    from analysis.drop.figures import draw_sound, draw_times
    from analysis.drop.outcome import of_times
    from analysis.drop.times.model_selection import judge

    rng = np.random.default_rng(request.seed)
    g, blind = request.gravity_mps2, None
    verdict = judge(drops, g, rng, request.drag_limits)
    if request.use_height == "data":
        blind = verdict
        drops = [replace(drop, height_m=height) for drop, height in zip(drops, stated, strict=True)]
        verdict = judge(drops, g, rng, request.drag_limits)
    outcome = of_times(drops, verdict, g, stated, rng, blind)
    if out is not None:
        for path in request.files:
            own = [drop for drop in drops if drop.file == path]
            if own and own[0].sound:
                drawn = draw_sound(path, own, _target(out, path.name, "sound"))
                outcome.sentences.append(f"check picture: {drawn}")
        drawn = draw_times(drops, verdict, g, _target(out, drops[0].name, "residuals"))
        outcome.sentences.append(f"picture: {drawn}")
    return outcome


def _from_paths(paths: list[Path2D], stated: list[Height | None], request: Request, out: Path | None) -> Outcome:
    """Films and tracked positions: flights, restitution, the models."""
    from analysis.drop.figures import draw_camera, draw_track
    from analysis.drop.film.camera_fit import fit_camera
    from analysis.drop.filmed import of_camera

    if request.use_height == "data":
        raise InputError("--use-height data: a film or a path measures the height itself; say --use-height check")
    units = _units(paths, request)
    names = [item.clip.name for item in paths]
    rng = np.random.default_rng(request.seed)
    fit = fit_camera([item.clip for item in paths], rng)
    outcome = of_camera(names, fit, units, rng)
    for item in paths:
        outcome.sentences += item.remarks
        if item.tracked is not None:
            outcome.payload.setdefault("lost_frames", []).append(item.tracked.lost.tolist())
    _check_height(outcome, stated)
    if out is not None:
        for item in paths:
            if item.tracked is not None:
                drawn = draw_track(item.tracked, item.clip.name, _target(out, item.clip.name, "track"))
                outcome.sentences.append(f"check picture: {drawn}")
        shape = next(r.shape for r in fit.candidates if r.model.name == outcome.payload["best"])
        drawn = draw_camera(fit, shape, ", ".join(names[:3]), _target(out, names[0], "residuals"), units.frame_s)
        outcome.sentences.append(f"picture: {drawn}")
    return outcome


def _units(paths: list[Path2D], request: Request) -> Units:
    """Seconds a frame and metres a unit: what was said on the command line first, then what the files say."""
    from analysis.drop.filmed import Units

    stated = {item.frame_s for item in paths}
    if request.fps is None and len(stated) > 1 and max(s or 0.0 for s in stated) > 1.01 * min(s or 0.0 for s in stated):
        raise InputError("the files have different frame rates; say --fps, or run them one by one")
    first = paths[0]
    own = request.fps is None or (first.tracked is None and first.frame_s is not None)
    frame_s = first.frame_s if own or request.fps is None else 1.0 / request.fps
    ball = None
    if first.tracked is not None:
        ball = float(np.median(np.minimum(first.tracked.tall_px, first.tracked.width_px)))
    scale = request.scale_m
    if request.ball_size_m is not None and scale is None:
        if ball is None:
            raise InputError("--ball-size: only a film shows the ball's size; say --scale")
        scale = request.ball_size_m / ball
    if scale is None and all(item.metres for item in paths):
        scale = 1.0
    assumed = request.fps is None and first.tracked is not None
    return Units(
        frame_s, scale, request.gravity_mps2, request.scale_uncertainty, request.fps_uncertainty, assumed, ball
    )


def _check_height(outcome: Outcome, stated: list[Height | None]) -> None:
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


def declare_into(profile: Path, outcome: Outcome, stale: str, ask: Callable[[str], bool | None]) -> str | None:
    """Write what was measured into a profile that still reads afterwards; returns why nothing was written.

    Parameters
    ----------
    profile
        The file.
    outcome
        What was measured; nothing that is unexplained, or compatible with zero, is in it.
    stale
        "keep" or "remove" effects that are declared and that this result was measured without; "ask" about them.
    ask
        Puts a question; None where nobody can answer.

    Raises
    ------
    InputError
        The profile cannot be read, or would be none any more.
    """
    from bench.profiles.edit import declare, withdraw
    from daq.files.whole_file import write_whole
    from rig.profile import parse_profile

    if not outcome.measured:
        reasons = "; ".join(outcome.payload["unexplained_because"]) or "every value is compatible with zero"
        return f"{profile}: nothing was written into it: {reasons}"
    try:
        text = profile.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{profile}: cannot be read ({error.strerror})") from error
    before = parse_profile(text, str(profile)).declared
    effects = sorted({item.effect for item in outcome.measured})
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
        edited = withdraw(edited, left, str(profile))
        outcome.sentences.append(f"{profile}: removed {', '.join(left)}")
    parse_profile(edited, str(profile))
    write_whole(profile, edited)
    outcome.sentences.append(f"{profile}: declared {', '.join(effects)}")
    return None
