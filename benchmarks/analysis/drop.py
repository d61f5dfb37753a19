"""Drop tests of known truth, measured: sounds and tables of times.

Run ``python -m benchmarks.analysis.drop sounds`` or ``times`` (single drops as microphone recordings or tables of
events: impacts found, confusion matrix, coverage). Truths and seeds are drawn before anything is analysed.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from analysis.drop.laws import Verdict
from analysis.drop.times.impact_chain import Onsets, drops_of
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.onsets import sound_onsets
from analysis.drop.times.outcome import Judged, judge, of_times
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


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("what", choices=["times", "sounds"])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=20261121)
    parser.add_argument("--echo", type=float, default=0.03, help="sounds: loudness of the room's answer to a tap")
    parser.add_argument("--speech", type=float, default=None, help="sounds: rms of somebody talking; else a third talk")
    chosen = parser.parse_args()
    single_drops(chosen.count, chosen.seed, chosen.what == "sounds", chosen.echo, chosen.speech)


if __name__ == "__main__":
    main()
