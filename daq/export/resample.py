"""A recording at another rate, made when asked: for readers that want 20 kHz of a card that ran at 48.

The recording stays as it is; this is a view that reads like one. Every channel goes through soxr's
linear-phase filter, so nothing is delayed; what lies above half the new rate is gone, and edges ring.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.recording.reader import Recording
from daq.setup.errors import InputError
from kernels.arrays import Floats, Integers


class Resampled:
    """``recording`` at ``rate_hz``, in volts (raises InputError: no ratio of small numbers, or no soxr)."""

    def __init__(self, recording: Recording, rate_hz: float) -> None:
        try:
            import soxr
        except ImportError as error:
            raise InputError("another rate needs the package soxr: pip install soxr") from error
        ratio = Fraction(repr(rate_hz)) / Fraction(repr(recording.rate_hz)) if rate_hz > 0 else Fraction(0)
        # a piece needs a whole turn of the ratio on both sides: of larger numbers, more than 100 000 samples
        if ratio == 0 or max(ratio.numerator, ratio.denominator) > 100_000:
            raise InputError(
                f"{recording.path}: {recording.rate_hz:g} samples a second cannot be brought to {rate_hz:g}; "
                "wanted a rate above 0, and a ratio of whole numbers up to 100000"
            )
        self._resample = soxr.resample
        self._recording, self._up, self._down = recording, ratio.numerator, ratio.denominator
        self.rate_hz = float(rate_hz)
        self.channels = recording.channels
        self.n_samples = -(-recording.n_samples * self._up // self._down)
        self.stored = recording.stored

    @property
    def steps(self) -> NDArray[np.void]:
        """The step table, counted in samples of the new rate."""
        steps = np.array(self._recording.steps)
        for name in ("first_sample", "n_samples", "settle_samples", "fade_samples"):
            steps[name] = np.rint(steps[name] * (self._up / self._down))
        return steps

    @property
    def gaps(self) -> Integers:
        """Lost samples as the recording's, int64 ``(n, 2)``, counted in samples of the new rate."""
        return np.asarray(np.rint(self._recording.gaps * (self._up / self._down)), np.int64)

    def scale(self, channel: str) -> tuple[float, float]:
        """As the recording's."""
        return self._recording.scale(channel)

    def codes(self, channel: str, start: int, stop: int) -> NDArray[Any]:
        """Volts: what was filtered is no code of the converter any more."""
        return self.read_v(channel, start, stop)

    def read_v(self, channel: str, start: int, stop: int) -> Floats:
        """Samples ``start`` to ``stop`` of the new rate, volts."""
        stop = min(stop, self.n_samples)
        reach = math.ceil(4000 / self._down)  # in whole turns of the ratio, so that the grid stays where it is
        first = max(0, start // self._up - reach)
        last = -(-stop // self._up) + reach
        # soxr sees samples on both sides, so that pieces join without a seam
        raw = self._recording.read_v(channel, first * self._down, min(last * self._down, self._recording.n_samples))
        out = self._resample(raw, self._recording.rate_hz, self.rate_hz, quality="VHQ")
        return np.asarray(out[start - first * self._up : stop - first * self._up], np.float64)

    def timestamps_ns(self, start: int, stop: int) -> Integers:
        """Times of samples ``start`` to ``stop``; lost samples leave a step, as in the recording."""
        n = self._recording.n_samples
        place = np.arange(start, min(stop, self.n_samples)) * (self._down / self._up)
        first, last = int(place[0]) if len(place) else 0, int(place[-1]) + 2 if len(place) else 0
        known = self._recording.timestamps_ns(first, min(last, n))
        whole = np.minimum(place.astype(np.int64) - first, len(known) - 1)
        parts_ns = np.rint((place - first - whole) * 1e9 / self._recording.rate_hz)
        return np.asarray(known[whole] + parts_ns.astype(np.int64), np.int64)
