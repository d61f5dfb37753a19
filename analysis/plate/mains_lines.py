"""The mains line of a step at its own frequency: mains wander, and an exact 50 or 60 Hz would miss part of the motion.

The rule kept here: a line is moved only where it stands out of the step, from where the steps before left it; how far
its frequency is still unknown stays in the covariance of all tones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from daq.lock_in import ToneFit

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

MAINS_HZ = (50.0, 60.0)
FARTHEST_HZ = 0.3  # from the nominal frequency: a free-running generator and a clock that is off
WANDER_HZ = 0.1  # one standard deviation, before anything has been heard
WALK_HZ = 0.002  # by which mains wander within a second
STANDS_OUT = 6.0  # sigmas of the amplitude, from which a line is moved
APART = 0.3  # cycles over a step by which two tones must differ: their uncertainties grow by a half
LEAST_CYCLES = 5.0  # of a line that is fitted
LOBE = 0.25  # cycles over a step by which a line may be off and still be seen where it was looked for
NEAR = 0.1  # cycles over a step between the trial frequencies: the misfit is a parabola there
BIN_S = 0.2  # summed before a long step is searched: short against a turn of `FARTHEST_HZ`
SETTLED = 0.1  # of its uncertainty, by which a line may still move
ROUNDS = 8


@dataclass(frozen=True)
class MainsLine:
    """A mains line: where it is looked for, where it was heard, how well that is known, and when.

    ``slopes`` (k,) are the changes of all the step's fitted tones with the line's frequency; None: not moved.
    """

    nominal_hz: float
    hz: float
    sigma_hz: float
    at_s: float
    slopes: Complexes | None = None

    def later(self, at_s: float) -> MainsLine:
        """What is known of it in another step."""
        sigma = float(np.hypot(self.sigma_hz, WALK_HZ * np.sqrt(abs(at_s - self.at_s))))
        return replace(self, sigma_hz=min(sigma, WANDER_HZ), at_s=at_s, slopes=None)

    @property
    def reach_hz(self) -> float:
        """How far from `hz` it may be."""
        return min(3.0 * self.sigma_hz, FARTHEST_HZ)


def doubted(fit: ToneFit, lines: Sequence[MainsLine], factor: float) -> ToneFit:
    """The fit with what the lines' uncertain frequencies add to its covariance; ``factor`` from volts to its unit."""
    covariance = fit.covariance
    for line in lines:
        if line.slopes is not None:
            both = np.column_stack([line.slopes.real, line.slopes.imag]).ravel() * line.sigma_hz * factor
            covariance = covariance + np.outer(both, both)
    return replace(fit, covariance=covariance)


def line_of(nominal_hz: float) -> MainsLine:
    """A line of which nothing has been heard yet."""
    return MainsLine(nominal_hz, nominal_hz, WANDER_HZ, 0.0)


def lines_apart(lines_hz: Sequence[float], tones_hz: Floats, length_s: float) -> list[float]:
    """Those of the lines that a step of this length can tell from its tones."""
    long_enough = [hz for hz in lines_hz if hz * length_s > LEAST_CYCLES]
    return [hz for hz in long_enough if np.abs(tones_hz - hz).min() > APART / length_s]


def heard_hz(residual: Floats, time_s: Floats, line: MainsLine, length_s: float) -> float:
    """Where the line is strongest in a long step's ``residual`` at ``time_s``, both (n,)."""
    turned = residual * np.exp(-2j * np.pi * line.hz * time_s)
    bins = np.floor((time_s - time_s[0]) / BIN_S).astype(np.int64)
    sums = np.bincount(bins, turned.real) + 1j * np.bincount(bins, turned.imag)
    middles_s = (np.arange(len(sums)) + 0.5) * BIN_S
    count = int(np.ceil(line.reach_hz * length_s / LOBE))
    off_hz = np.arange(-count, count + 1) * LOBE / length_s
    strength = np.abs(np.exp(-2j * np.pi * off_hz[:, None] * middles_s) @ sums)
    return float(line.hz + off_hz[np.argmax(strength)])


def moved(
    line: MainsLine,
    place: int,
    fit_at: Callable[[float], ToneFit],
    begin_hz: float,
    others_hz: Floats,
    length_s: float,
) -> MainsLine:
    """The line where the step's data and what is known of it beforehand want it together.

    Parameters
    ----------
    line
        What is known beforehand; returned as it is where the line does not stand out, or comes too near another tone.
    place
        Of the line among the fitted tones.
    fit_at
        The fit of all tones with the line at a frequency, in volts.
    begin_hz
        Where to begin.
    others_hz
        All other tones of the step, shape (k - 1,).
    length_s
        Of the step.
    """
    hz, h = begin_hz, NEAR / length_s
    for _ in range(ROUNDS):
        middle = fit_at(hz)
        if not abs(middle.amplitudes[place]) > STANDS_OUT * middle.amplitude_sigma()[place]:
            return line
        left, right = fit_at(hz - h), fit_at(hz + h)
        misfit = [_misfit(f) / max(middle.rms**2, 1e-300) for f in (left, middle, right)]
        bend = max((misfit[0] - 2.0 * misfit[1] + misfit[2]) / h**2, 0.0) + 2.0 / line.sigma_hz**2
        slope = (misfit[2] - misfit[0]) / (2.0 * h) + 2.0 * (hz - line.hz) / line.sigma_hz**2
        step = float(np.clip(-slope / bend, -2.0 * h, 2.0 * h))
        hz += step
        if abs(hz - line.nominal_hz) > FARTHEST_HZ or np.abs(others_hz - hz).min() < APART / length_s:
            return line
        sigma = float(np.sqrt(2.0 / bend))
        if abs(step) < SETTLED * sigma:
            return replace(line, hz=hz, sigma_hz=sigma, slopes=(right.amplitudes - left.amplitudes) / (2.0 * h))
    return line


def _misfit(fit: ToneFit) -> float:
    """Sum of squares that a fit leaves."""
    return fit.rms**2 * (fit.n - 2 * len(fit.amplitudes) - 1)
