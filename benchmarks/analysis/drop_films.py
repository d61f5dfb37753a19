"""Sixty films of drops, by an integrator and a renderer that share nothing with the analysis: accuracy and coverage.

Run ``python -m benchmarks.analysis.drop_films``. Drops are integrated by an adaptive Runge-Kutta method (DOP853) with
events; blocks are polygons seen through a camera that is rolled, tilted and has a lens, filled at eight times the
resolution. Truths and seeds are drawn before anything is analysed, and every film counts. With ``--hard`` the films
are, in turn: a tall block at 30 frames a second, a strong lens, repeated frames, a camera held in the hand, a rolling
shutter.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.integrate import solve_ivp

from analysis.drop.film.camera_fit import fit_camera
from analysis.drop.film.outcome import Units, of_camera
from analysis.drop.load import Path2D, load_all
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats

G = 9.80665

FINE = 8  # sub-pixels a pixel


@dataclass(frozen=True)
class Scene:
    """One film: physics in SI, camera in pixels."""

    block_m: float
    width_m: float
    drop_m: float
    e: float
    friction: float
    fps: float
    hold_s: float
    rest_s: float
    contrast: float
    exposure: float
    defocus_px: float
    noise: float
    roll_deg: float
    tilt: float
    lens: float
    rod: bool
    codec: str
    quality: int
    repeat_every: int = 0  # every so many-th frame shows the one before; 0: none
    shake_px: float = 0.0
    shutter: float = 0.0  # part of a frame's time that the rolling shutter takes from the top to the bottom row


def draw_scene(seed: int, k: int) -> Scene:
    """A scene at random; every fifth has the 20 mm block of the published experiment."""
    rng = np.random.default_rng([seed, k])
    drop = float(rng.uniform(0.04, 0.15))
    block = 0.02 if k % 5 == 0 else float(np.exp(rng.uniform(np.log(0.003), np.log(0.02))))
    return Scene(
        block_m=block,
        width_m=float(rng.uniform(0.006, 0.02)),
        drop_m=drop,
        e=float(rng.uniform(0.45, 0.8)),
        friction=0.0 if k % 4 == 1 else float(rng.uniform(0.03, 0.35)),
        fps=float(np.exp(rng.uniform(np.log(200.0), np.log(1000.0)))),
        hold_s=float(rng.uniform(0.0, 0.1)),
        rest_s=float(rng.uniform(0.0, 0.3)),
        contrast=float(np.exp(rng.uniform(np.log(25.0), np.log(130.0)))),
        exposure=float(rng.uniform(0.1, 0.9)),
        defocus_px=float(rng.uniform(0.3, 1.8)),
        noise=float(rng.uniform(0.5, 4.0)),
        roll_deg=float(rng.uniform(-12.0, 12.0)) if k % 3 == 2 else 0.0,
        tilt=float(rng.uniform(-0.01, 0.01)),
        lens=float(rng.uniform(-0.01, 0.01)),
        rod=bool(rng.random() < 0.5),
        codec="mp4v" if k % 2 else "MJPG",
        quality=int(rng.integers(60, 96)),
    )


HARD = ("tall block at 30/s", "strong lens", "repeated frames", "hand-held", "rolling shutter")


def hard_scene(seed: int, k: int) -> Scene:
    """A scene of the kind ``HARD[k % 5]``."""
    rng = np.random.default_rng([seed, k, 2])
    fps = float(rng.uniform(200.0, 300.0))
    scene = replace(draw_scene(seed, 5 * k + 1), fps=fps, hold_s=0.05, rest_s=0.05, roll_deg=0.0)
    if k % 5 == 0:
        drop = float(rng.uniform(0.3, 0.6))
        return replace(scene, fps=30.0, block_m=0.02, drop_m=drop, friction=float(rng.uniform(0.0, 0.2)), exposure=0.1)
    if k % 5 == 1:
        return replace(scene, lens=float(rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.08)))
    if k % 5 == 2:
        return replace(scene, repeat_every=int(rng.integers(4, 9)))
    if k % 5 == 3:
        return replace(scene, shake_px=float(rng.uniform(1.0, 4.0)))
    return replace(scene, shutter=float(rng.uniform(0.3, 0.9)))


def fall(scene: Scene) -> tuple[Floats, Floats]:
    """Times (fine) and heights of the drop, integrated flight by flight with its turning points as events."""

    def rates(_t: float, s: Floats) -> list[float]:
        return [s[1], -G - np.sign(s[1]) * scene.friction * G]

    def landed(_t: float, s: Floats) -> float:
        return float(s[0])

    def turned(_t: float, s: Floats) -> float:
        return float(s[1])

    landed.terminal, landed.direction = True, -1  # type: ignore[attr-defined]
    turned.terminal, turned.direction = True, -1  # type: ignore[attr-defined]
    now, height, speed = scene.hold_s, scene.drop_m, -1e-12
    times, heights = [np.array([0.0, now])], [np.array([height, height])]
    while True:
        going_up = speed > 0.0
        event = turned if going_up else landed
        run = solve_ivp(rates, (now, now + 2.0), [height, speed], "DOP853", events=event, dense_output=True, rtol=1e-10)
        stop = float(run.t_events[0][0])
        grid = np.linspace(now, stop, 400)
        times.append(grid)
        heights.append(run.sol(grid)[0])
        now = stop
        if going_up:
            height, speed = float(run.sol(stop)[0]), -1e-12
        else:
            height, speed = 1e-12, -scene.e * float(run.sol(stop)[1])
            if speed < 0.03:
                break
    times.append(np.array([now + 1e-9, now + 10.0]))
    heights.append(np.zeros(2))
    return np.concatenate(times), np.maximum(np.concatenate(heights), 0.0)


def film(target: Path, scene: Scene, rng: np.random.Generator) -> tuple[float, Bools]:
    """Render the film; returns metres a pixel along the fall, and which frames show it moving."""
    times, heights = fall(scene)
    seconds = float(times[-1]) - 10.0 + 0.02 + scene.rest_s
    tall = scene.drop_m + scene.block_m
    rows = 560
    per_m = 0.8 * rows / tall / (1.0 + abs(np.sin(np.radians(scene.roll_deg))) * 0.2)
    columns = max(240, int(3.0 * scene.width_m * per_m) // 2 * 2)
    camera = _camera(scene, rows, columns, per_m, tall)
    still = 150.0 + cv2.GaussianBlur(rng.normal(0.0, 20.0, (rows, columns)), (0, 0), 4.0)
    floor = _polygon(camera, -0.2, 0.2, -0.05, 0.0)
    _paint(still, floor, 100.0)
    rod = _polygon(camera, -0.0008, 0.0008, -0.01, 0.5)
    shade = 150.0 - scene.contrast
    writer = cv2.VideoWriter(str(target), cv2.VideoWriter_fourcc(*scene.codec), 30.0, (columns, rows))
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, scene.quality)
    shaking = cv2.GaussianBlur(rng.normal(0.0, 1.0, (int(seconds * scene.fps) + 1, 2)), (1, 31), 0.0, sigmaY=8.0)
    shaking *= scene.shake_px / max(float(shaking.std()), 1e-9)
    shown = np.zeros((rows, columns, 3), dtype=np.uint8)
    for k in range(int(seconds * scene.fps)):
        if scene.repeat_every and k % scene.repeat_every == scene.repeat_every - 1:
            writer.write(shown)
            continue
        row = camera(np.array([[0.0, float(np.interp(k / scene.fps, times, heights)) + 0.5 * scene.block_m]]))[0, 1]
        late = scene.shutter * row / rows  # the rows that show the block are read then
        instants = (k + late + (np.arange(6) + 0.5) / 6 * scene.exposure) / scene.fps
        frames = []
        for height in np.interp(instants, times, heights):
            picture = still.copy()
            left, right = -0.5 * scene.width_m, 0.5 * scene.width_m
            _paint(picture, _polygon(camera, left, right, height, height + scene.block_m), shade)
            stripe = (height + 0.3 * scene.block_m, height + 0.45 * scene.block_m)
            _paint(picture, _polygon(camera, left, right, *stripe), shade + 0.25 * scene.contrast)
            frames.append(picture)
        picture = np.mean(frames, axis=0)
        if scene.rod:
            _paint(picture, rod, 110.0)
        picture = cv2.GaussianBlur(picture, (0, 0), scene.defocus_px) + rng.normal(0.0, scene.noise, picture.shape)
        if scene.shake_px:
            move = np.array([[1.0, 0.0, shaking[k, 0]], [0.0, 1.0, shaking[k, 1]]])
            size = (columns, rows)
            picture = cv2.warpAffine(picture, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        shown = cv2.cvtColor(np.clip(picture, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)
        writer.write(shown)
    writer.release()
    ends = camera(np.array([[0.0, 0.5 * scene.block_m], [0.0, scene.drop_m + 0.5 * scene.block_m]]))
    return scene.drop_m / float(np.linalg.norm(ends[1] - ends[0])), np.empty(0, dtype=bool)


def _camera(scene: Scene, rows: int, columns: int, per_m: float, tall: float):  # type: ignore[no-untyped-def]
    """Map from metres (across, up) to pixels: tilt, roll, and one term of a lens."""
    angle = np.radians(scene.roll_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def see(points: Floats) -> Floats:
        centred = (points - np.array([0.0, 0.5 * tall])) * per_m
        centred = centred / (1.0 + scene.tilt * centred[:, 1:] / (0.5 * rows))
        centred = centred @ turn.T
        radius = np.linalg.norm(centred, axis=1, keepdims=True) / (0.5 * rows)
        centred = centred * (1.0 + scene.lens * radius**2)
        return np.asarray(np.array([0.5 * columns, 0.47 * rows]) + centred * np.array([1.0, -1.0]))

    return see


def _polygon(camera, left: float, right: float, low: float, high: float) -> Floats:  # type: ignore[no-untyped-def]
    """A rectangle's outline in pixels, its sides cut into pieces, for the lens bends them."""
    s = np.linspace(0.0, 1.0, 9)[:-1]
    corners = np.array([[left, low], [right, low], [right, high], [left, high]])
    sides = [a + s[:, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.asarray(camera(np.concatenate(sides)))


def _paint(picture: Floats, outline: Floats, shade: float) -> None:
    """Fill a polygon, each pixel by the part of it that is covered; pixel centres are at whole numbers."""
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - 1, 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 2, np.array(picture.shape[::-1]))
    if np.any(high <= low):
        return
    size = high - low
    fine = np.zeros((size[1] * FINE, size[0] * FINE), dtype=np.uint8)
    # a fine pixel's centre at (i + 1/2) / FINE - 1/2 of the coarse grid
    points = np.round(((outline - low + 0.5) * FINE - 0.5) * 256).astype(np.int32)
    cv2.fillPoly(fine, [points], 255, shift=8)
    cover = cv2.resize(fine, (int(size[0]), int(size[1])), interpolation=cv2.INTER_AREA) / 255.0
    part = picture[low[1] : high[1], low[0] : high[0]]
    part += cover * (shade - part)


def measure(scene: Scene, seed: int, k: int) -> dict[str, tuple[float, float, float]] | str:
    """Truth, value and half interval of e, friction and g; or why the film was refused."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / ("drop.mp4" if scene.codec == "mp4v" else "drop.avi")
        scale, _ = film(target, scene, np.random.default_rng([seed, k, 1]))
        try:
            found = load_all(target)[0]
            if not isinstance(found, Path2D):
                return "no film"
            fit = fit_camera([found.clip], np.random.default_rng(k))
            result = of_camera(["film"], fit, Units(1.0 / scene.fps, scale, G), np.random.default_rng(k)).payload
        except InputError as error:
            return f"refused: {error}"
    model = next(m for m in result["models"] if m["name"] == ("coulomb_friction" if scene.friction else result["best"]))
    e, f, g = model["parameters"]["e0"], result["friction"], result["g_mps2"]
    out = {
        name: (truth, entry["value"], 0.5 * (entry["high"] - entry["low"]))
        for name, truth, entry in (("e", scene.e, e), ("f", scene.friction, f), ("g", G, g))
    }
    out["chosen"] = result["chosen"]
    out["because"] = "; ".join(result["unexplained_because"])
    return out


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=20261122)
    parser.add_argument("--hard", action="store_true", help="films of the hard kinds")
    parser.add_argument("--only", type=int, nargs="*", default=None)
    asked = parser.parse_args()
    offs: dict[str, list[tuple[float, float]]] = {"e": [], "f": [], "g": []}
    names: Counter[str] = Counter()
    for k in asked.only if asked.only is not None else range(asked.count):
        scene = hard_scene(asked.seed, k) if asked.hard else draw_scene(asked.seed, k)
        found = measure(scene, asked.seed, k)
        short = (
            f"{k:3d} block {1e3 * scene.block_m:4.1f} drop {1e3 * scene.drop_m:5.1f} mm {scene.fps:5.0f}/s "
            f"contrast {scene.contrast:4.0f} roll {scene.roll_deg:+5.1f}"
        ) + (f" ({HARD[k % 5]})" if asked.hard else "")
        if isinstance(found, str):
            names["refused"] += 1
            print(short, found[:150], flush=True)
            continue
        names[str(found["chosen"])] += 1
        for name, pairs in offs.items():
            truth, value, half = found[name]
            pairs.append((value - truth, half))
        words = ", ".join(f"{name} {pairs[-1][0]:+.4f} +- {pairs[-1][1]:.4f}" for name, pairs in offs.items())
        print(short, words, found["chosen"], found["because"][:90], flush=True)
    print(dict(names))
    for name, pairs in offs.items():
        table = np.array(pairs).reshape(-1, 2)
        inside = np.abs(table[:, 0]) <= table[:, 1]
        print(
            f"{name}: {inside.sum()} of {len(table)} inside, rms {table[:, 0].std():.4f}, "
            f"median half interval {np.median(table[:, 1]):.4f}, worst {np.abs(table[:, 0]).max():.4f}"
        )


if __name__ == "__main__":
    main()
