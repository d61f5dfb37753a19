"""Impact template estimated from the accelerometer.

Strong isolated onsets are aligned and averaged, then aligned again by their average. The contact circuit is not used:
it may be late, or close only at the end of a chatter. `analysis.events.sensor_offset.calibrate` then measures the delay
between the template's onset and the contact edge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from analysis.events.impact_detection import ImpactScan
from analysis.events.impact_template import (
    ECHOES_S,
    LEAD,
    LENGTH,
    MIN_LANDINGS,
    THRESHOLD,
    ImpactTemplate,
    echo_samples,
    rings_on,
    template_from_snippets,
    thinning,
)
from analysis.plate.mains_lines import MAINS_HZ, SIGNIFICANT, separable_lines
from analysis.plate.step_state import multiples_of
from analysis.signals.stream import Piece
from analysis.statistics import CORE, core_sigma
from daq.instrument.noise_spectrum import PREDICTED_FROM, NoiseSpectrum, measure_noise
from daq.instrument.saturation import STANDS, share_at_an_end
from daq.lock_in import LockIn, ToneFit
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

TAIL = 3.0  # standard deviations from which a detector's output counts as its tail
FALSE_PER_HOUR = 0.1  # impacts that noise may make in an hour of recording
MASK_S = 4e-3  # mask after an impact in the tone fits made here
QUIET_SAMPLES = 60  # samples without an onset before an onset
ONSET_SIGMAS = 6.0  # standard deviations of noise that make an onset
STRONG_SIGMAS, STRONG_PART = 12.0, 0.3  # least peak used, in standard deviations and as a part of the usual strong peak
NOTICED = 0.05  # of an impact's strength, from which another one nearby changes its waveform
N_ALIGNMENTS = 2
MAX_IMPACTS = 400  # strongest impacts used
N_BASIS_TONES = 4  # frequencies of the recording that the filter is made blind to
MIN_CYCLES = 3.0  # cycles of the forcing needed to fit the motion


def scale_and_threshold(quiet: Floats, rate_hz: float) -> tuple[float, float]:
    """Standard deviation of a detector's output where nothing happens, and its threshold in that unit.

    The tail beyond `TAIL` standard deviations is taken as exponential in the square, as a normal distribution's is,
    with the decay that the output shows. The threshold lets `FALSE_PER_HOUR` of its maxima pass in an hour.

    Parameters
    ----------
    quiet : array, shape (n,)
        Output of a filter, in the order of time.
    rate_hz : float
        Outputs a second.
    """
    deviation = np.abs(quiet)
    # fewer outputs show no tail: the filter's noise is taken as it was computed
    if deviation.size < 1024:
        return 1.0, 0.0
    scale = core_sigma(deviation, float(np.quantile(deviation[::8], CORE)))
    up = quiet[1:-1]
    tops = up[(up > TAIL * scale) & (up >= quiet[:-2]) & (up > quiet[2:])] / scale
    decay, per_hour = 1.0, max(tops.size, 1) / quiet.size * rate_hz * 3600.0
    if tops.size:
        measured = float(np.median(tops**2 - TAIL**2)) / (2.0 * np.log(2.0))
        # a tail that is heavier by less than three standard errors is taken for that of normal noise
        decay = measured if measured > 1.0 + 3.0 * measured / np.sqrt(tops.size) else 1.0
    return scale, float(np.sqrt(TAIL**2 + 2.0 * decay * np.log(max(per_hour / FALSE_PER_HOUR, 1.0))))


@dataclass(frozen=True)
class _Stretch:
    """Part of a step in a piece: its first sample, its place there, the normal equations of all its samples, and which
    of their tones are always fitted."""

    start: int
    own: slice
    every: LockIn
    main: Bools


class _Found(NamedTuple):
    """Impacts in a piece: places in samples, strengths, and which may serve for the template, (n,) each."""

    places: Floats
    strength: Floats
    used: Bools


def estimate_template(
    pieces: list[Piece], steps: npt.NDArray[np.void], rate_hz: float, gaps: Integers | None = None
) -> tuple[NoiseSpectrum | None, ImpactTemplate | None]:
    """Noise of the accelerometer and impact template from a few pieces of a recording.

    Parameters
    ----------
    pieces
        With channel ``accelerometer``.
    steps : STEP_DTYPE array
        Frequencies filled in.
    rate_hz
        Sampling rate.
    gaps : int array, shape (k, 2)
        Sample before which samples were lost, and how many: the motion's phase jumps there.

    Returns
    -------
    NoiseSpectrum or None
        Of means over `thinning` samples; None where the pieces are too short, or the channel stands still.
    ImpactTemplate or None
        None where the accelerometer shows no impacts.
    """
    width = thinning(rate_hz)
    if width > 1:
        pieces, rate_hz = [piece.thinned(width) for piece in pieces], rate_hz / width
    steps = _unbroken(steps, np.zeros(0, np.int64) if gaps is None else gaps[:, 0], width)
    tones_hz = np.unique(np.concatenate([steps["frequency_hz"], steps["frequency_hz"] * steps["ratio"]]))
    few = tones_hz[np.unique(np.linspace(0, tones_hz.size - 1, N_BASIS_TONES).astype(int))]
    stretches = [_stretches(piece, steps, rate_hz) for piece in pieces]
    nothing = [np.zeros(0) for _ in pieces]
    still = [_without_motion(*own, rate_hz) for own in zip(pieces, pieces, stretches, nothing, strict=True)]
    noise = _noise(still, nothing, rate_hz, 0)
    if noise is None:
        return None, None
    found = [_onsets(volts, fitted, noise) for volts, fitted in still]
    echo, template, places = _echo(still, found, rate_hz), None, nothing
    for turn in range(N_ALIGNMENTS):
        snippets, fractions = _all_snippets(still, found, echo)
        most = np.argsort(-np.abs(snippets).max(axis=1))[:MAX_IMPACTS] if len(snippets) else np.zeros(0, np.int64)
        template = template_from_snippets(snippets[most], fractions[most], noise, few)
        if template is None:
            return noise, None
        detectors = [_detector(piece, template, rate_hz) for piece in pieces]
        impacts = [d.impacts() for d in detectors]
        places = [own.time_s * rate_hz + piece.pad for own, piece in zip(impacts, pieces, strict=True)]
        every = [np.ones(at.size, dtype=np.bool_) for at in places]
        found = [_Found(at, own.strength, used) for at, own, used in zip(places, impacts, every, strict=True)]
        if turn < N_ALIGNMENTS - 1:
            # what still rings after the mask would bend the tones
            clean = [_without_impacts(*own) for own in zip(pieces, detectors, strict=True)]
            stretches = [_stretches(piece, steps, rate_hz) for piece in clean]
            still = [_without_motion(*own, rate_hz) for own in zip(pieces, clean, stretches, places, strict=True)]
        if turn == 0:
            noise = _noise(still, places, rate_hz, echo) or noise
    if template is not None:
        template = replace(_with_threshold(template, pieces, still, places, rate_hz, echo), width=width)
    return noise, template


def _echo(still: list[tuple[Floats, Bools]], found: list[_Found], rate_hz: float) -> int:
    """Samples of the template: as long as the table rings, where enough landings stand so far from others."""
    echo = echo_samples(rate_hz)
    for length_s in ECHOES_S:
        snippets, _ = _all_snippets(still, found, echo_samples(rate_hz, length_s))
        if len(snippets) < MIN_LANDINGS:
            break
        echo = snippets.shape[1]
        if not rings_on(snippets, rate_hz):
            break
    return echo


def _all_snippets(still: list[tuple[Floats, Bools]], found: list[_Found], echo: int) -> tuple[Floats, Floats]:
    rows = [_snippets(*one, own, echo) for one, own in zip(still, found, strict=True)]
    return np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])


def _quiet(fitted: Bools, places: Floats, echo: int) -> Bools:
    """Samples of a piece whose motion is known and that no impact in it reaches."""
    quiet = fitted.copy()
    for place in places.astype(np.int64):
        quiet[max(place - LENGTH, 0) : max(place + echo, 0)] = False
    return quiet


def _noise(still: list[tuple[Floats, Bools]], places: list[Floats], rate_hz: float, echo: int) -> NoiseSpectrum | None:
    quiet = [_quiet(fitted, own, echo) for (_, fitted), own in zip(still, places, strict=True)]
    return measure_noise([volts for volts, _ in still], quiet, rate_hz)


def _detector(piece: Piece, template: ImpactTemplate, rate_hz: float) -> ImpactScan:
    """The impacts in a piece."""
    detector = ImpactScan(template, rate_hz)
    detector.add(piece.channels["accelerometer"], 0, piece.pad, piece.count)
    return detector


def _without_impacts(piece: Piece, detector: ImpactScan) -> Piece:
    """The piece with the ringing of its impacts subtracted."""
    volts = piece.channels["accelerometer"].copy()
    detector.subtract_impacts(volts, 0, piece.pad)
    return replace(piece, channels={**piece.channels, "accelerometer": volts})


def _with_threshold(
    template: ImpactTemplate,
    pieces: list[Piece],
    still: list[tuple[Floats, Bools]],
    places: list[Floats],
    rate_hz: float,
    echo: int,
) -> ImpactTemplate:
    """The template with unit and threshold from its filter's own output where nothing happens."""
    outputs = []
    for piece, (_, fitted), own in zip(pieces, still, places, strict=True):
        found = np.correlate(piece.channels["accelerometer"].astype(np.float64), template.taps.astype(np.float64))
        reached = np.convolve(~_quiet(fitted, own, echo), np.ones(LENGTH))[LENGTH - 1 :][: found.size] > 0.5
        outputs.append(found[~reached])
    scale, threshold = scale_and_threshold(np.concatenate(outputs), rate_hz)
    return replace(
        template,
        taps=template.taps / np.float32(scale),
        whitener=template.whitener / scale,
        threshold=max(threshold, THRESHOLD),
    )


def _unbroken(steps: npt.NDArray[np.void], breaks: Integers, width: int) -> npt.NDArray[np.void]:
    """Steps cut where samples were lost, counted in means over ``width`` samples."""
    rows = []
    for row in steps:
        first = int(row["first_sample"])
        end = first + int(row["n_samples"])
        first += int(row["settle_samples"])
        bounds = [first, *(int(b) for b in breaks if first < b < end), max(end, first)]
        for start, stop in pairwise(bounds):
            own = row.copy()
            own["first_sample"], own["settle_samples"] = -(-start // width), 0
            own["n_samples"] = max(stop // width - int(own["first_sample"]), 0)
            rows.append(own)
    return np.array(rows, dtype=steps.dtype)


def _onsets(volts: Floats, fitted: Bools, noise: NoiseSpectrum) -> _Found:
    """Places in a piece where a signal begins after a quiet interval; used are the strong ones."""
    surprise = np.abs(noise.innovations(volts))
    span = PREDICTED_FROM + 1
    known = np.convolve(fitted, np.ones(span))[: volts.size] > span - 0.5  # its past is fitted, too
    loud = np.flatnonzero((surprise > ONSET_SIGMAS) & known)
    first = loud[np.diff(loud, prepend=-QUIET_SAMPLES) >= QUIET_SAMPLES]
    peak = np.array([surprise[n : n + LEAD].max() for n in first])
    usual = float(np.quantile(peak, 0.9)) if first.size else 0.0
    return _Found(np.asarray(first - 0.5, dtype=np.float64), peak, peak > max(STRONG_SIGMAS, STRONG_PART * usual))


def _snippets(volts: Floats, fitted: Bools, found: _Found, echo: int) -> tuple[Floats, Floats]:
    """Accelerometer around impacts far from all others, and the impacts' time before the sample, in samples.

    One that is much weaker does not count as another: what a loud one still rings may be taken for one.
    """
    places, strength, used = found
    near = np.abs(places[:, None] - places) <= echo
    np.fill_diagonal(near, False)
    isolated = used & ~np.any(near & (strength > NOTICED * strength[:, None]), axis=1)
    sample = np.ceil(places).astype(np.int64)
    index = sample[:, None] + np.arange(-LEAD, echo - LEAD)
    inside = isolated & (index[:, 0] >= 0) & (index[:, -1] < volts.size)
    index, fractions = index[inside], (sample - places)[inside]
    usable = fitted[index].all(axis=1)
    return volts[index[usable]], fractions[usable]


def _stretches(piece: Piece, steps: npt.NDArray[np.void], rate_hz: float) -> list[_Stretch]:
    """The parts of steps in a piece that are long enough to fit their motion."""
    volts = piece.channels["accelerometer"].astype(np.float64)
    ends, found = steps["first_sample"] + steps["n_samples"], []
    for row in steps[(ends > piece.first) & (steps["first_sample"] < piece.last)]:
        start = max(int(row["first_sample"] + row["settle_samples"]), piece.first)
        stop = min(int(row["first_sample"] + row["n_samples"]), piece.last)
        if stop - start < MIN_CYCLES * rate_hz / row["frequency_hz"]:
            continue
        own = slice(start - piece.first + piece.pad, stop - piece.first + piece.pad)
        if share_at_an_end(volts[own], rate_hz) > STANDS:
            continue  # the edges of what is cut off would look like impacts
        first, ratio = float(row["frequency_hz"]), int(row["ratio"])
        tones_hz = first * np.array(multiples_of((1, ratio)))
        tones_hz = np.append(tones_hz, separable_lines(MAINS_HZ, tones_hz, (stop - start) / rate_hz))
        every = LockIn(rate_hz, tones_hz)
        every.add(volts[own], start)
        found.append(_Stretch(start, own, every, np.isin(tones_hz, first * np.unique([1, 2, 3, ratio]))))
    return found


def _without_motion(
    piece: Piece, clean: Piece, stretches: list[_Stretch], places: Floats, rate_hz: float
) -> tuple[Floats, Bools]:
    """Accelerometer volts less tones of each step (by ``clean`` outside impacts), and where a fit was possible."""
    volts, fit_to = (p.channels["accelerometer"].astype(np.float64) for p in (piece, clean))
    fitted = np.zeros(volts.size, dtype=np.bool_)
    ringing = np.zeros(volts.size, dtype=np.bool_)
    for place in places.astype(np.int64):
        ringing[max(place - 4, 0) : max(place + int(MASK_S * rate_hz), 0)] = True
    for part in stretches:
        own = part.own
        try:
            fit = _motion(part, fit_to[own], ringing[own])
        except ValueError:  # too few unmasked samples in this piece of the step
            continue
        volts[own] -= fit.offset
        _subtract_tones(volts[own], part.start, fit.frequencies_hz / rate_hz, fit.amplitudes)
        fitted[own] = True
    return volts, fitted


def _motion(part: _Stretch, volts: Floats, ringing: Bools) -> ToneFit:
    """Plate tones outside impacts: the main ones, and harmonics and mains lines that are significant.

    Hum and distortion left in would look like ringing; absent harmonics would fit noise into the masked intervals.
    """
    masked = LockIn(part.every.rate_hz, part.every.frequencies_hz)
    masked.add(volts, part.start, ringing)  # few samples: the sums over the others are not made anew
    outside = part.every - masked
    fit = outside.solve()
    present = part.main | (np.abs(fit.amplitudes) > SIGNIFICANT * fit.amplitude_sigma())
    return fit if present.all() else outside.only(present).solve()


@njit(error_model="numpy")
def _subtract_tones(x, first, cycles, amplitudes):  # type: ignore[no-untyped-def]
    """Subtract tones from ``x``, whose first sample is sample ``first``, in place."""
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
