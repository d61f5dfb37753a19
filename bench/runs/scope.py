"""The scope of one run, and its events on the page: those that were found, and changes by hand.

The scope's time counts lost samples, that of events does not (`daq.recording.reader.timestamps_ns`).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from analysis.flights.events_corrected import given_by_hand
from analysis.flights.table import FlightFlag, Flights
from daq.pyramid import Pyramid
from daq.recording import Recording, open_recording
from daq.recording.notebook import Remarks, made_now, with_event
from daq.recording.opening import open_quickly
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats, Integers


def on_scope(time_s: Floats, gaps: Integers, rate_hz: float) -> Floats:
    """Times of events in the scope; ``gaps`` (n, 2) as of `daq.recording.Recording`."""
    lost = np.concatenate([[0], np.cumsum(gaps[:, 1])])
    return time_s + lost[np.searchsorted(gaps[:, 0], time_s * rate_hz, side="right")] / rate_hz


def on_recording(shown_s: float, gaps: Integers, rate_hz: float) -> float:
    """A time of the scope on the recording's axis; within a gap, its beginning."""
    before = np.concatenate([[0], np.cumsum(gaps[:, 1])])
    k = int(np.searchsorted(gaps[:, 0] + before[:-1], shown_s * rate_hz, side="right"))
    at_s = shown_s - before[k] / rate_hz
    return max(float(at_s), float(gaps[k - 1, 0]) / rate_hz) if k else float(at_s)


def events_of(flights: Flights, gaps: Integers, length_s: float) -> dict[str, list[Any]]:
    """Columns kind, at_s, shown_s and by_hand of all events in order; an impact within a flight is one event."""
    rate_hz, heard = flights.plate.rate_hz, flights.has(FlightFlag.ACCELEROMETER)
    pause = np.append(flights.takeoff_s[1:], np.inf) - flights.landing_s
    impact = heard & np.append(heard[1:], False) & (pause * rate_hz < 1.0)
    takes_off = ~np.append(False, impact[:-1]) & (flights.takeoff_s > 0.0)
    lands = flights.landing_s < length_s
    kinds = np.where(impact, "impact", "landing")[lands]
    at_s = np.concatenate([flights.takeoff_s[takes_off], flights.landing_s[lands]])
    kind = np.concatenate([np.full(int(takes_off.sum()), "takeoff"), kinds])
    order = np.argsort(at_s, kind="stable")
    return {
        "kind": kind[order].tolist(), "at_s": np.round(at_s[order], 9).tolist(),
        "shown_s": np.round(on_scope(at_s[order], gaps, rate_hz), 9).tolist(),
        "by_hand": given_by_hand(at_s[order], flights.edges.by_hand).tolist(),
    }  # fmt: skip


def change_of(answer: dict[str, Any], recorded_s: Callable[[float], float]) -> Callable[[Remarks], Remarks]:
    """The change that a page asks for (or an error): ``undo``, or an event's ``kind``, ``was_s``, ``now_shown_s``."""
    if answer.get("undo") is True:
        return lambda now: with_event(now, None)
    was_s, shown_s = (None if answer[key] is None else float(answer[key]) for key in ("was_s", "now_shown_s"))
    change = made_now(answer["kind"], was_s, None if shown_s is None else round(recorded_s(shown_s), 9))
    return lambda now: with_event(now, change)


class Scope:
    """Views of a recording; raises `InputError` where one does not read."""

    def __init__(self, pyramid: Path, recording: Path) -> None:
        self._pyramid, self._file, self._state = Pyramid(pyramid), recording, _state(recording)
        self._lock = threading.Lock()
        self._held: Recording | None = None
        self._later: threading.Timer | None = None
        with self._lock, self._opened() as opened:
            self._setup: Setup = opened.setup
            self._gaps, self._rate_hz = opened.gaps, opened.rate_hz
            place = opened.timestamps_ns
            self._steps = [
                {"start_s": float(place(int(s["first_sample"]), int(s["first_sample"]) + 1)[0]) * 1e-9,
                 "settle_s": float(s["settle_samples"]) / opened.rate_hz,
                 "length_s": float(s["n_samples"]) / opened.rate_hz, "gamma": s["gamma"]}
                for s in opened.steps[:2000] if 0 <= s["first_sample"] < opened.n_samples
            ]  # fmt: skip

    def is_current(self) -> bool:
        """Whether recording and pyramid are still those that were opened."""
        return _state(self._file) == self._state and self._pyramid.path.exists()

    def facts(self) -> dict[str, Any]:
        """Length, channels with their scale to SI, and steps."""
        layout, channels = self._pyramid.layout, self._setup.channels.recorded()
        si = {name: scale for name, channel in channels.items() if (scale := channel.scale()) is not None}
        return {
            "duration_s": self._pyramid.duration_s,
            "rate_hz": layout.rate_hz,
            "n_samples": layout.n_samples,
            "channels": [
                {"name": name, "si_per_volt": si[name].per_volt if name in si else None,
                 "si_unit": si[name].unit if name in si else None, "zero_v": si[name].zero_v if name in si else 0.0}
                for name, *_ in layout.channels
            ],
            "steps": self._steps,
        }  # fmt: skip

    def view(self, start_s: float, stop_s: float, width: int) -> dict[str, Any]:
        """A stretch of the signals; NaN where a column has no sample (raises InputError)."""
        with self._lock:
            seen = self._pyramid.view(start_s, stop_s, width, self._opened)
        samples = seen.samples_per_point == 1.0
        channels = {
            name: {"low": _short(low)} if samples else {"low": _short(low), "high": _short(seen.high_v[name])}
            for name, low in seen.low_v.items()
        }
        return {
            "start_s": seen.start_s,
            "stop_s": seen.stop_s,
            "samples_per_point": seen.samples_per_point,
            "time_s": np.round(seen.time_s, 9),
            "channels": channels,
            "lost": seen.lost,
        }

    def recorded_s(self, shown_s: float) -> float:
        """A time of the scope on the recording's axis, on which lost samples take no time."""
        return on_recording(shown_s, self._gaps, self._rate_hz)

    def close(self) -> None:
        """Let go of the recording."""
        with self._lock:
            if self._later is not None:
                self._later.cancel()
            if self._held is not None:
                self._held.close()
            self._held = self._later = None

    def _opened(self) -> AbstractContextManager[Recording]:
        """The recording, held open while one zooms: opening it takes longer than reading a stretch."""
        if self._later is not None:
            self._later.cancel()
        if self._held is None:  # as its pyramid was made of it: quickly where it is whole
            self._held = open_quickly(self._file)
            if self._held is not None and self._held.n_samples != self._pyramid.layout.n_samples:
                self._held.close()
                self._held = None
            self._held = self._held or open_recording(self._file)
        self._later = threading.Timer(60.0, self.close)
        self._later.daemon = True
        self._later.start()
        return nullcontext(self._held)


def _state(path: Path) -> tuple[int, int]:
    try:
        state = path.stat()
    except OSError as error:
        raise InputError(f"{path.name}: is no longer there") from error
    return state.st_size, state.st_mtime_ns


def _short(values: Floats) -> Floats:
    """Numbers of seven digits, counted from the largest."""
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    return np.round(values, 6 - math.floor(math.log10(largest)) if largest > 0.0 else 0)
