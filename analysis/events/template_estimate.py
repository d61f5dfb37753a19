"""Impact template estimated from the accelerometer.

What the samples before predict, as they predict ringing, is no impact; what they do not predict is. Strong impacts are
averaged up to the next one, and what they ring then is continued as it is predicted. With that waveform impacts are
found and taken away, and each is put back by itself into the next average. The contact circuit is not used: it may be
late, or close only at the end of a chatter. `analysis.events.sensor_offset.calibrate` then measures the delay
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
    FINE,
    LEAD,
    LENGTH,
    MIN_ECHO,
    MIN_LANDINGS,
    THRESHOLD,
    ImpactTemplate,
    echo_samples,
    template_from_snippets,
    thinning,
)
from analysis.linear_algebra import lstsq
from analysis.plate.mains_lines import MAINS_HZ, SIGNIFICANT, separable_lines
from analysis.plate.step_state import multiples_of
from analysis.signals import Piece, near, unpredicted
from analysis.statistics import core_sigma
from daq.instrument.channel_limits import STANDS, NoiseSpectrum, measure_noise, share_at_an_end
from daq.lock_in import LockIn, ToneFit
from daq.setup.setup import Forcing
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

TAIL = 3.0  # standard deviations from which a detector's output counts as its tail
FALSE_PER_HOUR = 0.1  # impacts that noise may make in an hour of recording
PREDICTED_FROM = 16  # samples from which the next one is predicted: some modes of a table and a filter's
QUIET_SAMPLES = 30  # samples without an onset before an onset
ONSET_SIGMAS = 6.0  # standard deviations of what is not predicted that make an onset
NOTICED = 0.05  # of an impact's strength, from which another one nearby changes its waveform
N_ALIGNMENTS = 3


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
    scale = core_sigma(deviation, 8)
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
    """Part of a step in a piece: first sample, place there, normal equations of all, tones that are always fitted."""

    start: int
    own: slice
    every: LockIn
    main: Bools


class _Found(NamedTuple):
    """Impacts in a piece: places in samples, strengths, sizes in units of a template, and the samples from each to the
    next one, (n,) each."""

    places: Floats
    strength: Floats
    sizes: Floats
    free: Floats


def estimate_template(
    pieces: list[Piece], steps: npt.NDArray[np.void], rate_hz: float, forcing: Forcing, gaps: Integers | None = None
) -> tuple[NoiseSpectrum | None, ImpactTemplate | None]:
    """Noise of the accelerometer and impact template from a few pieces of a recording.

    Parameters
    ----------
    pieces, rate_hz
        With channel ``accelerometer``; their sampling rate.
    steps : STEP_DTYPE array
        Frequencies filled in.
    forcing
        The recording's: all its tones are motion.
    gaps : int array, shape (k, 2)
        Sample before which samples were lost, and how many: the motion's phase jumps there.

    Returns
    -------
    NoiseSpectrum or None, ImpactTemplate or None
        Noise of means over `thinning` samples, None where pieces are too short or the channel stands still; no template
        where the accelerometer shows no impacts.
    """
    width = thinning(rate_hz)
    if width > 1:
        pieces, rate_hz = [piece.thinned(width) for piece in pieces], rate_hz / width
    steps = _unbroken(steps, np.zeros(0, np.int64) if gaps is None else gaps[:, 0], width)
    tones_hz = np.unique(np.concatenate([steps["frequency_hz"], steps["frequency_hz"] * steps["ratio"]]))
    # the filter is made blind to four of the recording's frequencies: others lie between them
    few = tones_hz[np.unique(np.linspace(0, tones_hz.size - 1, 4).astype(int))]
    stretches = [_stretches(piece, steps, rate_hz, forcing) for piece in pieces]
    nothing = [np.zeros(0) for _ in pieces]
    still = [_without_motion(*own, rate_hz) for own in zip(pieces, pieces, stretches, nothing, strict=True)]
    noise = _noise(still, nothing, rate_hz, 0)
    if noise is None:
        return None, None
    prediction, left = _prediction(still, noise.rms_v)
    found, clean = [_begun(own) for own in left], still
    template: ImpactTemplate | None = None
    for turn in range(N_ALIGNMENTS):
        for longer in (1, 2):  # as short as the last one, it may have no room for slow motion to show
            snippets, fractions = _all_snippets(clean, found, rate_hz, template, longer)
            most = np.argsort(-np.abs(snippets[:, :LENGTH]).max(axis=1))[:400]  # the strongest
            mean = template_from_snippets(snippets[most], fractions[most], noise, few, prediction, aligned=turn > 0)
            if mean is not None or template is None:
                break
        if (template := mean) is None:
            break
        detectors = [ImpactScan(template, rate_hz) for _ in pieces]
        for own, piece in zip(detectors, pieces, strict=True):
            own.add(piece.channels["accelerometer"], 0, piece.pad, piece.count)
        found = [_again(own, piece.pad, rate_hz) for own, piece in zip(detectors, pieces, strict=True)]
        if turn < N_ALIGNMENTS - 1:
            still, clean = _taken_away(pieces, detectors, found, steps, rate_hz, forcing)
        if turn == 0:
            noise = _noise(still, [own.places for own in found], rate_hz, template.fine.size // FINE) or noise
    if template is None:
        return noise, None
    return noise, replace(_with_threshold(template, pieces, still, found, rate_hz), width=width)


def _taken_away(
    pieces: list[Piece],
    detectors: list[ImpactScan],
    found: list[_Found],
    steps: npt.NDArray[np.void],
    rate_hz: float,
    forcing: Forcing,
) -> tuple[list[tuple[Floats, Bools]], list[tuple[Floats, Bools]]]:
    """The pieces without motion, and without the impacts found as well."""
    # what still rings after the mask would bend the tones
    without = []
    for piece, detector in zip(pieces, detectors, strict=True):
        volts = piece.channels["accelerometer"].copy()
        detector.subtract_impacts(volts, 0, piece.pad)
        without.append(replace(piece, channels={**piece.channels, "accelerometer": volts}))
    stretches = [_stretches(piece, steps, rate_hz, forcing) for piece in without]
    places = [own.places for own in found]
    learnt = detectors[0].template.fine.size / FINE - LEAD
    still = [_without_motion(*own, rate_hz, learnt) for own in zip(pieces, without, stretches, places, strict=True)]
    clean = [
        (volts + left.channels["accelerometer"] - piece.channels["accelerometer"], fitted)
        for (volts, fitted), left, piece in zip(still, without, pieces, strict=True)
    ]
    return still, clean


def _all_snippets(
    clean: list[tuple[Floats, Bools]], found: list[_Found], rate_hz: float, template: ImpactTemplate | None, longer: int
) -> tuple[Floats, Floats]:
    echo = echo_samples(rate_hz)
    if template is not None:
        echo = min(longer * template.fine.size // FINE, echo)
    strength = np.concatenate([own.strength for own in found])
    # weak impacts would only add noise: those used stand out of it, and are no small part of the usual strong ones
    least = max(12.0, 0.3 * float(np.quantile(strength, 0.9))) if strength.size else 0.0
    while True:
        rows = [_snippets(*one, own, least, echo, template) for one, own in zip(clean, found, strict=True)]
        volts, fractions = np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
        # a ball that lands every few milliseconds never leaves the longest ringing its time
        if template is not None or len(volts) >= MIN_LANDINGS or echo < 2 * MIN_ECHO:
            return volts, fractions
        echo //= 2


def _quiet(fitted: Bools, places: Floats, echo: int) -> Bools:
    """Samples of a piece whose motion is known and that no impact in it reaches."""
    quiet = fitted.copy()
    for place in places.astype(np.int64):
        quiet[max(place - LENGTH, 0) : max(place + echo, 0)] = False
    return quiet


def _noise(still: list[tuple[Floats, Bools]], places: list[Floats], rate_hz: float, echo: int) -> NoiseSpectrum | None:
    quiet = [_quiet(fitted, own, echo) for (_, fitted), own in zip(still, places, strict=True)]
    return measure_noise([volts for volts, _ in still], quiet, rate_hz)


def _with_threshold(
    template: ImpactTemplate,
    pieces: list[Piece],
    still: list[tuple[Floats, Bools]],
    found: list[_Found],
    rate_hz: float,
) -> ImpactTemplate:
    """The template with unit and threshold from its filter's own output where nothing happens."""
    outputs = []
    for piece, (_, fitted), own in zip(pieces, still, found, strict=True):
        output = np.correlate(piece.channels["accelerometer"].astype(np.float64), template.taps.astype(np.float64))
        quiet = _quiet(fitted, own.places, template.fine.size // FINE)
        reached = near(~quiet, LENGTH - 1, 0)[: output.size]
        outputs.append(output[~reached])
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


def _prediction(still: list[tuple[Floats, Bools]], noise_v: float) -> tuple[Floats, list[Floats]]:
    """Weights (`PREDICTED_FROM`,) that predict a sample from those before, the last one first, and what they leave of
    each piece, in its standard deviation; 0 where the motion is not known. The noise is ``noise_v``.
    Impacts are not predicted, and a bounce that always comes alike must not be: where the first weights find one, the
    next do not count.
    """
    lags = np.arange(PREDICTED_FROM + 1)
    known = [~near(~fitted, 0, PREDICTED_FROM) & (np.arange(fitted.size) >= PREDICTED_FROM) for _, fitted in still]
    every_nth = sum(np.count_nonzero(own) for own in known) // 16384 + 1  # so many predictions are enough
    looked, left = [np.flatnonzero(own)[::every_nth] for own in known], [np.zeros(own.size) for own in known]
    for _ in range(3):
        products = np.zeros((lags.size, lags.size))
        for (volts, _), places, own in zip(still, looked, left, strict=True):
            places = places[~near(own > ONSET_SIGMAS, LEAD - 1, LEAD)[places]]
            rows = volts[places[:, None] - lags]
            products += rows.T @ rows
            # a thousandth of the noise, but white: smooth samples are predicted by differences that grow without end
            products += len(rows) * 1e-3 * noise_v**2 * np.eye(lags.size)
        weights: Floats = np.append(1.0, -lstsq(products[1:, 1:], products[1:, 0])[0])
        left = [unpredicted(volts, weights, own) for (volts, _), own in zip(still, known, strict=True)]
        sizes = np.concatenate([own[places] for own, places in zip(left, looked, strict=True)])
        sigma = core_sigma(sizes) if sizes.size else 1.0
        left = [own / max(sigma, 1e-300) for own in left]
    return -weights[1:], left


def _begun(left: Floats) -> _Found:
    """Impacts in a piece's prediction errors ``left``; what follows each begins where their power grows again."""
    loud = np.flatnonzero(left > ONSET_SIGMAS)
    first = loud[np.diff(loud, prepend=-QUIET_SAMPLES) >= QUIET_SAMPLES]
    power = np.convolve(left**2, np.ones(LEAD) / LEAD)[: left.size]
    after = np.minimum(first[:, None] + np.arange(LENGTH), left.size - 1)
    peak, most = left[after[:, :LEAD]].max(axis=1), power[after].max(axis=1)
    # another impact makes the power of a dozen of them grow by more than this
    rises = power > 2.5 * np.maximum(np.append(np.full(LEAD, np.inf), power)[: power.size], 1.0)
    free, rising = np.empty(first.size), np.flatnonzero(rises)
    for k, n in enumerate(first + 2 * LEAD):  # another may have begun two windows before its power shows
        later = rising[np.searchsorted(rising, n) :]
        free[k] = next(iter(later[power[later] > NOTICED**2 * most[k]]), np.inf) - n
    return _Found(np.asarray(first - 0.5, dtype=np.float64), peak, np.zeros(first.size), free)


def _again(detector: ImpactScan, pad: int, rate_hz: float) -> _Found:
    """The impacts of a detector in a piece that begins ``pad`` samples before."""
    impacts = detector.impacts()
    places, strength = impacts.time_s * rate_hz + pad, impacts.strength
    later = places - places[:, None]
    free = np.where((later > 0.0) & (strength > NOTICED * strength[:, None]), later, np.inf)
    return _Found(places, strength, detector.sizes, free.min(axis=1, initial=np.inf))


def _snippets(
    volts: Floats, fitted: Bools, found: _Found, least: float, echo: int, template: ImpactTemplate | None
) -> tuple[Floats, Floats]:
    """Accelerometer around impacts of strength ``least``, and the impacts' time before the sample, in samples.

    With a ``template``, ``volts`` are less every impact, and the own one is put back; without one a landing is not
    known (NaN) from the next one on. The one before has died away; one that is much weaker does not count.
    """
    places, strength, sizes, free = found
    since = places[:, None] - places
    before = np.where((since > 0.0) & (strength > NOTICED * strength[:, None]), since, np.inf)
    used = (strength > least) & (free > LENGTH - LEAD) & (before.min(axis=1, initial=np.inf) > echo)
    sample = np.ceil(places).astype(np.int64)
    index = sample[:, None] + np.arange(-LEAD, echo - LEAD)
    used &= (index[:, 0] >= 0) & (index[:, -1] < volts.size)
    index, fractions = index[used], (sample - places)[used]
    rows, column = volts[index], np.arange(echo)
    if template is None:
        rows[column > LEAD + free[used, None]] = np.nan
    else:
        own = np.interp((column + fractions[:, None]) * FINE, np.arange(template.fine.size), template.fine, right=0.0)
        rows += sizes[used, None] * own
    usable = fitted[index].all(axis=1)
    return rows[usable], fractions[usable]


def _stretches(piece: Piece, steps: npt.NDArray[np.void], rate_hz: float, forcing: Forcing) -> list[_Stretch]:
    """The parts of steps in a piece that are long enough to fit their motion."""
    volts = piece.channels["accelerometer"].astype(np.float64)
    ends, found = steps["first_sample"] + steps["n_samples"], []
    for row in steps[(ends > piece.first) & (steps["first_sample"] < piece.last)]:
        start = max(int(row["first_sample"] + row["settle_samples"]), piece.first)
        stop = min(int(row["first_sample"] + row["n_samples"]), piece.last)
        if stop - start < 3.0 * rate_hz / row["frequency_hz"]:  # cycles, fewer of which do not tell the motion
            continue
        own = slice(start - piece.first + piece.pad, stop - piece.first + piece.pad)
        if share_at_an_end(volts[own], rate_hz) > STANDS:
            continue  # the edges of what is cut off would look like impacts
        first, driven = float(row["frequency_hz"]), forcing.multiples_at(int(row["ratio"]))
        tones_hz = first * np.array(multiples_of(driven))
        tones_hz = np.append(tones_hz, separable_lines(MAINS_HZ, tones_hz, (stop - start) / rate_hz))
        every = LockIn(rate_hz, tones_hz)
        every.add_stretches(volts[own], np.array([start, stop]))
        found.append(_Stretch(start, own, every, np.isin(tones_hz, first * np.unique([1, 2, 3, *driven]))))
    return found


def _without_motion(
    piece: Piece, clean: Piece, stretches: list[_Stretch], places: Floats, rate_hz: float, learnt: float = 0.0
) -> tuple[Floats, Bools]:
    """Accelerometer volts less tones of each step (by ``clean`` outside impacts), and where a fit was possible."""
    volts, fit_to = (p.channels["accelerometer"].astype(np.float64) for p in (piece, clean))
    fitted, ringing = np.zeros((2, volts.size), dtype=np.bool_)
    # slow motion that a template of ``learnt`` samples holds by mistake is in what it takes away, and would stay in it
    after = max(4e-3 * rate_hz, min(learnt, 0.3 * volts.size / (places.size + 1)))
    for place in places.astype(np.int64):
        ringing[max(place - LEAD, 0) : max(place + int(after), 0)] = True
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
    fit = (outside := part.every - masked).solve()
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
