"""Mains in what a recording shows of the plate: their own line, on an undriven harmonic, or on a driven tone.

On a driven tone there is no line to measure. What is left of that tone when a fixed multiple of its drive is taken
away, in all steps together, tells the mains' phase in each: they go on while amplitudes change. Decision 725.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from analysis.linear_algebra import pinv
from analysis.plate.mains_lines import MAINS_HZ, MAX_OFFSET_HZ, SIGNIFICANT
from analysis.plate.motion import StepPlate
from kernels.arrays import Complexes


def strongest_mains_hz(fitted: Sequence[StepPlate]) -> float:
    """The mains frequency whose line all steps together show best; chosen in each step, noise would look like one."""

    def shown(rows_of: Callable[[StepPlate, float], Sequence[int]], hz: float) -> float:
        rows = [(s.acceleration, k) for s in fitted for k in rows_of(s, hz)]
        return float(np.mean([abs(f.amplitudes[k] / f.amplitude_sigma()[k]) ** 2 for f, k in rows])) if rows else 0.0

    lines = [shown(mains_rows, hz) for hz in MAINS_HZ]
    if max(lines) < 4.0:  # noise gives 2; harmonics, which much else makes, count only where no line shows
        lines = [max(line, shown(_harmonics_there, hz)) for line, hz in zip(lines, MAINS_HZ, strict=True)]
    return float(MAINS_HZ[int(np.argmax(lines))])


def mains_rows(s: StepPlate, mains_hz: float) -> list[int]:
    """Rows of a step's fit that hold the line of the mains: one, or none where the forcing hides it."""
    hz = s.acceleration.frequencies_hz
    return [k for k in range(len(s.multiples), len(hz)) if abs(hz[k] - mains_hz) < MAX_OFFSET_HZ]


def _harmonics_there(s: StepPlate, mains_hz: float) -> list[int]:
    """Rows of the second and third multiple, where it is not driven and hides the mains."""
    undriven = [s.multiples.index(m) for m in (2, 3) if m in s.multiples and m not in s.forcing_multiples]
    return [k for k in undriven if abs(s.acceleration.frequencies_hz[k] - mains_hz) < MAX_OFFSET_HZ]


def mains_on_tones(fitted: Sequence[StepPlate], rate_hz: float) -> dict[tuple[int, float], Complexes]:
    """What mains of 1 m/s^2 add to a driven tone's ratio to its drive, over that ratio, in each of the steps (m,).

    By the tone's multiple of the first one and the nominal frequency of the mains, where they are on one; 0 in steps in
    which they are not. ``rate_hz`` is samples a second.
    """
    out = {}
    for m in {m for s in fitted for m in s.forcing_multiples}:
        for hz in MAINS_HZ:
            there = [
                i for i, s in enumerate(fitted)
                if m in s.forcing_multiples and s.drive is not None and abs(m * s.frequency_hz - hz) < MAX_OFFSET_HZ
                and not mains_rows(s, hz)
            ]  # fmt: skip
            added = np.zeros(len(fitted), dtype=np.complex128)
            # two complex numbers and a frequency are fitted
            if len(there) > 5:
                added[there] = _added([fitted[i] for i in there], m, hz, rate_hz)
            if added.any():
                out[m, hz] = added
    return out


def _added(steps: Sequence[StepPlate], multiple: int, mains_hz: float, rate_hz: float) -> Complexes:
    """`mains_on_tones` of one tone in some steps, (m,); 0 where noise might do it."""
    place = steps[0].multiples.index(multiple)
    at_s = np.array([0.5 * (s.first_sample + s.last_sample) for s in steps]) / rate_hz
    off_hz = mains_hz - multiple * np.array([s.frequency_hz for s in steps])
    shown = np.array([s.acceleration.amplitudes[place] for s in steps])
    drive = np.array([s.drive.amplitudes[place] for s in steps if s.drive is not None])

    def fitted_at(further_hz: float) -> tuple[float, complex, complex, float]:
        """Sum of squares that is left, gain, mains and the mains' uncertainty with the mains so far off."""
        columns = np.column_stack([drive, np.exp(2j * np.pi * (off_hz + further_hz) * at_s)])
        inverse = pinv(columns)
        found = inverse @ shown
        misfit = float(np.sum(np.abs(shown - columns @ found) ** 2))
        sigma = math.sqrt(0.5 * misfit / (len(steps) - 2.5)) * float(np.linalg.norm(inverse[1]))
        return misfit, complex(found[0]), complex(found[1]), sigma

    # a quarter of a turn over the run from each other
    trials_hz, spacing_hz = np.linspace(
        -MAX_OFFSET_HZ, MAX_OFFSET_HZ, 3 + 2 * math.ceil(4.0 * MAX_OFFSET_HZ * float(np.ptp(at_s))), retstep=True
    )
    near_hz = min(trials_hz, key=lambda hz: fitted_at(hz)[0])
    bounds = near_hz - spacing_hz, near_hz + spacing_hz
    best_hz = float(minimize_scalar(lambda hz: fitted_at(hz)[0], bounds=bounds, method="bounded").x)
    _, gain, mains, sigma = fitted_at(best_hz)
    # the best of so many frequencies gains by noise, too
    if not abs(mains) > SIGNIFICANT * sigma:
        return np.zeros(len(steps), dtype=np.complex128)
    return np.asarray(mains / abs(mains) * np.exp(2j * np.pi * (off_hz + best_hz) * at_s) / (gain * drive))
