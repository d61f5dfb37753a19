"""What an impact looks like on this rig, learnt from the accelerometer alone.

The rule kept here: strong lone onsets are lined up, averaged and lined up again by their average until it stands; the
continuity circuit has no say in it (it may be late, or close only at the end of a chatter). The waveform's zero is its
onset; `analysis.events.impact_detection.calibrate` then measures what separates it from the electrical edge.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from analysis.events.impact_detection import ImpactScan
from analysis.events.impact_template import LEAD, Waveform, echo_samples, learn_waveform
from analysis.plate.accumulator import multiples_of
from analysis.plate.mains_lines import MAINS_HZ, STANDS_OUT, lines_apart
from analysis.signals.stream import PAD, Piece
from daq.lock_in import ToneFit, fit_tones
from kernels import njit

Floats = npt.NDArray[np.float64]

MASK_S = 8e-3  # left out of the tone fits after an impact while its waveform is learnt
QUIET_SAMPLES = 60  # without an onset before an onset
ONSET = 6.0  # standard deviations of noise that make an onset
STRONG = 12.0  # of them that make it one to learn from
ROUNDS = 3
MOST = 400  # impacts learnt from


def learn(looked: list[Piece], noise_v: float, steps: npt.NDArray[np.void], rate_hz: float) -> Waveform | None:
    """The impact's waveform from a few pieces of the recording; None where the accelerometer shows no impacts."""
    tones_hz = np.unique(np.concatenate([steps["frequency_hz"], steps["frequency_hz"] * steps["ratio"]]))
    few = tones_hz[np.unique(np.linspace(0, tones_hz.size - 1, 4).astype(int))]
    known = [_without_motion(piece, np.zeros(0), steps, rate_hz) for piece in looked]
    places = [_onsets(volts, fitted, noise_v) for volts, fitted in known]
    waveform = None
    for turn in range(ROUNDS):
        echo = echo_samples(rate_hz)
        rows = [_snippets(volts, fitted, own, echo) for (volts, fitted), own in zip(known, places, strict=True)]
        snippets, fractions = np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
        strong = np.argsort(-np.abs(snippets).max(axis=1))[:MOST] if len(snippets) else np.zeros(0, np.int64)
        waveform = learn_waveform(snippets[strong], fractions[strong], noise_v, rate_hz, few)
        if waveform is None:
            return None
        if turn == ROUNDS - 1:
            break
        places = []
        for k, piece in enumerate(looked):
            witness = ImpactScan(waveform, rate_hz)
            witness.add(piece.channels["accelerometer"], 0, PAD, piece.count)
            own = witness.impacts().time_s * rate_hz + PAD
            places.append(own)
            known[k] = _without_motion(piece, own, steps, rate_hz)
    return waveform


def _onsets(volts: Floats, fitted: npt.NDArray[np.bool_], noise_v: float) -> Floats:
    """Places in a piece where something strong begins after a quiet stretch."""
    past = np.convolve(volts, np.ones(6) / 6.0)[: volts.size]
    error = np.abs(volts[1:] - past[:-1]) / (noise_v * np.sqrt(7.0 / 6.0))
    known = np.convolve(fitted, np.ones(8))[: volts.size] > 7.5  # the past it is held against is known too
    loud = np.flatnonzero((error > ONSET) & known[1:]) + 1
    first = loud[np.diff(loud, prepend=-QUIET_SAMPLES) >= QUIET_SAMPLES]
    peak = np.array([np.abs(volts[n : n + LEAD]).max() for n in first])
    if not first.size:
        return np.zeros(0)
    enough = peak > max(STRONG * noise_v, 0.3 * float(np.quantile(peak, 0.9)))
    return np.asarray(first[enough] - 0.5, dtype=np.float64)


def _snippets(volts: Floats, fitted: npt.NDArray[np.bool_], places: Floats, echo: int) -> tuple[Floats, Floats]:
    """Accelerometer around impacts far from others, and their place before the sample."""
    alone = (np.append(np.diff(places), np.inf) > echo) & (np.diff(places, prepend=-np.inf) > echo)
    sample = np.ceil(places).astype(np.int64)
    index = sample[:, None] + np.arange(-LEAD, echo - LEAD)
    inside = alone & (index[:, 0] >= 0) & (index[:, -1] < volts.size)
    index, fractions = index[inside], (sample - places)[inside]
    usable = fitted[index].all(axis=1)
    return volts[index[usable]], fractions[usable]


def _without_motion(
    piece: Piece, places: Floats, steps: npt.NDArray[np.void], rate_hz: float
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Accelerometer volts less each step's tones (fitted away from impacts), and where a fit was possible."""
    volts = piece.channels["accelerometer"].astype(np.float64)
    fitted = np.zeros(volts.size, dtype=np.bool_)
    quiet = np.ones(volts.size, dtype=np.bool_)
    for place in places.astype(np.int64):
        quiet[max(place - 4, 0) : max(place + int(MASK_S * rate_hz), 0)] = False
    ends = steps["first_sample"] + steps["n_samples"]
    for row in steps[(ends > piece.first) & (steps["first_sample"] < piece.last)]:
        start = max(int(row["first_sample"] + row["settle_samples"]), piece.first)
        stop = min(int(row["first_sample"] + row["n_samples"]), piece.last)
        if stop - start < 3.0 * rate_hz / row["frequency_hz"]:
            continue
        own = slice(start - piece.first + PAD, stop - piece.first + PAD)
        try:
            fit = _motion(volts[own], start, rate_hz, row, quiet[own])
        except ValueError:  # too little is quiet in this piece of the step
            continue
        volts[own] -= fit.offset
        _subtract_tones(volts[own], start, fit.frequencies_hz / rate_hz, fit.amplitudes)
        fitted[own] = True
    return volts, fitted


def _motion(volts: Floats, start: int, rate_hz: float, row: np.void, quiet: npt.NDArray[np.bool_]) -> ToneFit:
    """The plate's tones in a piece of a step: the usual ones, and harmonics and mains lines that stand out.

    Hum and distortion that are left in would pass for ringing; harmonics that are not there fill the masked holes.
    """
    first = float(row["frequency_hz"])
    usual = first * np.unique([1, 2, 3, row["ratio"]])
    tones_hz = first * np.array(multiples_of(int(row["ratio"])))
    tones_hz = np.append(tones_hz, lines_apart(MAINS_HZ, tones_hz, volts.size / rate_hz))
    fit = fit_tones(volts, start, rate_hz, tones_hz, quiet)
    there = np.isin(tones_hz, usual) | (np.abs(fit.amplitudes) > STANDS_OUT * fit.amplitude_sigma())
    return fit if there.all() else fit_tones(volts, start, rate_hz, tones_hz[there], quiet)


@njit(error_model="numpy")
def _subtract_tones(x, first, cycles, amplitudes):  # type: ignore[no-untyped-def]
    """Take tones out of ``x``, whose first sample is sample ``first``, in place."""
    phasor = amplitudes.copy()
    step = np.exp(2j * np.pi * cycles)
    for i in range(x.shape[0]):
        if i % 512 == 0:
            for j in range(cycles.shape[0]):
                phase = cycles[j] * (first + i)
                phasor[j] = amplitudes[j] * np.exp(2j * np.pi * (phase - np.floor(phase)))
        for j in range(cycles.shape[0]):
            x[i] -= phasor[j].real
            phasor[j] *= step[j]
