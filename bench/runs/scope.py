"""The scope of one run: its pyramid, and the recording where single samples are asked for."""

from __future__ import annotations

import math
import threading
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from bench.runs.events import on_recording
from daq.pyramid import Pyramid
from daq.recording import Recording, open_recording
from daq.recording.opening import open_quickly
from daq.setup.errors import InputError
from daq.setup.setup import Setup

Floats = np.ndarray[Any, np.dtype[np.float64]]


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
