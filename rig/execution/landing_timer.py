"""Times of a ball's landings by the accelerometer, as the samples come, to a small part of a sample.

A ball that is launched as it lands touches the plate for less than a sample: its impact's ringing tells the landing.
The waveform is learnt from the landings themselves, each laid over their mean. So times have a common offset, which
whoever uses them must estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kernels.arrays import Bools, Floats


@dataclass(frozen=True)
class Landing:
    """One landing: sample of the stretch it was looked for in, as a decimal, and standard uncertainty in samples."""

    place: float
    uncertainty: float


class LandingTimer:
    """Find and time the one landing in a short stretch of the accelerometer."""

    def __init__(self, rate_hz: float) -> None:
        # the waveform from before the impact until most of the ringing is over
        self._lead, self.tail = round(0.8e-3 * rate_hz), round(2.6e-3 * rate_hz)
        n = self._lead + self.tail
        # constant to cubic: the plate's own motion over so short a time
        self._slow = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n), 4))[0]
        self._window = np.minimum(1.0, np.minimum(np.arange(n) + 0.5, np.arange(n)[::-1] + 0.5) / (0.2 * n))
        self._turns = np.fft.rfftfreq(n)
        self._mean = np.zeros(n)
        self._count = 0

    def find(self, acceleration_mps2: Floats, quiet: Bools) -> Landing | None:
        """The landing in a stretch (n,); None where there is none, or none like those before.

        ``quiet`` (n,) marks samples without ringing, as `rig.execution.plate_monitor` judges: the first landing is
        found by it.
        """
        n = len(self._mean)
        stretches = np.lib.stride_tricks.sliding_window_view(acceleration_mps2, n)
        if not self._count:
            loud = np.flatnonzero(~quiet)
            if not loud.size or not self._lead <= loud[0] <= len(quiet) - self.tail:
                return None
            at = int(loud[0]) - self._lead
            self._learn(self._quick(stretches[at]))
            return Landing(float(loud[0]), 0.5)
        mean = self._quick(self._mean)
        # matched filter: in white noise the largest correlation is the likeliest place
        at = int(np.argmax(stretches @ mean))
        shown = self._quick(stretches[at])
        alike = float(shown @ mean) / max(float(np.linalg.norm(shown) * np.linalg.norm(mean)), 1e-300)
        size = float(shown @ mean) / float(mean @ mean)
        # another waveform, or a far weaker impact, is another landing than the one expected
        if alike < 0.7 or size < 0.25:
            return None
        shift, sigma = self._placed(stretches[at])
        # the start was the best whole sample: a fit that leaves it has found another ring of the waveform
        if abs(shift) > 2.0:
            return None
        # later landings would not better the mean
        if self._count < 64:
            self._learn(self._shifted(shown / size, -shift))
        return Landing(at + self._lead + shift, sigma)

    def _quick(self, x: Floats) -> Floats:
        """A stretch (n,) less the plate's motion."""
        return np.asarray(x - self._slow @ (self._slow.T @ x))

    def _shifted(self, x: Floats, samples: float) -> Floats:
        """A waveform (n,) later by ``samples``."""
        # a shift by a part of a sample is a phase that grows with frequency
        spectrum = np.fft.rfft(x) * np.exp(-2j * math.pi * self._turns * samples)
        return np.asarray(np.fft.irfft(spectrum, len(x)))

    def _placed(self, x: Floats) -> tuple[float, float]:
        """By how many samples the mean lies earlier than the landing in ``x`` (n,), and the standard uncertainty."""
        shift, sigma = 0.0, math.inf
        slope = np.fft.irfft(np.fft.rfft(self._mean) * 2j * math.pi * self._turns, len(x))
        # the start is right to a whole sample: Gauss-Newton converges from there in three steps
        for _ in range(3):
            wave, steep = self._shifted(self._mean, shift), self._shifted(slope, shift)
            terms = np.column_stack([wave, steep, self._slow])
            found, *_ = np.linalg.lstsq(terms, x, rcond=None)
            left = x - terms @ found
            # Gauss-Newton: the amplitude of the slope over that of the wave is the shift that is left
            shift -= float(found[1] / found[0])
            # a delay is known as well as the noise over the norm of the waveform's slope (Cramer and Rao's bound)
            sigma = float(np.std(left) / (abs(found[0]) * np.linalg.norm(self._quick(steep))))
        return shift, sigma

    def _learn(self, wave: Floats) -> None:
        """One more landing, laid over the mean."""
        self._count += 1
        self._mean += (self._window * wave - self._mean) / self._count
