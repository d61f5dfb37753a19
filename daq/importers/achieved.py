"""Gamma at the plate over a step's hold, without what impacts add to the accelerometer.

An impact and its ringing fall on the same phase of every cycle, so that a fit through them is wrong by up to half a
percent. They are masked: after every closing of the contact circuit, and wherever the accelerometer is far from the
motion (a contact may be shorter than a sample). What remains is fitted as in the run and in the analysis. A table that
rings for longer than any mask bends such a fit far more than the impacts bend one of all samples, which is then taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from daq.loaded_tones import LoadedTones
from daq.lock_in import LockIn, fit_tones
from daq.setup.setup import Setup
from daq.steps.find_steps import FoundStep
from daq.steps.forcing_detection import Read, Signal, gamma_of, tones_hz, weights
from kernels.arrays import Bools, Floats, Integers

RINGING_S = (3e-3, 2e-3, 1e-3)  # masked after a closing: the longest that leaves enough
LEAST_QUIET = 0.5  # part of a hold that remains


def achieved_gamma(volts: Mapping[str, Read], step: FoundStep, rate_hz: float, setup: Setup) -> tuple[float, float]:
    """Gamma by the accelerometer and its standard uncertainty, the sensitivity's included.

    Parameters
    ----------
    volts
        Gives volts of samples ``a .. b``, by channel; ``accelerometer`` is there.
    step
        The step; its hold counts from where it has settled.
    rate_hz
    setup
        Forcing, sensitivity and levels of the contact.
    """
    sensor = setup.channels.accelerometer
    volts_per_g = sensor.volts_per_mps2 * setup.g_mps2.value
    forcing = [m for m, _ in weights(setup.forcing)]
    # three harmonics, which a mask at one phase of the cycle would mix into the tones; more are undetermined there
    harmonics = [m for m in range(1, 4) if m * step.frequency_hz < 0.45 * rate_hz]
    multiples = sorted({*forcing, *harmonics})
    try:
        sums = _sums(volts, step, rate_hz, step.frequency_hz * np.array(multiples, np.float64), setup)
        values, sigmas = LoadedTones.of_sorts(sums, volts_per_g).solve()
        rows = [multiples.index(m) for m in forcing]
        values, sigmas = values[rows], sigmas[rows]
    except ValueError:  # too few samples for harmonics, or a table that rings on
        signal = Signal(volts["accelerometer"], rate_hz, setup.forcing)
        tones = signal.fit(step.settled(rate_hz), step.stop, step.frequency_hz)
        values, sigmas = tones.amplitudes, tones.amplitude_sigma()
    gamma = gamma_of(values / volts_per_g, setup.forcing)
    noise = gamma_of(sigmas / volts_per_g + 0j, setup.forcing)
    return gamma, float(np.hypot(noise, gamma * sensor.sensitivity.uncertainty / sensor.sensitivity.value))


def _sums(volts: Mapping[str, Read], step: FoundStep, rate_hz: float, fitted_hz: Floats, setup: Setup) -> LockIn:
    """Normal equations of the hold: masked and unmasked samples, in contact and in flight."""
    contact = setup.channels.continuity if "continuity" in volts else None
    sums = LockIn(rate_hz, fitted_hz, sorts=4)
    motion_hz = tones_hz(step.frequency_hz, setup.forcing)
    start = step.settled(rate_hz)
    pieces = max((step.stop - start) // max(1 << 18, round(20 * rate_hz / step.frequency_hz)), 1)
    cuts = np.linspace(start, step.stop, pieces + 1).astype(np.int64).tolist()
    for a, b in pairwise(cuts):
        x = volts["accelerometer"](a, b)
        touching = np.zeros(b - a, np.bool_)
        if contact is not None and contact.coupling == "dc":
            touching = (volts["continuity"](a, b) < contact.middle_v) == (contact.swing_v > 0.0)
        quiet = _quiet(x, a, rate_hz, motion_hz, touching)
        sums.add(x, a, (np.where(quiet, 0, 2) + touching).astype(np.int8))
    return sums


def _quiet(x: Floats, first: int, rate_hz: float, motion_hz: Floats, touching: Bools) -> Bools:
    """Samples that no impact has touched; all of them where too few would remain."""
    closings = np.flatnonzero(touching[1:] & ~touching[:-1]) + 1  # impacts, where the contact sees them
    tones = np.exp(2j * np.pi * np.outer(motion_hz / rate_hz, np.arange(first, first + len(x))))
    whole = fit_tones(x, first, rate_hz, motion_hz, np.ones(len(x), np.bool_))
    if _rings_on(x - whole.offset - (whole.amplitudes @ tones).real, closings, rate_hz):
        raise ValueError("the table rings for longer than any mask")
    for ringing_s in RINGING_S:
        quiet = _clear(len(x), closings, rate_hz, ringing_s)
        for _ in range(2):
            if np.mean(quiet) < LEAST_QUIET:
                break
            motion = fit_tones(x, first, rate_hz, motion_hz, quiet)
            away = np.abs(x - motion.offset - (motion.amplitudes @ tones).real)
            noise = 1.4826 * float(np.median(away))
            # far from the motion: an impact; a file without noise has at least its harmonics
            limit = max(6.0 * noise, 1e-3 * np.abs(motion.amplitudes).max())
            outliers = np.flatnonzero(away > limit)
            quiet = _clear(len(x), np.concatenate([closings, outliers]), rate_hz, ringing_s)
        if np.mean(quiet) >= LEAST_QUIET:
            return quiet
    return np.ones(len(x), np.bool_)


def _rings_on(left: Floats, closings: Integers, rate_hz: float) -> bool:
    """Whether the ringing of an impact outlasts the longest mask; ``left`` is the accelerometer less the motion."""
    lead, width = round(2e-4 * rate_hz), max(round(RINGING_S[-1] * rate_hz), 1)
    behind = round(RINGING_S[0] * rate_hz)
    inside = closings[(closings > lead + width) & (closings + behind + width < len(left))]
    if len(inside) < 4:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(left, width)
    before, at, after = (np.median(windows[inside + shift].std(axis=1)) for shift in (-lead - width, 0, behind))
    # what is left after the mask stands out of what was there before, and is a good part of the ringing
    return bool(after > 5.0 * before and after > 0.2 * at)


def _clear(n: int, impacts: Integers, rate_hz: float, ringing_s: float) -> Bools:
    """Samples of ``n`` away from all ``impacts``."""
    change = np.zeros(n + 1, np.int64)
    np.add.at(change, np.maximum(impacts - round(2e-4 * rate_hz), 0), 1)
    np.add.at(change, np.minimum(impacts + max(round(ringing_s * rate_hz), 1), n), -1)
    return np.asarray(np.cumsum(change[:-1]) == 0)
