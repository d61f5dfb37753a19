"""From which gamma a ringing plate is no longer true to its drive, and what would cure it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analysis.plate.motion import StepPlate
from analysis.plate.ringing.regression import PlateMode
from kernels.arrays import Floats

UNTRUE = 0.05  # part of the drive's speed that the mode's may have
CURES = (
    # factors of frequency, damping and mass ratio
    ("half the ball", (1.0, 1.0, 0.5)),
    ("twice the moving mass on the same springs", (np.sqrt(0.5), np.sqrt(0.5), 0.5)),
    ("springs four times as stiff", (2.0, 0.5, 1.0)),
    ("four times the damping", (1.0, 4.0, 1.0)),
)  # fmt: skip


def parts_of_drive(mode: PlateMode, span_s: Floats, drive_mps: Floats, factors: Floats) -> Floats:
    """Speed of the mode over that of the drive's tones, both rms, in each step, (m,).

    Parameters
    ----------
    mode
        With what the ball did to the plate.
    span_s
        Begin and end of each step, (m, 2).
    drive_mps
        Rms speed of the drive's tones in each, (m,).
    factors
        Of frequency, damping and mass ratio, (3,): another plate under the same impacts where they are not 1.
    """
    if mode.pushed is None:
        return np.full(len(drive_mps), np.nan)
    # another plate would not have answered as this one did, so that nothing of that corrects its kicks
    push = mode.pushed if np.all(factors == 1.0) else replace(mode.pushed, known=np.zeros_like(mode.pushed.known))
    hz, damping, mass_ratio = np.array([mode.frequency_hz, mode.damping, mode.mass_ratio]) * factors
    motion, block_s = push.moved(float(hz), min(float(damping), 0.9), float(mass_ratio)), push.push.block_s
    speeds = [np.std(motion.state(np.arange(begin, end, block_s))[:, 1]) for begin, end in span_s]
    return np.asarray(speeds) / drive_mps


def ringing_in_words(mode: PlateMode, gamma: Floats, span_s: Floats, drive_mps: Floats) -> str:
    """The mode, from which gamma on it spoils the plate's motion, and what it would be of another plate or ball.

    ``gamma`` of each step, (m,); the rest as in `parts_of_drive`.
    """
    order = np.argsort(gamma)
    gamma, span_s, drive_mps = gamma[order], span_s[order], drive_mps[order]
    part = parts_of_drive(mode, span_s, drive_mps, np.ones(3))
    true = np.flatnonzero(part < UNTRUE)
    first = int(true[-1]) + 1 if len(true) else 0
    loaded_hz = mode.frequency_hz / np.sqrt(1.0 + mode.mass_ratio)
    words = (
        f"the plate rings at {mode.frequency_hz:.3g} Hz under the ball ({loaded_hz:.3g} Hz with the ball on it, "
        f"damping {mode.damping:.2g}, the ball weighs {100.0 * mode.mass_ratio:.2g} % of what moves): "
        f"{100.0 * part[-1]:.2g} % of the drive's speed at gamma {gamma[-1]:.3g}"
    )
    if (more := mode.second) is not None:
        words = (
            f"one mode does not suffice, of the {more.before_mps2:.2g} m/s^2 that it leaves one of "
            f"{more.frequency_hz:.2g} Hz explains all but {more.remainder_mps2:.2g}; {words}"
        )
    if first == len(part):
        return f"{words}, nowhere lastingly above {100.0 * UNTRUE:g} %"
    cures = (
        f"{100.0 * parts_of_drive(mode, span_s[-1:], drive_mps[-1:], np.array(factors))[0]:.2g} % with {what}"
        for what, factors in CURES
    )
    since = f"; the plate is not true to its drive (to {100.0 * UNTRUE:g} %) from gamma {gamma[first]:.3g} on"
    return f"{words}{since}; under the same impacts {', '.join(cures)}"


def remarks(mode: PlateMode | None, steps: Sequence[StepPlate], rate_hz: float) -> tuple[str, ...]:
    """The sentence about a mode that is sure, of steps of a recording; none about another."""
    if mode is None or mode.pushed is None or not steps:
        return ()
    tones = [s.forcing() for s in steps]
    drive_mps = np.sqrt([0.5 * np.sum(np.abs(z.acceleration / z.omega_radps) ** 2) for z in tones])
    span_s = np.array([(s.first_sample, s.last_sample) for s in steps]) / rate_hz
    return (ringing_in_words(mode, np.array([s.gamma for s in steps]), span_s, drive_mps),)
