"""One drop test: files read, fitted and judged, and its pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.drop.attribution import judge
from analysis.drop.camera import fit_camera
from analysis.drop.filmed import Units, of_camera
from analysis.drop.outcome import Outcome, of_times
from analysis.drop.rows import Drop
from analysis.drop.sources import Path2D, load_all
from analysis.drop.video import Progress
from daq.setup.errors import InputError
from model.tones import STANDARD_GRAVITY_MPS2


@dataclass(frozen=True)
class Request:
    """The options of `bench drop` by their names; frame rate and scale None where the files state them."""

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
    seed: int = 1

    @property
    def stated(self) -> list[tuple[float, float] | None]:
        """Stated height of each file with its standard uncertainty, m."""
        if not self.heights_m:
            return [None] * len(self.files)
        heights = self.heights_m * (len(self.files) if len(self.heights_m) == 1 else 1)
        return [(height, self.height_uncertainty_m) for height in heights]


def check_request(request: Request) -> None:
    """Refuse options that contradict each other or mean nothing; raises `InputError`."""
    if request.use_height not in ("check", "data"):
        raise InputError(f"--use-height {request.use_height}: expected check or data")
    positive = {
        "fps": request.fps, "scale": request.scale_m, "ball-size": request.ball_size_m, "gravity": request.gravity_mps2,
    }  # fmt: skip
    for name, value in positive.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise InputError(f"--{name} {value}: expected a positive number")
    if any(height <= 0.0 for height in request.heights_m) or request.height_uncertainty_m <= 0.0:
        raise InputError("--drop-height and --height-uncertainty: expected positive metres")
    if request.heights_m and len(request.heights_m) not in (1, len(request.files)):
        raise InputError(
            f"--drop-height: {len(request.heights_m)} heights for {len(request.files)} files; give one, or one each"
        )


def run(request: Request, out: Path | None, progress: Progress | None = None) -> Outcome:
    """Read, fit and judge; draw pictures into ``out`` where there is one.

    Raises
    ------
    InputError
        For what is no drop test, or kinds of files that cannot be fitted together.
    """
    rng = np.random.default_rng(request.seed)
    loaded = [
        (item, height)
        for path, height in zip(request.files, request.stated, strict=True)
        for item in load_all(path, progress)
    ]
    times = [item for item, _ in loaded if isinstance(item, Drop)]
    paths = [item for item, _ in loaded if not isinstance(item, Drop)]
    stated = [height for _, height in loaded]
    if times and paths:
        raise InputError("impact times and filmed paths cannot be fitted together; run them one kind at a time")
    if times:
        return _from_times(times, stated, request, rng, out)
    outcome = _from_paths(paths, request, rng, out)
    _check_height(outcome, stated)
    return outcome


def _from_times(drops: list[Drop], stated: list[Any], request: Request, rng: Any, out: Path | None) -> Outcome:
    """Impact times: the ladder, judged on held-out bounces."""
    if request.use_height == "data":
        drops = [replace(drop, height_m=height) for drop, height in zip(drops, stated, strict=True)]
    verdict = judge(drops, request.gravity_mps2, rng)
    outcome = of_times(drops, verdict, request.gravity_mps2, stated, rng)
    if out is not None:
        from analysis.drop.pictures import draw_times

        outcome.sentences.append(f"picture: {draw_times(drops, verdict, _target(out, drops[0].name, 'residuals'))}")
    return outcome


def _from_paths(paths: list[Path2D], request: Request, rng: Any, out: Path | None) -> Outcome:
    """Films and tracked positions: flights, restitution, the ladder."""
    units = _units(paths, request)
    names = [item.clip.name for item in paths]
    fit = fit_camera([item.clip for item in paths], rng)
    outcome = of_camera(names, fit, units, rng)
    for item in paths:
        if item.tracked is not None:
            outcome.payload.setdefault("lost_frames", []).append(item.tracked.lost.tolist())
    if out is not None:
        from analysis.drop.pictures import draw_camera, draw_track

        for item in paths:
            if item.tracked is not None:
                drawn = draw_track(item.tracked, item.clip.name, _target(out, item.clip.name, "track"))
                outcome.sentences.append(f"check picture: {drawn}")
        shape = next(r.shape for r in fit.rungs if r.model.name == outcome.payload["chosen"])
        drawn = draw_camera(fit, shape, ", ".join(names[:3]), _target(out, names[0], "residuals"), units.frame_s)
        outcome.sentences.append(f"picture: {drawn}")
    return outcome


def _units(paths: list[Path2D], request: Request) -> Units:
    """Seconds a frame and metres a unit: what was stated first, then what the files state."""
    fps, scale, ball_size = request.fps, request.scale_m, request.ball_size_m
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
    return Units(frame_s, scale, request.gravity_mps2, request.scale_uncertainty, request.fps_uncertainty)


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
