"""The second witness: landings seen in the accelerometer, where the contact was too short for the continuity circuit.

The rule kept here: nothing is assumed about what an impact looks like. Its waveform is learnt from the landings that
the continuity circuit saw, the filter matched to it finds the others, and the offset between the two witnesses, with
its scatter, is measured on the landings that both saw. A rig whose accelerometer shows no impacts has no second witness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

LEAD, TAIL = 12, 36  # samples of the accelerometer kept before and after an impact's first sample
LENGTH = LEAD + TAIL
ECHO = 128  # samples of the waveform learnt: an impact's ringing must not be taken for the next impact
FINE = 8  # template points per sample
SHIFTS = 2 * FINE  # search range around a candidate, in fine points
ECHO_MARGIN = 0.2  # part of an earlier impact's ringing that its waveform may get wrong
MIN_LANDINGS = 6  # landings needed to learn a waveform
SHORTEST_MASK_S, LONGEST_MASK_S = 1e-3, 10e-3
THRESHOLD = 6.0  # standard deviations of the filter's output that make a candidate


@dataclass(frozen=True)
class Waveform:
    """What an impact looks like in the accelerometer.

    Attributes
    ----------
    fine : array, shape (ECHO * FINE,)
        Mean waveform in volts per unit strength, ``FINE`` points a sample, the electrical edge at point ``LEAD * FINE``.
    taps : float32 array, shape (LENGTH,)
        Matched filter, blind to constants, slopes and curvature (so to the tones), unit response to unit noise.
    noise_v : float
        White noise of the accelerometer.
    ring_s : float
        How long after an impact the waveform stands out of the noise.
    """

    fine: Floats
    taps: npt.NDArray[np.float32]
    noise_v: float
    ring_s: float


def white_noise(x: Floats) -> float:
    """Standard deviation of the white part, from second differences (tones cancel, spikes are outvoted)."""
    if x.size < 8:
        return 0.0
    second = np.diff(x, 2)
    deviation = np.abs(second - np.median(second))
    return float(np.median(deviation)) * 1.4826 / np.sqrt(6.0)


def _projector(length: int, unknowns: int) -> Floats:
    """Projection that removes polynomials (the plate's slow motion) over a snippet, shape (length, length)."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), unknowns))
    return np.eye(length) - basis @ basis.T


PROJECTOR = _projector(LENGTH, 4)
LONG_PROJECTOR = _projector(ECHO, 6)


def learn_waveform(snippets: Floats, fractions: Floats, noise_v: float, rate_hz: float) -> Waveform | None:
    """Waveform of an impact from snippets around known landings; None where the accelerometer shows nothing.

    Parameters
    ----------
    snippets : array, shape (n, ECHO)
        Accelerometer volts; column ``LEAD`` is the first sample at or after the landing.
    fractions : array, shape (n,)
        How long before column ``LEAD`` the landing was, in samples, in [0, 1).
    noise_v : float
    rate_hz : float
    """
    if snippets.shape[0] < MIN_LANDINGS or noise_v <= 0:
        return None
    flat = snippets[:, :LENGTH] @ PROJECTOR
    mean = np.median(flat, axis=0)
    strength = np.linalg.norm(mean)
    scatter = 1.2533 * noise_v * np.sqrt(LENGTH / snippets.shape[0])
    # half of the landings against the other half: a waveform repeats, a leftover of the motion or of noise does not
    halves = [np.median(flat[i::2], axis=0) for i in (0, 1)]
    agreement = float(halves[0] @ halves[1]) / max(float(np.linalg.norm(halves[0]) * np.linalg.norm(halves[1])), 1e-300)
    if strength < 3.0 * scatter or strength < 4.0 * noise_v or agreement < 0.7:
        return None
    direction = mean / strength
    size = flat @ direction
    fine = _oversample(snippets @ LONG_PROJECTOR, fractions, size)
    taps = (direction / np.linalg.norm(direction)).astype(np.float32)
    return Waveform(fine, taps, noise_v, _ring_s(fine, size, noise_v, rate_hz))


def _oversample(flat: Floats, fractions: Floats, size: Floats) -> Floats:
    """Mean waveform on ``FINE`` points a sample: hat functions at their sub-sample place, weighted by strength."""
    position = (np.arange(ECHO)[None, :] + fractions[:, None]) * FINE
    weight = np.maximum(size, 0.0)[:, None] * np.ones(ECHO)
    points = ECHO * FINE
    low = np.floor(position).astype(np.int64)
    share = position - low
    top, bottom = np.zeros(points + 2), np.zeros(points + 2)
    for index, part in ((low, 1.0 - share), (low + 1, share)):
        inside = np.minimum(index, points + 1)
        np.add.at(top, inside, part * weight * flat)
        np.add.at(bottom, inside, part * weight**2)
    known = bottom > 1e-9 * bottom.max()
    grid = np.arange(points)
    return np.asarray(np.interp(grid, grid[known[:points]], (top[:points] / np.where(known, bottom, 1.0)[:points])[known[:points]]))


def _ring_s(fine: Floats, size: Floats, noise_v: float, rate_hz: float) -> float:
    """Time after the landing until a strong impact's ringing, decaying as it starts, sinks to a tenth of the noise."""
    parts = (fine[LEAD * FINE : LENGTH * FINE] * np.quantile(size, 0.9)).reshape(6, -1)
    level = np.sqrt(np.mean(parts**2, axis=1))
    time_s = (np.arange(6) + 0.5) * parts.shape[1] / FINE / rate_hz
    loud = level > 0.3 * noise_v
    if loud.sum() < 2:
        return SHORTEST_MASK_S
    slope, start = np.polyfit(time_s[loud], np.log(level[loud] / noise_v), 1, w=level[loud] ** 0.5)
    end = (np.log(10.0) + start) / -slope if slope < 0 else LONGEST_MASK_S
    return float(np.clip(end, SHORTEST_MASK_S, LONGEST_MASK_S))


class ImpactScan:
    """Candidate impacts from piece to piece: local maxima of the matched filter above `THRESHOLD`."""

    def __init__(self, waveform: Waveform) -> None:
        self.waveform = waveform
        self._samples: list[Ints] = []
        self._snippets: list[npt.NDArray[np.float32]] = []

    def add(self, volts: npt.NDArray[np.float32], first: int, pad: int, count: int) -> Ints:
        """Scan ``volts[pad : pad + count]``, sample ``first`` of the recording being ``volts[pad]``; samples found."""
        found = np.empty(count // 4 + 2, dtype=np.int64)
        limit = np.float32(THRESHOLD * self.waveform.noise_v)
        n = _match(volts, pad, count, self.waveform.taps, limit, np.empty(count, np.float32), found)
        index = found[:n]
        keep = index + TAIL + 2 <= volts.size
        index = index[keep]
        self._samples.append(index - pad + first)
        self._snippets.append(volts[index[:, None] + np.arange(-LEAD, TAIL)])
        return self._samples[-1]

    def candidates(self) -> tuple[Ints, npt.NDArray[np.float32]]:
        """Samples (n,) and snippets (n, LENGTH) of all candidates so far."""
        if not self._samples:
            return np.zeros(0, np.int64), np.zeros((0, LENGTH), np.float32)
        self._samples, self._snippets = [np.concatenate(self._samples)], [np.concatenate(self._snippets)]
        return self._samples[0], self._snippets[0]


@njit(cache=True, error_model="numpy", fastmath=True)
def _match(x, pad, count, taps, limit, out, found):  # type: ignore[no-untyped-def]
    """Matched filter over ``x[pad : pad + count]`` and its local maxima above ``limit``; returns how many."""
    length = taps.shape[0]
    stop = min(count, x.shape[0] - pad - length)
    for i in range(stop):
        out[i] = 0.0
    for k in range(length):
        tap = taps[k]
        shift = pad - LEAD + k
        for i in range(stop):
            out[i] += tap * x[i + shift]
    n = 0
    last = -length
    for i in range(stop):
        v = out[i]
        if v > limit:
            if i - last >= LEAD:
                found[n] = pad + i
                n += 1
                last = i
            elif v > out[found[n - 1] - pad]:
                found[n - 1] = pad + i
                last = i
    return n


@dataclass(frozen=True)
class Impacts:
    """Landings according to the accelerometer.

    Attributes
    ----------
    time_s, uncertainty_s : float arrays, shape (n,)
        On the axis of the electrical edges (the offset between the witnesses taken out).
    strength : array, shape (n,)
        Strength in units of the noise after the matched filter.
    """

    time_s: Floats
    uncertainty_s: Floats
    strength: Floats


def time_impacts(samples: Ints, snippets: npt.NDArray[np.float32], waveform: Waveform, rate_hz: float) -> Impacts:
    """Sub-sample times of impacts among the candidates, by sliding the fine waveform over each snippet.

    In order of time, what earlier impacts still ring is taken off first; a candidate that is no more than such an echo
    is dropped. The uncertainty is that of the fit in white noise; `calibrate` adds what the electrical edges show beyond.
    """
    bank, norms = _bank(waveform)
    steep = np.linalg.norm(np.gradient(bank / norms[:, None], axis=0), axis=1) * FINE * rate_hz
    kept: list[tuple[float, float, float]] = []  # place (samples), size (volts of fine), score
    sigmas = []
    for sample, snippet in zip(samples, snippets, strict=True):
        own, echo = snippet.astype(np.float64), np.zeros(LENGTH)
        for place, size, _ in reversed(kept):
            lag = (sample - place) * FINE
            if lag > ECHO * FINE:
                break
            points = np.arange(LENGTH) * FINE + lag
            echo += size * np.interp(points, np.arange(ECHO * FINE), waveform.fine, right=0.0)
        score = bank @ (own - echo) / norms
        best = int(np.clip(np.argmax(score), 1, score.size - 2))
        left, middle, right = score[best - 1 : best + 2]
        limit = max(THRESHOLD * waveform.noise_v, ECHO_MARGIN * float(np.linalg.norm(PROJECTOR @ echo)))
        if middle < limit:
            continue
        vertex = float(np.clip(0.5 * (left - right) / min(left - 2.0 * middle + right, -1e-300), -1.0, 1.0))
        kept.append((float(sample + (best - SHIFTS + vertex) / FINE), float(middle / norms[best]), float(middle)))
        sigmas.append(waveform.noise_v / middle / max(float(steep[best]), 1e-9))
    if not kept:
        return Impacts(np.zeros(0), np.zeros(0), np.zeros(0))
    place, _, score = np.array(kept).T
    return Impacts(place / rate_hz, np.minimum(np.array(sigmas), 1.0 / rate_hz), score / waveform.noise_v)


def _bank(waveform: Waveform) -> tuple[Floats, Floats]:
    """The waveform at every shift of two samples either way, flattened as snippets are, and the norms of the rows."""
    shifts = np.arange(-SHIFTS, SHIFTS + 1)
    points = np.clip(np.arange(LENGTH) * FINE - shifts[:, None], 0, ECHO * FINE - 1)
    bank = waveform.fine[points] @ PROJECTOR
    return bank, np.maximum(np.linalg.norm(bank, axis=1), 1e-300)


@dataclass(frozen=True)
class WitnessOffset:
    """How the accelerometer's times compare with the electrical edges on landings that both saw.

    Attributes
    ----------
    offset_s, uncertainty_s : float
        Accelerometer minus electrical edge (a late contact circuit shows here), and its standard error.
    scatter_s : float
        Scatter beyond the stated uncertainties of both.
    pairs : int
    """

    offset_s: float
    uncertainty_s: float
    scatter_s: float
    pairs: int


def calibrate(impacts: Impacts, landing_s: Floats, landing_sigma_s: Floats, reach_s: float) -> tuple[Impacts, WitnessOffset]:
    """Put impacts on the axis of the electrical edges; ``reach_s`` is how far apart two of one landing may be."""
    if landing_s.size == 0 or impacts.time_s.size == 0:
        return impacts, WitnessOffset(0.0, np.inf, 0.0, 0)
    nearest = np.clip(np.searchsorted(landing_s, impacts.time_s), 1, max(landing_s.size - 1, 1))
    lower, upper = landing_s[nearest - 1], landing_s[np.minimum(nearest, landing_s.size - 1)]
    partner = np.where(np.abs(impacts.time_s - lower) <= np.abs(impacts.time_s - upper), nearest - 1, np.minimum(nearest, landing_s.size - 1))
    difference = impacts.time_s - landing_s[partner]
    paired = np.abs(difference) < reach_s
    if paired.sum() < 3:
        return impacts, WitnessOffset(0.0, np.inf, 0.0, int(paired.sum()))
    d = difference[paired]
    own = np.hypot(impacts.uncertainty_s, landing_sigma_s[partner])[paired]
    centre = float(np.median(d))
    robust = max(1.4826 * float(np.median(np.abs(d - centre))), 1e-9)
    core = np.abs(d - centre) < 4.0 * robust
    centre = float(np.mean(d[core]))
    excess = float(np.sqrt(max(np.var(d[core]) - np.mean(own[core] ** 2), 0.0)))
    sigma = np.hypot(impacts.uncertainty_s, excess)
    moved = Impacts(impacts.time_s - centre, sigma, impacts.strength)
    return moved, WitnessOffset(centre, float(np.std(d[core])) / np.sqrt(core.sum()), excess, int(core.sum()))
