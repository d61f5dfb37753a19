"""Spectral lines of the plate that are no multiple of the forcing: where a table resonance may be, and what hums.

A line counts as the table's own where several steps show it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.plate.motion import StepPlate
from kernels.arrays import Floats
from model.integrator.problem import PlateSteps

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
