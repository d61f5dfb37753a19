"""Find the steps of a ramp in a recorded drive (or, where there is none, in the plate's acceleration).

A step is a stretch in which every tone's amplitude and the frequency are constant; the change before it is its fade.
The frequency is fitted to the phase over the whole hold, because every later phase depends on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import STEP_DTYPE
from daq.lock_in import ToneFit
from daq.setup.setup import Forcing
from daq.steps.forcing_detection import Signal, regions
from daq.steps.tone_tracking import (
    SETTLE_CYCLES,
    SteadySegment,
    frequency_correction,
    same_frequency,
    split_exactly,
    steady_segments,
)
from kernels.arrays import Floats

SAME_FREQUENCY = 3e-5  # relative


@dataclass(frozen=True)
class FoundStep(SteadySegment):
    """One step as found; ``frequency_hz`` is fitted."""

    frequency_sigma_hz: float
    tones: ToneFit  # complex amplitudes of the tones (in volts, phase at sample 0) over the hold after settling


def find_steps(signal: Signal, start: int, stop: int) -> list[FoundStep]:
    """Steps between two samples, in order."""
    signal = _read_ahead(signal, stop)
    found: list[FoundStep] = []
    for region in split_exactly(signal, regions(signal, start, stop)):
        for part in same_frequency(signal, region):
            found += [_refined(signal, one) for one in steady_segments(signal, part)]
    # a disturbance in a hold looks like a border: the pieces on both sides are one motion
    found = _joined(signal, found)
    loudest = max((float(np.abs(s.tones.amplitudes).max()) for s in found), default=0.0)
    # an amplifier's hum between steps is steady, too, but by far weaker than any hold
    return [s for s in found if np.abs(s.tones.amplitudes).max() > 2e-3 * loudest]


def given_step(signal: Signal, start: int, stop: int, frequency_hz: float) -> list[FoundStep]:
    """Step that a file states between two samples, its frequency fitted near ``frequency_hz``; none if too short."""
    if frequency_hz <= 0 or (stop - start) * frequency_hz / signal.rate_hz < 4.0:
        return []
    return [_refined(_read_ahead(signal, stop), SteadySegment(start, start, stop, frequency_hz))]


def step_table(
    found: list[FoundStep], forcing: Forcing, rate_hz: float, gammas: Floats, achieved: Floats | None = None
) -> NDArray[np.void]:
    """`STEP_DTYPE` rows; ``gammas`` (n,) are NaN where unknown, ``achieved`` (n, 2) are at the plate, with sigma."""
    rows = np.zeros(len(found), STEP_DTYPE)
    for row, step in zip(rows, found, strict=True):
        settled = step.settled(rate_hz)
        row["first_sample"], row["n_samples"] = step.start, step.stop - step.start
        row["settle_samples"], row["fade_samples"] = settled - step.start, step.hold - step.start
        row["frequency_hz"], row["ratio"] = step.frequency_hz, forcing.ratio
        row["cycles"] = (step.stop - settled) * step.frequency_hz / rate_hz
        row["settle_cycles"] = (settled - step.hold) * step.frequency_hz / rate_hz
    rows["gamma"] = gammas
    rows["achieved_gamma"] = rows["achieved_gamma_uncertainty"] = np.nan
    if achieved is not None:
        rows["achieved_gamma"], rows["achieved_gamma_uncertainty"] = achieved.T
    known = np.nan_to_num(gammas)
    rows["direction"][1:] = np.sign(np.diff(known))
    rows["direction"][:1] = np.sign(known[:1])
    return rows


def _read_ahead(signal: Signal, last: int) -> Signal:
    """Many small reads in nearly rising order, served from few large ones that end at ``last``."""
    begin, held = 0, np.zeros(0)

    def from_held(start: int, stop: int) -> Floats:
        nonlocal begin, held
        if start < begin or stop > begin + len(held):
            begin, held = start, signal.read(start, min(max(stop, start + (1 << 18)), max(last, stop)))
        return held[start - begin : stop - begin]

    return replace(signal, read=from_held)


def _joined(signal: Signal, found: list[FoundStep]) -> list[FoundStep]:
    """Join neighbours that one unbroken motion explains: equal tones, the phase continued across the border."""
    joined = found[:1]
    for step in found[1:]:
        last, there_s = joined[-1], step.hold / signal.rate_hz
        nearby = step.hold - last.stop < SETTLE_CYCLES * signal.rate_hz / step.frequency_hz
        alike = abs(last.frequency_hz - step.frequency_hz) <= SAME_FREQUENCY * step.frequency_hz
        before, after = (
            one.tones.amplitudes * np.exp(2j * np.pi * one.tones.frequencies_hz * there_s) for one in (last, step)
        )
        if nearby and alike and np.all(np.abs(before - after) < 1e-3 * np.abs(after).max()):
            both = SteadySegment(last.start, last.hold, step.stop, last.frequency_hz)
            joined[-1] = _refined(signal, both)
        else:
            joined.append(step)
    return joined


def _refined(signal: Signal, still: SteadySegment) -> FoundStep:
    """Fit the frequency to the phases over the hold, twice (the first time from a rough value), then the tones."""
    frequency, sigma, settled = still.frequency_hz, np.nan, still.settled(signal.rate_hz)
    for _ in range(2):
        correction, sigma = frequency_correction(signal, settled, still.stop, frequency)
        frequency += correction
    return FoundStep(still.start, still.hold, still.stop, frequency, sigma, signal.fit(settled, still.stop, frequency))
