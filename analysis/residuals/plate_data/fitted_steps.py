"""What the fits of a recording's steps have seen of the plate: tones, intervals and windows, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analysis.plate.fit_mask import FitIntervals
from analysis.plate.motion import StepPlate
from analysis.residuals.plate_data.plate_observables import LEAST_WINDOWS
from kernels.arrays import Complexes, Floats


def tones_of(fitted: Sequence[StepPlate]) -> tuple[Floats, Complexes]:
    """Fitted tones of each step and their amplitudes, (m, k); places that are free hold multiples beyond them."""
    k = max((len(s.acceleration.amplitudes) for s in fitted), default=2)
    omega, z = np.zeros((len(fitted), k)), np.zeros((len(fitted), k), dtype=np.complex128)
    for i, s in enumerate(fitted):
        leading = s.forcing_multiples if len(s.forcing_multiples) > 1 else (1, 2)
        first = [s.multiples.index(m) for m in leading if m in s.multiples]
        order = [*first, *(j for j in range(len(s.acceleration.amplitudes)) if j not in first)]
        omega[i] = s.omega_radps * (max(s.multiples) + 1.0 + np.arange(k))
        omega[i, : len(order)] = 2.0 * np.pi * s.acceleration.frequencies_hz[order]
        z[i, : len(order)] = s.acceleration.amplitudes[order]
    return omega, z


def intervals_of(fitted: Sequence[StepPlate]) -> FitIntervals:
    """What the fits of all steps have seen; windows of steps that have too few of them are none."""
    count = [len(s.windows.time_s) if len(s.windows.time_s) >= LEAST_WINDOWS else 0 for s in fitted]
    parts = [
        replace(s.intervals, window=np.where(n > 0, s.intervals.window, -1)) for s, n in zip(fitted, count, strict=True)
    ]
    return FitIntervals.join(parts, np.arange(len(parts)), np.cumsum([0, *count])[:-1])


def window_spans(s: StepPlate) -> Floats:
    """From where to where each window of a step goes, (w, 2)."""
    return s.windows.time_s[:, None] + 0.5 * s.windows.length_s * np.array([-1.0, 1.0])
