"""Impacts of a path corrected by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from analysis.drop.corrections import NOTHING, Corrections
from analysis.drop.film.track import Clip, flights_of, near_impacts
from analysis.drop.load import Known, Path2D, load_all

G, E = 9.80665, 0.8


def _table(path: Path) -> Path:
    """A fall of 0.4 m and three bounces, 200 positions a second."""
    times, impacts, speed = np.arange(0.0, 1.55, 0.005), [float(np.sqrt(0.8 / G))], E * np.sqrt(0.8 * G)
    height = 0.4 - 0.5 * G * times**2
    for _ in range(4):
        since = times - impacts[-1]
        height = np.where(since >= 0.0, speed * since - 0.5 * G * since**2, height)
        impacts.append(impacts[-1] + 2.0 * speed / G)
        speed *= E
    rows = "".join(f"{t:.4f},{h:.6f}\n" for t, h in zip(times, height, strict=True) if t < impacts[-1])
    path.write_text("t (s),y (m)\n" + rows, encoding="utf-8")
    return path


def _clip(file: Path, corrections: Corrections = NOTHING) -> Clip:
    item = load_all(file, None, corrections)[0]
    assert isinstance(item, Path2D)
    return item.clip


def test_an_impact_taken_away_joins_what_it_parted(tmp_path: Path) -> None:
    """The flights on both sides of it are no flight any more; an ignored time elsewhere takes one position."""
    file = _table(tmp_path / "path.csv")
    whole = _clip(file)
    orders = [flight.order for flight in flights_of(whole)]
    assert orders == [0, 1, 2, 3, 4]
    second = float(np.sqrt(0.8 / G)) * (1.0 + 2.0 * E)
    assert near_impacts(whole, np.array([second, 0.1]) / 0.005).tolist() == [True, False]
    less = _clip(file, Corrections(ignore_s=(second,)))
    assert len(less.frame) == len(whole.frame) and len(flights_of(less)) == 3
    spot = _clip(file, Corrections(ignore_s=(0.1,)))
    assert len(spot.frame) == len(whole.frame) - 1 and len(flights_of(spot)) == 5


def test_an_impact_added_parts_a_flight(tmp_path: Path) -> None:
    """What was one flight is two, and the impact added where one was taken away gives the same flights."""
    file = _table(tmp_path / "path.csv")
    assert len(flights_of(_clip(file, Corrections(add_s=(0.55,))))) == 6
    second = float(np.sqrt(0.8 / G)) * (1.0 + 2.0 * E)
    moved = flights_of(_clip(file, Corrections(ignore_s=(second,), add_s=(second,))))
    assert [len(f.frame) for f in moved] == [len(f.frame) for f in flights_of(_clip(file))]


def test_what_is_slow_is_made_once(tmp_path: Path) -> None:
    """A file that changes is read anew; one that does not is not."""
    file = tmp_path / "x"
    file.write_text("1", encoding="utf-8")
    known, made = Known(), []
    for _ in range(2):
        known.made(file, "what", lambda: made.append(1))
    file.write_text("12", encoding="utf-8")
    known.made(file, "what", lambda: made.append(2))
    assert made == [1, 2]
    assert replace(Corrections(), add_s=(1.0,)) != Corrections()
