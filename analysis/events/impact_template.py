"""Impact template: mean waveform of an impact in the accelerometer, and the filter matched to it.

No shape is assumed, only that it repeats. The time zero of the template is its onset.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from analysis.linear_algebra import lstsq
from daq.instrument.channel_limits import NoiseSpectrum
from kernels.arrays import Floats, Integers

LEAD, TAIL = 12, 36  # samples (see `thinning`) before and after an impact's first sample
LENGTH = LEAD + TAIL
ENOUGH_HZ = 20000.0  # rate at which a table's ringing shows; the filter is so many milliseconds long
MIN_ECHO = 128  # least samples of the template: an impact's ringing must not be taken for the next impact
ECHO_S, CONTINUED_S = 25.6e-3, 64e-3  # longest ringing that is learnt, and that is continued as it decays
FINE = 8  # template points per sample
RESIDUAL_PART = 0.1  # part of the waveform that its subtraction may leave
LOUD = 2.2  # rms over two samples, in the noise of a point, from which it is waveform
RINGS = 2.0  # power over `SLOW_S`, in that of a point's noise, above which it rings
SLOW_S = 1e-3  # averaging time that removes the ringing
BEND = 4.0  # `SLOW_S` in which the slow motion under a template bends once
BEGINNINGS, LEAST_DECAY = (1.0, 1.5, 2.0, 3.0, 4.0), 2.0  # `SLOW_S` after the peak and of ringing: fits of its decay
CUT_OFF = 0.03  # rms of the last quarter over the greatest value, above which only one mode's decay may be cut off
ONSET_SIGMAS = 5.0  # height in the noise of a point below which no onset is placed
MIN_LANDINGS = 6  # landings needed for a template
MIN_FAST_PART = 0.3  # least part of the template that the projector leaves
TYPICAL_HZ = 30.0  # impacts a second for which a mask is chosen
SHORTEST_MASK_S, LONGEST_MASK_S, LONGEST_PART = 1e-3, 8e-3, 0.6  # the longest, also as a part of a long template
THRESHOLD = 6.0  # least threshold of the filter's output, in standard deviations of the noise


@dataclass(frozen=True)
class ImpactTemplate:
    """Mean waveform of an impact in the accelerometer."""

    # mean waveform in volts per unit strength, (n * FINE,): ``FINE`` points a sample, the landing at ``LEAD * FINE``
    fine: Floats
    # filter (LENGTH,) matched to the waveform in the noise as measured, blind to constants, slopes and curvature (so to
    # the tones); the noise leaves it with a standard deviation of 1
    taps: npt.NDArray[np.float32]
    # square matrix: makes a snippet's noise white, of unit variance, removes constants, slopes, curvature and tones
    whitener: Floats
    ring_s: float  # time after an impact that is masked in the tone fits
    # output of the filter from which an impact is taken for one, in standard deviations of the noise
    threshold: float = THRESHOLD
    width: int = 1  # recorded samples averaged to one of the template's, see `thinning`


def motion_basis(length: int, powers: int, cycles_per_sample: Floats) -> Floats:
    """Orthonormal basis of the plate's motion over a snippet, shape (length, k): powers and tones.

    The powers span slow tones of any frequency; the tones are those too fast for that.
    """
    t = np.arange(length) - 0.5 * (length - 1)
    angle = 2.0 * np.pi * np.outer(cycles_per_sample, t)
    rows = np.vstack([np.vander(2.0 * t / length, powers).T, np.cos(angle), np.sin(angle)])
    u, size, _ = np.linalg.svd((rows / np.linalg.norm(rows, axis=1)[:, None]).T, full_matrices=False)
    return np.asarray(u[:, size > 1e-4 * size[0]])


def thinning(rate_hz: float) -> int:
    """Samples averaged before impacts are looked for, a power of two.

    A filter of `LENGTH` samples must last longer than a period of the ringing, or it takes it for slow motion.
    """
    width = 1
    while width < 8 and rate_hz / (2 * width) >= ENOUGH_HZ:
        width *= 2
    return width


def echo_samples(rate_hz: float) -> int:
    """Samples of the longest template."""
    return max(MIN_ECHO, round(ECHO_S * rate_hz))


def whitener(noise: NoiseSpectrum, tones_hz: Floats) -> Floats:
    """Matrix that makes a snippet's noise white, of unit variance, and its motion nothing, shape (LENGTH, LENGTH)."""
    white = noise.whitener(LENGTH)
    basis = np.linalg.qr(white @ motion_basis(LENGTH, 4, tones_hz / noise.rate_hz))[0]
    return np.asarray(white - basis @ (basis.T @ white))


def template_from_snippets(
    snippets: Floats,
    fractions: Floats,
    noise: NoiseSpectrum,
    tones_hz: Floats,
    prediction: Floats,
    *,
    aligned: bool = True,
) -> ImpactTemplate | None:
    """Impact template from snippets around known landings; None where the accelerometer shows no impacts.

    Parameters
    ----------
    snippets : array, shape (n, samples)
        Accelerometer volts less the plate's motion, not known (NaN) from a sample after `LENGTH` on; column ``LEAD`` is
        the first sample at or after the landing.
    fractions : array, shape (n,)
        Time from the landing to column ``LEAD``, in samples, in [0, 1).
    noise : NoiseSpectrum
        Of the accelerometer, at the snippets' rate.
    tones_hz : array
        Tones of the plate's motion.
    prediction : array, shape (k,)
        Weights that predict a sample of the ringing from those before, the last one first: it is so continued where no
        snippet shows it.
    aligned
        Whether a template placed the snippets; by the first sample heard strong impacts begin earlier than weak ones.
    """
    if snippets.shape[0] < MIN_LANDINGS:
        return None
    white = whitener(noise, tones_hz)
    flat = snippets[:, :LENGTH] @ white.T
    mean = np.median(flat, axis=0)
    strength = np.linalg.norm(mean)
    scatter = np.sqrt(0.5 * np.pi) * np.sqrt(LENGTH / snippets.shape[0])
    # a template repeats in both halves of the landings; a residue of the motion or of noise does not
    halves = [np.median(flat[i::2], axis=0) for i in (0, 1)]
    agreement = float(halves[0] @ halves[1]) / max(float(np.linalg.norm(halves[0]) * np.linalg.norm(halves[1])), 1e-300)
    least = max(3.0 * scatter, 4.0)  # in its error, and in the noise of a landing
    # landings at the first sample heard agree less than those that a template has aligned
    if strength < least or agreement < (0.7 if aligned else 0.4):
        return None
    size = flat @ (mean / strength)
    likeness = size / np.maximum(np.linalg.norm(flat, axis=1), 1e-300)
    # a landing placed a period of the ringing off would spoil the mean: it is less like it than most
    size[likeness < 0.75 * np.quantile(likeness, 0.75)] = 0.0
    fine, _ = _oversample(snippets, fractions, size, noise.rms_v)
    fine, sigma_v = _oversample(_level(snippets, fractions, size, fine), fractions, size, noise.rms_v)
    known = ringing_part(_continued(even(fine, noise.rate_hz), prediction, snippets.shape[1]), sigma_v, noise.rate_hz)
    if known is None:
        return None
    fine = _from_onset(known, sigma_v)
    # matched to the whole waveform, blind to the motion
    own = fine[: LENGTH * FINE : FINE]
    seen = white @ own
    norm = float(np.linalg.norm(seen))
    if not norm > MIN_FAST_PART * float(np.linalg.norm(noise.whitener(LENGTH) @ own)):  # as slow as the motion
        return None
    taps = (seen / norm) @ white
    return ImpactTemplate(fine, taps.astype(np.float32), white, _ring_s(fine, size, noise))


def _level(snippets: Floats, fractions: Floats, size: Floats, fine: Floats) -> Floats:
    """Snippets less the slow motion in which each differs from its mean waveform.

    Left in, it would look like ringing between the points of a sample, which come from different landings.
    """
    # the waveform by point of a sample and by sample, and the next sample's first point
    points = np.pad(fine, (0, (snippets.shape[1] + 1) * FINE - fine.size), mode="edge").reshape(-1, FINE).T
    points = np.vstack([points[:, :-1], points[:1, 1:]])
    left = snippets - size[:, None] * (_hats(fractions) @ points)
    slow, known = motion_basis(snippets.shape[1], 4, np.zeros(0)), np.isfinite(left)
    normal = np.einsum("nt,ti,tj->nij", known.astype(float), slow, slow, optimize=True)
    parts = np.linalg.solve(normal + 1e-6 * np.eye(4), (np.where(known, left, 0.0) @ slow)[:, :, None])
    return np.asarray(snippets - parts[:, :, 0] @ slow.T)


def _hats(fractions: Floats) -> Floats:
    """Weights (n, ``FINE`` + 1) of the points from one sample to the next, between two of which each place lies."""
    place, at = fractions * FINE, np.arange(FINE + 1)
    return np.asarray(np.maximum(1.0 - np.abs(place[:, None] - at), 0.0))


def _oversample(flat: Floats, fractions: Floats, size: Floats, noise_v: float) -> tuple[Floats, float]:
    """Mean waveform on ``FINE`` points a sample and the noise of a point.

    Hat functions at the sub-sample place of each snippet, weighted by its strength.
    """
    weight, seen = np.maximum(size, 0.0)[:, None] * np.isfinite(flat), flat[size > 0.0]
    sums = np.array([(x.T @ _hats(fractions)) for x in (weight * np.nan_to_num(flat), weight**2)])
    sums[:, 1:, 0] += sums[:, :-1, FINE]  # the point after a sample's last one is the next one's first
    top, bottom = sums[:, :, :FINE].reshape(2, -1)
    known = bottom > 0.03 * np.quantile(bottom, 0.9)  # a weak landing alone would amplify the noise
    mean = top / np.where(known, bottom, 1.0)
    enough = np.count_nonzero(np.isfinite(seen), axis=0) >= min(MIN_LANDINGS, len(seen))
    known &= np.repeat(enough, FINE)
    points = int(np.flatnonzero(known)[-1]) + 1
    grid, known = np.arange(points), known[:points]
    sigma_v = noise_v / float(np.sqrt(np.median(bottom[:points][known])))
    return np.asarray(np.interp(grid, grid[known], mean[:points][known])), sigma_v


def even(fine: Floats, rate_hz: float) -> Floats:
    """The waveform less slow motion in which the points of a sample differ: they come from different landings.

    Such motion would be subtracted from the recording after every impact, by the landing's place between two samples.
    """
    reach = FINE * max(round(0.5 * SLOW_S * rate_hz), 8)  # of samples, with a long motion at low rates
    whole = np.hanning(2 * reach + 1)  # one that ends in a jump would count ringing by the place of the samples
    every = np.where(np.arange(whole.size) % FINE == reach % FINE, whole, 0.0)
    # so would the bend in which an abrupt impact begins: it does not count
    since = np.arange(-reach, fine.size + reach) - int(np.argmax(np.abs(np.diff(fine))))
    weight = -np.expm1(-0.5 * (since / (2 * FINE)) ** 2)
    counted = weight * np.pad(fine, reach, mode="edge")
    own, mean = (np.convolve(counted, w, mode="valid") / np.convolve(weight, w, mode="valid") for w in (every, whole))
    return np.asarray(fine - own + mean)


def _continued(fine: Floats, prediction: Floats, samples: int) -> Floats:
    """The waveform to its sample ``samples``, predicted from the end of what is known as ringing is."""
    rows = fine[: fine.size // FINE * FINE].reshape(-1, FINE)
    out = np.zeros((samples, FINE))
    out[: len(rows)] = rows
    for k in range(len(rows), samples):
        out[k] = prediction @ out[k - prediction.size : k][::-1]
    return out.ravel()


def ringing_part(fine: Floats, sigma_v: float, rate_hz: float) -> Floats | None:
    """The waveform where its ringing is significant, its slow part removed; None where nothing is, or much is cut off.

    Noise left in the mean of a few landings would be added to the recording after every impact. Slow motion after a
    landing is that of the plate under another load, or what is not fitted of the forcing, and must not be subtracted.
    Ringing that decays as one mode is continued beyond the waveform's end: what is left of a loud impact there would
    be taken for impacts, and landings that stand so far from others as the table rings may be few.
    """
    width = max(round(SLOW_S * rate_hz * FINE), 1)
    # padded, so that no artificial jump is at either end
    quick = fine - np.convolve(np.pad(fine, width, mode="edge"), np.ones(width) / width, mode="same")[width:-width]
    loud = np.convolve(quick**2, np.ones(2 * FINE) / (2 * FINE), mode="same") > (LOUD * sigma_v) ** 2
    peak = int(np.argmax(np.abs(quick)))
    if not loud[peak]:
        return None
    begin = int(np.flatnonzero(loud)[0]) - FINE
    power = np.convolve(quick**2, np.ones(brief := min(width, fine.size)) / brief, mode="same")  # both may be short
    last = np.append(peak, peak + np.flatnonzero((loud & (power > RINGS * sigma_v**2))[peak:]))
    # what is loud after 4 ms of silence is the next impact, or, below a thousandth of the power, coarse rounding
    strong = np.append(power[np.minimum(last[1:] + brief, fine.size - 1)] > 1e-3 * power.max(), True)
    end = min(int(last[np.argmax((np.diff(last, append=np.inf) > 4 * width) & strong)]) + FINE + 1, fine.size)
    decay = one_mode(fine, quick, peak, end, width) if end + LEAST_DECAY * width > fine.size else None
    grid = np.arange(fine.size)
    slow = _slow_under(fine, quick, (peak, end), width) if decay is None else _slow_without(fine, decay, width)
    # a waveform that ended in a step would put the edge of an impact into the recording
    share = np.clip((grid - peak) / min(width, end - peak), 0.0, 1.0)
    out = np.where((grid >= begin) & (grid < end), fine - share * slow, 0.0)
    late = float(np.sqrt(np.mean(out[3 * out.size // 4 :] ** 2))) / float(np.abs(out).max())
    if decay is None and late > CUT_OFF:  # what follows a cut off end would be found as impacts
        return None
    shown = out[:end]
    if decay is not None:
        lasts = int(decay.fall * np.log(max(np.hypot(*decay.parts) / sigma_v, 1.0)))  # then it is less than the noise
        stop = min(decay.begin + lasts, int(CONTINUED_S * rate_hz * FINE))
        shown = np.append(shown, decay.ringing(np.arange(end, stop)))
    return np.append(shown, np.zeros(max(LENGTH * FINE - shown.size, -shown.size % FINE)))


class Decay(NamedTuple):
    """Ringing of one mode from point ``begin`` of a waveform on.

    The mode falls by ``e`` and turns by ``period`` in as many points; ``parts`` are its cosine and sine.
    """

    begin: int
    fall: float
    period: float
    parts: Floats

    def ringing(self, point: Integers) -> Floats:
        """The mode, (n,)."""
        return np.asarray(_turning(self.fall, self.period, point - self.begin) @ self.parts)


def _turning(fall: float, period: float, point: Integers) -> Floats:
    """A decaying cosine and sine, (n, 2)."""
    angle = 2.0 * np.pi * point / period
    return np.asarray(np.exp(-point / fall)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def one_mode(fine: Floats, quick: Floats, peak: int, end: int, width: int) -> Decay | None:
    """The decay of one mode over slow motion, up to point ``end`` of a waveform; None where it is more than that.

    Modes that decay faster have died away some `SLOW_S` (``width`` points) after the ``peak``. ``quick`` is the
    waveform roughly without its slow motion, which is a polynomial.
    """
    found: list[tuple[float, Decay]] = []
    for begin in (peak + round(later * width) for later in BEGINNINGS):
        if end - begin >= LEAST_DECAY * width:
            bends = max(int((end - begin) / (BEND * width)), 1)
            found += _decays(fine[begin:end], quick[begin:end], begin, bends)
    return min(found, key=itemgetter(0))[1] if found else None


def _decays(seen: Floats, quick: Floats, begin: int, bends: int) -> list[tuple[float, Decay]]:
    """What one mode and a polynomial leave of the end of a waveform, and both; none where they do not fit."""
    # some 400 points tell a decay, and a fit of them is quick
    n, size, point = seen.size, float(np.std(quick)), np.arange(0, seen.size, max(FINE // 2, seen.size // 400))
    early, late = (float(np.std(half)) for half in np.array_split(quick, 2))
    if not early > late > 0.0:
        return []
    tone = int(np.argmax(np.abs(np.fft.rfft(quick * np.hanning(n), 8 * n))))
    start, powers = np.array([0.5 * n / np.log(early / late), 8 * n / max(tone, 1)]), 2.0 * point / n - 1.0
    unit = seen[point] / size

    def columns(p: Floats) -> Floats:
        fall, period = p * start
        return np.column_stack([_turning(fall, period, point), np.vander(powers, bends + 1)])

    def left(p: Floats) -> Floats:
        every = columns(p)
        return np.asarray(every @ lstsq(every, unit)[0] - unit)

    found = least_squares(left, np.ones(2), bounds=([0.2, 0.8], [5.0, 1.25]))
    remains = float(np.std(found.fun))
    if not remains < 0.1:  # of the end's own deviation
        return []
    parts: Floats = np.asarray(size * lstsq(columns(found.x), unit)[0], dtype=np.float64)
    fall, period = (float(x) for x in found.x * start)
    return [(remains, Decay(begin, fall, period, parts[:2]))]


def _slow_under(fine: Floats, quick: Floats, ends: tuple[int, int], width: int) -> Floats:
    """Slow motion under the ringing; before three widths after the peak it is taken as constant.

    Smoothing twice over a whole number of the ringing's periods, ``width`` points or more, removes the ringing. Where a
    waveform is too short for it, the slow motion is a line through what follows the ringing, and constant before. The
    ringing's ``ends`` are its peak and the point after its last.
    """
    peak, end = ends
    late = quick[peak:]
    tone = int(np.argmax(np.abs(np.fft.rfft(late * np.hanning(late.size), 8 * late.size))))
    whole = round(np.ceil(width * tone / (8 * late.size)) * 8 * late.size / max(tone, 1))
    if peak + 5 * whole <= fine.size:
        width = max(whole, width)
    box = np.ones(width) / width
    smooth = np.convolve(np.convolve(fine, box, mode="same"), box, mode="same")
    first, last = peak + 3 * width, fine.size - width
    near = peak + 3 * width // 2
    if last > first and float(np.std(quick[near - width // 2 : near + width // 2])) < abs(smooth[near] - smooth[first]):
        first = near  # nothing rings there any more, and the plate has begun to carry the ball
    if last - first < width:
        after = np.arange(end, fine.size)
        if after.size < width:  # the end as it is, or the edge of what is cut off would be found as an impact
            return np.full(fine.size, float(np.mean(fine[-min(width, fine.size - peak) :])))
        return np.asarray(np.polyval(np.polyfit(after, fine[end:], 1), np.maximum(np.arange(fine.size), end)))
    return np.asarray(smooth[np.clip(np.arange(fine.size), first, last - 1)])


def _slow_without(fine: Floats, decay: Decay, width: int) -> Floats:
    """Slow motion under a ringing of one mode: what is left without the mode, smoothed.

    Until a ``width`` after the mode's begin, where the smoothing is whole, it is a straight line, and before constant.
    """
    rest = fine[decay.begin :] - decay.ringing(np.arange(decay.begin, fine.size))
    box = np.ones(width) / width
    for _ in range(2):
        ends = (width // 2, width - 1 - width // 2)  # a slope goes on there
        rest = np.convolve(np.pad(rest, ends, mode="reflect", reflect_type="odd"), box, mode="valid")
    whole = np.arange(width, min(3 * width, rest.size))
    if whole.size > 1:
        rest[:width] = np.polyval(np.polyfit(whole, rest[whole], 1), np.arange(width))
    return np.append(np.full(decay.begin, rest[0]), rest)


def _from_onset(fine: Floats, sigma_v: float) -> Floats:
    """The waveform shifted so that its rise, extrapolated to zero, begins at ``LEAD * FINE``.

    A converter's linear-phase filter rings before that as well.
    """
    size = np.abs(fine)
    top = float(size.max())
    low, high = (min(max(part * top, ONSET_SIGMAS * sigma_v), 0.7 * top) for part in (0.1, 0.3))
    late = _rise(size, high, 0)
    quiet = np.flatnonzero(size[: int(late) + 1] <= low)  # anything loud long before is another landing's ringing
    early = _rise(size, low, int(quiet[-1]) if quiet.size else 0)
    onset = early - 0.5 * max(late - early, 0.0)
    grid = np.arange(fine.size)
    return np.asarray(np.interp(grid + onset - LEAD * FINE, grid, fine, left=0.0, right=0.0))


def _rise(size: Floats, level: float, first: int) -> float:
    """Interpolated point at which ``size`` first reaches ``level`` from point ``first`` on."""
    k = max(first + int(np.argmax(size[first:] > level)), 1)
    return k - (float(size[k]) - level) / max(float(size[k] - size[k - 1]), 1e-300)


def _ring_s(fine: Floats, size: Floats, noise: NoiseSpectrum) -> float:
    """Length of the mask after a strong impact.

    The residue of the subtraction (`RESIDUAL_PART` of the waveform) adds its time integral to a tone's amplitude,
    `TYPICAL_HZ` times a second. It must stay below the noise of the amplitude in one second.
    """
    after = fine[LEAD * FINE :] * np.quantile(size, 0.9)
    left = np.maximum.accumulate(np.abs(np.cumsum(after[::-1])))[::-1] / FINE / noise.rate_hz  # V s still to come
    allowed = np.sqrt(noise.slow_v2phz) / (2.0 * TYPICAL_HZ * RESIDUAL_PART)
    end = np.flatnonzero(left > allowed)
    last = (end.max() + 1) / FINE / noise.rate_hz if end.size else 0.0
    longest = max(LONGEST_MASK_S, LONGEST_PART * fine.size / FINE / noise.rate_hz)
    return float(np.clip(last, SHORTEST_MASK_S, longest))
