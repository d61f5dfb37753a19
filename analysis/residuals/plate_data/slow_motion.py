"""The plate's slow motion: the forcing's amplitude, and lines that are no multiple of it.

A modulation of the amplitude, within steps and between them, is found by least squares, with its frequency. A line
counts as the table's own where several steps show it; others hum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from analysis.linear_algebra import solve
from analysis.plate.motion import StepPlate
from analysis.plate.step_state import mean_phasor
from analysis.statistics import mad_sigma
from kernels.arrays import Floats, Integers
from model.integrator.problem import PlateSteps

FASTEST = 0.45  # highest frequency over the windows' rate: beyond, it is aliased
FINENESS = 5.0  # frequencies tried in the inverse of a recording's length
CHUNK = 64  # frequencies calculated together
RIDGE, TINY = 1e-9, 1e-300
LEAST = 4  # steps or windows that are used at all
Source = Literal["both", "windows", "gains"]
PARTS: dict[Source, slice] = {"both": slice(0, 2), "windows": slice(1, 2), "gains": slice(0, 1)}


@dataclass(frozen=True)
class Amplitudes:
    """Amplitude of the forcing in windows within steps, and from step to step in their gains."""

    recording: Integers  # of each step, (m,)
    span_s: Floats  # start and end of each step's fit, (m, 2)
    gain: Floats  # logarithm of plate over drive in each step, (m,); not finite where there is no drive
    gain_sigma: Floats  # its standard deviation, (m,)
    window_step: Integers  # row of each window's step, (w,), in the order of the `MODULATION` rows of the plate data
    window_span_s: Floats  # start and end of each window, (w, 2)
    value: Floats  # relative deviation of its amplitude from the step's own, (w,)
    sigma: Floats  # standard deviation of that, (w,)

    @property
    def runs(self) -> range:
        """Numbers of the recordings."""
        return range(int(self.recording.max(initial=-1)) + 1)

    @cached_property
    def since_s(self) -> tuple[Floats, Floats]:
        """End of each step, and middle of each window, since its recording's first step began, (m,) and (w,)."""
        begin = np.array([self.span_s[self.recording == r, 0].min() for r in self.runs])[self.recording]
        return self.span_s[:, 1] - begin, self.window_span_s.mean(axis=1) - begin[self.window_step]

    def strongest_hz(self, source: Source) -> float:
        """Frequency of the largest gain in likelihood; a long recording is scanned from its first part outwards."""
        since = np.sort(self.since_s[1])
        fastest = FASTEST / max(float(np.median(np.diff(self.window_span_s, axis=1))), 1e-9)
        between_s = np.diff(self.span_s[:, 0])[np.diff(self.recording) == 0]
        if source == "gains" and len(between_s):  # a faster modulation looks like a slower one from step to step
            fastest = FASTEST / max(float(np.median(between_s)), 1e-9)
        # the first scan takes 3000 windows at most; later rounds take more of a long recording, near what was found
        until = float(since[min(len(since), 3000) - 1])
        hz = np.arange(0.5 / until, fastest, 1.0 / (FINENESS * until))
        best = float(hz[np.argmax(self._power(hz, until, source))]) if len(hz) else fastest
        while True:
            near, until = 1.0 / until, min(4 * until, float(since[-1]))
            hz = np.maximum(best + np.arange(-near, near, 0.2 / (FINENESS * until)), 0.1 / until)
            best = float(hz[np.argmax(self._power(hz, until, source))])
            if until >= since[-1]:
                return best

    def _power(self, hz: Floats, until_s: float, source: Source) -> Floats:
        """What the best modulation at each frequency gains in the first ``until_s`` of the recordings, nats, (f,)."""
        out = np.zeros(len(hz))
        for first in range(0, len(hz), CHUNK):
            some = slice(first, first + CHUNK)
            steps = mean_phasor(self.span_s, 2.0 * np.pi * hz[some])
            windows = mean_phasor(self.window_span_s, 2.0 * np.pi * hz[some]) - steps[:, self.window_step]
            rows, means = (np.stack([x.imag, x.real], axis=1) for x in (windows, steps))
            for r in self.runs:
                normal, side = self.normal(r, rows, means, self.value, self.gain, until_s)
                part = PARTS[source]
                normal, side = normal[part].sum(axis=0) + RIDGE * np.eye(2), side[part].sum(axis=0)
                gained = 0.5 * np.sum(side * solve(normal, side[..., None])[..., 0], axis=-1)
                out[some] += self._without_scale(r, until_s, gained) if source == "gains" else gained
        return out

    def _without_scale(self, r: int, until_s: float, gained: Floats) -> Floats:
        """Gain in likelihood of the steps' gains where their scatter is not known but found from what is left, (f,)."""
        known = (self.recording == r) & (self.since_s[0] <= until_s) & np.isfinite(self.gain)
        if known.sum() <= LEAST:
            return gained
        gain = self.gain[known]
        weight = 1.0 / (self.gain_sigma[known] ** 2 + _scatter(gain) ** 2)
        total = 0.5 * float(np.sum(weight * (gain - np.average(gain, weights=weight)) ** 2))
        least = 0.5 * float(np.sum(weight * self.gain_sigma[known] ** 2))
        return np.asarray(0.5 * len(gain) * np.log((total + least) / np.maximum(total - gained + least, TINY)))

    def normal(
        self, r: int, rows: Floats, means: Floats, value: Floats, gain: Floats, until_s: float
    ) -> tuple[Floats, Floats]:
        """Normal equations (2, f, 2, 2) and right sides (2, f, 2) of the steps' gains, then of the windows.

        ``rows`` (f, 2, w) and ``means`` (f, 2, m) are what the two parts of a modulation make of windows and gains.
        """
        known = (self.recording == r) & (self.since_s[0] <= until_s) & np.isfinite(gain)
        windows = (self.recording[self.window_step] == r) & (self.since_s[1] <= until_s)
        normal, side = np.zeros((2, len(rows), 2, 2)), np.zeros((2, len(rows), 2))
        normal[1], side[1] = _squares(rows[..., windows], value[windows], self.sigma[windows] ** -2.0)
        if known.sum() > LEAST:
            weight = 1.0 / (self.gain_sigma[known] ** 2 + _scatter(gain[known]) ** 2)
            means, gain = means[..., known], gain[known]
            means = means - (means @ weight / weight.sum())[..., None]  # a common offset is no modulation
            normal[0], side[0] = _squares(means, gain - gain @ weight / weight.sum(), weight)
        return normal, side


def _squares(parts: Floats, value: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Normal equations (f, 2, 2) and right sides (f, 2) of ``value`` (n,) as a sum of two ``parts`` (f, 2, n)."""
    return (parts * weight) @ parts.transpose(0, 2, 1), (parts * weight) @ value


def _scatter(x: Floats) -> float:
    """Robust standard deviation of what is finite; 0 where there is too little."""
    x = x[np.isfinite(x)]
    return mad_sigma(x - np.median(x)) if len(x) >= LEAST else 0.0


SHARED_LINES = 3  # steps that must show a slow line


def hints_of(fitted: Sequence[StepPlate]) -> tuple[float, ...]:
    """Middles of the clusters of slow lines that at least `SHARED_LINES` steps show, Hz."""
    return clustered(np.array([line.frequency_hz for s in fitted for line in s.lines]), SHARED_LINES)


def clustered(lines_hz: Floats, least: int) -> tuple[float, ...]:
    """Middles of clusters of at least ``least`` lines, Hz."""
    found = np.sort(lines_hz)
    # lines of one source lie within 8 % in all steps
    clusters = np.split(found, np.flatnonzero(np.diff(found) > 0.08 * found[1:]) + 1) if len(found) else []
    return tuple(float(np.median(c)) for c in clusters if len(c) >= least)


def other_lines_radps(plate: PlateSteps, hints_hz: Sequence[float]) -> list[Floats]:
    """Angular frequencies of each step that are no multiple of the forcing, ``hints_hz`` among them."""
    found = []
    for w, z, period_s in zip(plate.omega_radps, plate.acceleration_mps2, plate.period_s, strict=True):
        cycles = w * period_s / (2.0 * np.pi)
        # a line within 2 % of a multiple of the forcing repeats every cycle
        other = (z != 0.0) & (np.abs(cycles - np.round(cycles)) > 0.02)
        found.append(np.concatenate([w[other], 2.0 * np.pi * np.array(hints_hz)]))
    return found
