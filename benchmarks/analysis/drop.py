"""Drop tests, measured: synthetic films of known truth, and the recordings made by others.

Run ``python -m benchmarks.analysis.drop films`` (fifty films through a codec: bias, coverage, accuracy), ``sounds`` or
``times`` (single drops as microphone recordings or tables of events: impacts found, confusion matrix, coverage) or
``real FOLDER`` (the table of docs/results/drop.md). Truths and seeds are drawn before anything is
analysed, and every film counts.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from analysis.drop.film.camera_fit import fit_camera
from analysis.drop.film.flights import Clip, flights_of
from analysis.drop.film.outcome import Units, of_camera
from analysis.drop.film.tracking import track_film
from analysis.drop.laws.choice import Verdict, choose
from analysis.drop.load import Path2D, load
from analysis.drop.times.impact_chain import Onsets, drops_of
from analysis.drop.times.model_selection import Judged, judge
from analysis.drop.times.one_ahead import Drop
from analysis.drop.times.onsets import sound_onsets
from analysis.drop.times.outcome import of_times
from daq.setup.errors import InputError
from kernels.arrays import Floats

G = 9.80665


def synthetic() -> ModuleType:
    """The tests' camera."""
    here = Path(__file__).parents[2] / "tests" / "analysis" / "drop" / "synthetic.py"
    spec = importlib.util.spec_from_file_location("drop_synthetic", here)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(here)
    module = importlib.util.module_from_spec(spec)
    sys.modules["drop_synthetic"] = module
    spec.loader.exec_module(module)
    return module


def films(count: int, seed: int) -> None:
    """Fifty drops filmed: a fifth at the paper's conditions, a fifth without friction, the rest over a range of truth.

    The camera is tilted by as much as makes the scale differ by 1 % from the bottom of the picture to its top.
    """
    cam = synthetic()
    rows: list[tuple[float, ...]] = []
    names: Counter[str] = Counter()
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        paper = k % 5 == 0
        e0, f = (0.514, 0.3) if paper else (rng.uniform(0.4, 0.75), rng.uniform(0.05, 0.4))
        f = 0.0 if k % 5 == 1 else f
        fps = 1000.0 if paper else rng.uniform(350.0, 700.0)
        truth = cam.Truth(e0=e0, friction=f, height_m=0.06 if paper else rng.uniform(0.04, 0.065))
        look = {"noise": rng.uniform(1, 4), "flicker": rng.uniform(0, 0.1), "exposure": rng.uniform(0.2, 0.8)}
        camera = cam.Camera(fps=fps, perspective=rng.uniform(-0.01, 0.01), **look)
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / "drop.avi"
            cam.film(target, truth, camera, 0.38, rng)
            try:
                track = track_film(target).track
                flights_of(Clip("x", track.clock, track.height, track.acceleration))
            except InputError as error:
                names["refused"] += 1
                print(f"{k:3d} refused: {error}", flush=True)
                continue
        fit = fit_camera([Clip("x", track.clock, track.height, track.acceleration)], np.random.default_rng(k))
        name = choose(fit.candidates)[0]
        names[name] += 1
        law = next(r.law for r in fit.candidates if r.model.name == "coulomb_friction")
        friction, spread = float(fit.shapes["friction"].values[1]), float(fit.values["friction"][:, 1].std())
        rows.append((paper, law.theta[0] - e0, law.half_width[0] / 1.96, friction - f, spread))
        off, sigma = rows[-1][1:3]
        print(f"{k:3d} {name} e {off:+.4f} +- {sigma:.4f} f {friction - f:+.4f} +- {spread:.4f}", flush=True)
    _summary(np.array(rows, dtype=float), names)


def _summary(table: np.ndarray, names: Counter[str]) -> None:
    print("chosen:", dict(names))
    for label, column in (("restitution", 1), ("friction", 3)):
        off, sigma = table[:, column], table[:, column + 1]
        inside = np.abs(off) < 1.96 * sigma
        paper = table[:, 0] > 0
        print(
            f"{label}: bias {off.mean():+.5f} = {np.mean(off / sigma):+.2f} sigma, rms {off.std():.5f}, "
            f"95 % interval covers {inside.sum()} of {len(off)}; "
            f"at the paper's conditions the worst is off by {np.abs(off[paper]).max():.4f}"
        )


CAUSES = ("constant_restitution", "speed_dependent_restitution", "quadratic_drag", "coulomb_friction")


def single_drops(count: int, seed: int, heard: bool, echo: float = 0.03, speech: float | None = None) -> None:
    """Single drops of random truth, as sound or as a table of events: impacts, verdict, and coverage.

    Every fourth has nothing but a restitution, one that falls with speed, drag, or friction. Friction cannot be seen in
    times alone: there "in the tie set" is the right answer.
    """
    cam = synthetic()
    matrix: Counter[tuple[str, str]] = Counter()
    tally: Counter[str] = Counter()
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        truth = _random_truth(cam, CAUSES[k % 4], rng)
        if heard:
            events, impacts, due = _heard(cam, truth, rng, echo, speech)
        else:
            events, impacts, due = _tabled(cam, truth, rng)
        tally["due"] += int(due.sum())
        try:
            found = drops_of(events, f"drop {k}")
            drop = Drop("x", max(found, key=lambda bounces: len(bounces.impacts_s)))
        except InputError:
            matrix[CAUSES[k % 4], "refused"] += 1
            continue
        off = np.abs(drop.bounces.impacts_s[:, None] - impacts[None])
        tally["found"] += int((off.min(axis=0) < 1e-3 + 4e-3 * (not heard))[due].sum())
        tally["false"] += int((off.min(axis=1) > 1e-3 + 4e-3 * (not heard)).sum())
        verdict = judge([drop], G, rng)
        _count(CAUSES[k % 4], truth, verdict, of_times([drop], verdict, G, [None], rng).payload, matrix, tally)
    _show_matrix(matrix, tally)


def _random_truth(cam: ModuleType, cause: str, rng: np.random.Generator) -> Any:
    added = {
        "speed_dependent_restitution": {"e1_s_per_m": rng.uniform(0.01, 0.06)},
        "quadratic_drag": {"drag_per_m": rng.uniform(0.04, 0.3)},
        "coulomb_friction": {"friction": rng.uniform(0.03, 0.3)},
    }.get(cause, {})
    scatter = float(rng.choice([0.0, 0.002, 0.006]))
    return cam.Truth(height_m=rng.uniform(0.15, 1.0), e0=rng.uniform(0.6, 0.94), hold_s=0.0, scatter=scatter, **added)


def _heard(
    cam: ModuleType, truth: Any, rng: np.random.Generator, echo: float = 0.03, speech: float | None = None
) -> tuple[Onsets | Floats, Floats, Floats]:
    """Events in a microphone recording, with noise, hum, talk, clicks and unheard impacts."""
    room = cam.Room(
        rate_hz=float(rng.choice([16000, 22050, 44100, 48000, 96000])),
        noise=10 ** rng.uniform(-4, -2.2),
        hum=float(rng.choice([0.0, 0.02])),
        speech=float(rng.choice([0.0, 0.0, 0.01])),
        clicks=int(rng.integers(0, 3)),
        unheard=int(rng.integers(0, 2)),
        gain=float(rng.choice([0.1, 0.5, 2.0])),
        channels=int(rng.integers(1, 3)),
        echo=echo,
    )
    if speech is not None:
        room = replace(room, speech=speech)
    samples, impacts, loud = cam.sound(truth, room, rng)
    apart = np.diff(impacts, prepend=impacts[0] - 1.0) > 0.03
    due = apart & (loud > 8.0 * np.hypot(room.noise, room.speech))
    return sound_onsets(samples, room.rate_hz, "x"), impacts, due


def _tabled(cam: ModuleType, truth: Any, rng: np.random.Generator) -> tuple[Onsets | Floats, Floats, Floats]:
    """Events as a phone lists them: impacts with jitter, one perhaps missing, one perhaps false, none under 0.1 s."""
    _, impacts = cam.path(truth, np.array([20.0]), 1e-4, settle_mps=0.05, rng=rng)
    impacts = impacts[np.diff(impacts, append=impacts[-1]) > 0.1]
    due = np.ones(len(impacts), dtype=bool)
    due[rng.integers(1, len(impacts))] = rng.random() < 0.5
    events = impacts + 10 ** rng.uniform(-5, -3) * rng.standard_normal(len(impacts))
    false = rng.uniform(impacts[0] - 1.0, impacts[-1], int(rng.integers(0, 2)))
    return np.concatenate([events[due], false]), impacts, due


def _count(
    cause: str, truth: Any, verdict: Verdict[Judged], payload: dict[str, Any], matrix: Counter[Any], tally: Counter[str]
) -> None:
    tied = cause in verdict.tie_set and verdict.chosen != cause
    matrix[cause, verdict.chosen + (" (truth tied)" if tied else "")] += 1
    shown = "constant_restitution" if cause == "coulomb_friction" else cause
    model = next((m for m in payload["models"] if m["name"] == shown), None)
    lost = np.sqrt((1.0 - truth.friction) / (1.0 + truth.friction))
    wanted = {"e0": truth.e0 * lost, "e1_s_per_m": truth.e1_s_per_m, "k_per_m": truth.drag_per_m}
    for name, entry in (model["parameters"] if model else {}).items():
        tally[f"{name} of the true model"] += 1
        tally[f"{name} of the true model, inside"] += bool(entry["low"] <= wanted[name] <= entry["high"])
    height = payload["drop_height_m"]
    if height["low"] is not None and cause != "coulomb_friction":
        tally["height"] += 1
        tally["height, inside"] += bool(height["low"] <= truth.height_m <= height["high"])


def _show_matrix(matrix: Counter[tuple[str, str]], tally: Counter[str]) -> None:
    columns = sorted({column for _, column in matrix})
    print("| truth | " + " | ".join(columns) + " |\n|" + "---|" * (len(columns) + 1))
    for cause in CAUSES:
        print(f"| {cause} | " + " | ".join(str(matrix[cause, column] or "") for column in columns) + " |")
    print(", ".join(f"{name} {number}" for name, number in tally.items()))


def real(folder: Path, only: str = "") -> None:
    """A row for each kind of recording, as Markdown."""
    print("| recording | impacts | chosen (ties) | parameters | held-out before, after (ms) | drop height (m) |")
    print("|---|---|---|---|---|---|")
    tennis = folder / "phyphox/pingpong_ball"
    groups = {f"pingpong {h} cm (6)": sorted(tennis.glob(f"*,{h}cm*")) for h in (8, 10, 15, 18, 30)}
    groups["pingpong, all (30)"] = sorted(tennis.iterdir())
    for h in (25, 35, 45, 55, 65):
        groups[f"blue ball {h} cm"] = sorted((folder / "phyphox/blue_ball").glob(f"*{h}*xls"))
    groups["blue ball, all (30)"] = sorted((folder / "phyphox/blue_ball").iterdir())
    groups["sound (1)"] = [folder / "audio/alessia_rimbalzi.wav"]
    groups["film, drop (1)"] = [folder / "video/arza_bounceAmeen.avi"]
    for sheets in (1, 10, 50, 55, 100, 140, 300):
        groups[f"A4, {sheets} sheets"] = sorted((folder / "tracked/A4").glob(f"?-{sheets}-M.csv"))
    for n in (2, 4):
        groups[f"HT-{n}"] = sorted((folder / "tracked/HT").glob(f"HT-{n}-*.csv"))
    for name in ("18-7_Results_100_1018,5hPa", "18-7_Results_100_410mbar", "22-7_Results_5_30mbar"):
        groups[f"vacuum {name}"] = [folder / f"tracked/vacuum/{name}.csv"]
    for label, files in groups.items():
        if only not in label:
            continue
        try:
            _row(label, files)
        except InputError as error:
            print(f"| {label} | {error} |||||")


def _row(label: str, files: list[Path]) -> None:
    loaded = [load(file) for file in files]
    rng = np.random.default_rng(1)
    if isinstance(loaded[0], Path2D):
        fit = fit_camera([item.clip for item in loaded], rng)
        frame_s = loaded[0].frame_s or (None if "vacuum" in label else 1 / 200)
        payload = of_camera([label], fit, Units(frame_s, None, G), rng).payload
        count = len(payload["impacts_frames"])
        f, list_e = payload["friction"], [b["restitution"]["value"] for b in payload["restitution"] if b["file"] == 0]
        more = f"; e by bounce {', '.join(f'{e:.3f}' for e in list_e)}"
        more += f"; f {f['value']:.3f} ({f['low']:.3f}, {f['high']:.3f})"
    else:
        payload = of_times(loaded, judge(loaded, G, rng), G, [None] * len(loaded), rng).payload
        count, more = len(payload["impacts_s"]), ""
    model = next(m for m in payload["models"] if m["name"] == payload["best"])
    shown = [f"{k} {v['value']:.4f} ({_n(v['low'], 4)}, {_n(v['high'], 4)})" for k, v in model["parameters"].items()]
    values = ", ".join(shown)
    ties = ", ".join(payload["tie_set"][1:]) or "none"
    before, height = payload["models"][0]["held_out_rms_ms"], payload["drop_height_m"]
    tall = f"{_n(height['value'], 3)} ({_n(height['low'], 3)}, {_n(height['high'], 3)})"
    after = model["held_out_rms_ms"]
    errors = f"{_n(before, 2)}, {_n(after, 2)}"
    print(f"| {label} | {count} | {payload['chosen']} ({ties}) | {values}{more} | {errors} | {tall} |", flush=True)


def _n(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("what", choices=["films", "times", "sounds", "real"])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("../shared/data"))
    parser.add_argument("--only", default="", help="rows whose name holds this text")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--echo", type=float, default=0.03, help="sounds: loudness of the room's answer to a tap")
    parser.add_argument("--speech", type=float, default=None, help="sounds: rms of somebody talking; else a third talk")
    chosen = parser.parse_args()
    if chosen.what == "films":
        films(chosen.count, chosen.seed)
    elif chosen.what in ("times", "sounds"):
        single_drops(chosen.count, chosen.seed, chosen.what == "sounds", chosen.echo, chosen.speech)
    else:
        real(chosen.folder, chosen.only)


if __name__ == "__main__":
    main()
