"""Levels and noise of the contact circuit, measured on the plateaus of its voltage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

LOW, HIGH = 0.35, 0.65  # hysteresis thresholds, as fractions of the swing
MIN_DIP, DIP_SIGMAS, MAX_DIP = 0.02, 10.0, 0.3  # depth of a visible dip: bounds, and in standard deviations of noise
PLATEAU_SAMPLES = (16, 4)  # samples on one side before those of a plateau, the longer first
PLATEAU_AFTER = 5  # samples that stay on that side, its own included
MIN_PLATEAU = 50  # samples needed to measure a level
NEAR_LEVEL = 0.1  # fraction of the swing within which samples belong to a level
ROUNDING = 1e-6  # relative error of volts kept as float32
CORE, CORE_SIGMA = 0.98, 0.9346  # part of normal deviations that is kept, and the rms of that part


@dataclass(frozen=True)
class Levels:
    """Levels of the contact circuit in volts, measured where a plateau exists, declared otherwise.

    ``noise_v`` is the standard deviation on a plateau. Behind a coupling capacitor they are the levels
    restored by `analysis.events.ac_coupling`.
    """

    closed_v: float
    open_v: float
    noise_v: float

    @property
    def swing_v(self) -> float:
        """Voltage from closed to open."""
        return self.open_v - self.closed_v

    def thresholds(self) -> Floats:
        """``(low, high, dip)`` as fractions of the swing: hysteresis, and the upper bound of a visible dip."""
        noise = self.noise_v / abs(self.swing_v)
        return np.array([LOW, HIGH, 1.0 - min(max(DIP_SIGMAS * noise, MIN_DIP), MAX_DIP)])


def measure_levels(volts: Floats, declared_closed_v: float, declared_open_v: float) -> Levels:
    """Levels and noise from a sample of continuity volts, ``volts`` shape (n,).

    A plateau follows sixteen samples (four, where no plateau is so long) on one side of the declared middle. Without a
    plateau the declared level stands.
    """
    swing = declared_open_v - declared_closed_v
    side = (volts - declared_closed_v) / swing > 0.5
    levels, spreads = [], []
    for wanted, declared in ((False, declared_closed_v), (True, declared_open_v)):
        plateau = volts[:0]
        for before in PLATEAU_SAMPLES:
            length = before + PLATEAU_AFTER
            if volts.size < length:
                continue
            if plateau.size < MIN_PLATEAU:
                there = np.concatenate([[0], np.cumsum(side == wanted)])
                inside = there[length:] - there[:-length] == length
                plateau = volts[before : before + inside.size][inside]
        if plateau.size < MIN_PLATEAU:
            levels.append(declared)
            continue
        level = float(np.median(plateau))
        near = plateau[np.abs(plateau - level) < NEAR_LEVEL * abs(swing)]
        level = float(np.median(near)) if near.size else level
        deviation = np.abs(near - level)
        spreads.append(_core_rms(deviation))
        levels.append(level if near.size > 0.5 * plateau.size else declared)
    noise = max([*spreads, _step_v(volts) / np.sqrt(12.0), 1e-6 * abs(swing)])
    return Levels(levels[0], levels[1], noise)


def _step_v(volts: Floats) -> float:
    """Step of the converter: smallest distance of two values, ones that rounding has set apart taken as one."""
    values = np.unique(volts)
    apart = np.diff(values)
    apart = apart[apart > ROUNDING * np.abs(values).max(initial=0.0)]
    return float(apart.min()) if apart.size else 0.0


def _core_rms(deviation: Floats) -> float:
    """Standard deviation of normal noise from all but its largest 2 %: robust, and unbiased by quantisation."""
    if not deviation.size:
        return 0.0
    core = deviation[deviation <= np.quantile(deviation, CORE)]
    return float(np.sqrt(np.mean(core**2))) / CORE_SIGMA
