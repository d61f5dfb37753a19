"""The second witness: landings seen in the accelerometer, where the contact was too short for the continuity circuit.

The rule kept here: nothing is assumed about what an impact looks like. Its waveform is learnt from the landings that
the continuity circuit saw, the filter matched to it finds the others, and the offset between the two witnesses, with
its scatter, is measured on the landings that both saw. Where the accelerometer shows no impacts, there is none.
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
UNLEARNT = 0.1  # part of the waveform that its subtraction may leave
ECHO_MARGIN = 0.2  # part of an earlier impact's ringing that its waveform may get wrong
MIN_LANDINGS = 6  # landings needed to learn a waveform
TYPICAL_HZ = 30.0  # impacts a second, where a mask is chosen
SHORTEST_MASK_S, LONGEST_MASK_S = 1e-3, 8e-3
THRESHOLD = 6.0  # standard deviations of the filter's output that make a candidate


@dataclass(frozen=True)
class Waveform:
    """What an impact looks like in the accelerometer.

    Attributes
    ----------
    fine : array, shape (ECHO * FINE,)
        Mean waveform in volts per unit strength, ``FINE`` points a sample, the landing at point ``LEAD * FINE``.
    taps : float32 array, shape (LENGTH,)
        Matched filter, blind to constants, slopes and curvature (so to the tones), unit response to unit noise.
    projector : array, shape (LENGTH, LENGTH)
        What makes the filter blind: removes the motion's curve from a snippet.
    noise_v : float
        White noise of the accelerometer.
    ring_s : float
        How long after an impact samples are left out of the tone fits.
    """

    fine: Floats
    taps: npt.NDArray[np.float32]
    projector: Floats
    noise_v: float
    ring_s: float


def white_noise(x: Floats) -> float:
    """Standard deviation of the white part, from second differences (tones cancel, spikes are outvoted)."""
    if x.size < 8:
        return 0.0
    second = np.diff(x, 2)
    deviation = np.abs(second - np.median(second))
    return float(np.median(deviation) * 1.4826 / np.sqrt(6.0))


def motion_basis(length: int, powers: int, cycles_per_sample: Floats) -> Floats:
    """Orthonormal functions that hold the plate's motion over a snippet, shape (length, k): powers and tones.

    The powers follow slow tones whatever their frequency; the tones are those too fast for that.
    """
    t = np.arange(length) - 0.5 * (length - 1)
    angle = 2.0 * np.pi * np.outer(cycles_per_sample, t)
    rows = np.vstack([np.vander(2.0 * t / length, powers).T, np.cos(angle), np.sin(angle)])
    u, size, _ = np.linalg.svd((rows / np.linalg.norm(rows, axis=1)[:, None]).T, full_matrices=False)
    return np.asarray(u[:, size > 1e-4 * size[0]])


def learn_waveform(
    snippets: Floats, fractions: Floats, noise_v: float, rate_hz: float, tones_hz: Floats
) -> Waveform | None:
    """Waveform of an impact from snippets around known landings; None where the accelerometer shows nothing.

    Parameters
    ----------
    snippets : array, shape (n, ECHO)
        Accelerometer volts less the plate's motion; column ``LEAD`` is the first sample at or after the landing.
    fractions : array, shape (n,)
        How long before column ``LEAD`` the landing was, in samples, in [0, 1).
    noise_v : float
    rate_hz : float
    tones_hz : array
        Tones of the motion.
    """
    if snippets.shape[0] < MIN_LANDINGS or noise_v <= 0:
        return None
    basis = motion_basis(LENGTH, 4, tones_hz / rate_hz)
    projector = np.eye(LENGTH) - basis @ basis.T
    flat = snippets[:, :LENGTH] @ projector
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
    fine = _oversample(snippets, fractions, size)
    fine[: (LEAD - 1) * FINE] = 0.0  # nothing rings before the impact
    # matched to the whole waveform, but blind to the motion under it
    taps = fine[: LENGTH * FINE : FINE] @ projector
    norm = float(np.linalg.norm(taps))
    return Waveform(fine, (taps / norm).astype(np.float32), projector, noise_v, _ring_s(fine, size, noise_v, rate_hz))


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
    mean, known = top / np.where(known, bottom, 1.0), known[:points]
    return np.asarray(np.interp(grid, grid[known], mean[:points][known]))


def _ring_s(fine: Floats, size: Floats, noise_v: float, rate_hz: float) -> float:
    """How long to leave samples out after a strong impact.

    What the subtraction may leave (`UNLEARNT` of the waveform) adds its time integral to a tone's amplitude,
    `TYPICAL_HZ` times a second; that must stay below the noise of the amplitude in one second.
    """
    after = fine[LEAD * FINE :] * np.quantile(size, 0.9)
    left = np.maximum.accumulate(np.abs(np.cumsum(after[::-1])))[::-1] / FINE / rate_hz  # V s still to come
    allowed = noise_v * np.sqrt(2.0 / rate_hz) / (2.0 * TYPICAL_HZ * UNLEARNT)
    end = np.flatnonzero(left > allowed)
    last = (end.max() + 1) / FINE / rate_hz if end.size else 0.0
    return float(np.clip(last, SHORTEST_MASK_S, LONGEST_MASK_S))


@dataclass(frozen=True)
class Impacts:
    """Landings according to the accelerometer.

    Attributes
    ----------
    time_s, uncertainty_s : float arrays, shape (n,)
        Before `calibrate` on the accelerometer's own axis, after it on that of the electrical edges.
    strength : array, shape (n,)
        Strength in units of the noise after the matched filter: proportional to the impact speed.
    """

    time_s: Floats
    uncertainty_s: Floats
    strength: Floats


NO_IMPACTS = Impacts(np.zeros(0), np.zeros(0), np.zeros(0))


class ImpactScan:
    """Impacts from piece to piece: maxima of the matched filter, each timed by sliding the fine waveform over it.

    In order of time, what earlier impacts still ring is taken off first; a candidate that is no more than such an echo
    is dropped. Uncertainties are those of the fit in white noise; `calibrate` adds what the electrical edges show.
    """

    def __init__(self, waveform: Waveform, rate_hz: float) -> None:
        self.waveform, self.rate_hz = waveform, rate_hz
        shifts = np.arange(-SHIFTS, SHIFTS + 1)
        points = np.clip(np.arange(LENGTH) * FINE - shifts[:, None], 0, ECHO * FINE - 1)
        bank = waveform.fine[points] @ waveform.projector
        self._norms = np.maximum(np.linalg.norm(bank, axis=1), 1e-300)
        self._bank = bank / self._norms[:, None]
        self._steep = np.maximum(np.linalg.norm(np.gradient(self._bank, axis=0), axis=1) * FINE, 1e-9)
        self._found: list[Floats] = [np.zeros((0, 3))]  # columns: place (samples), size (units of fine), score (V)

    def add(self, volts: npt.NDArray[np.float32], first: int, pad: int, count: int) -> Ints:
        """Scan ``volts[pad : pad + count]``, sample ``first`` of the recording being ``volts[pad]``; samples found."""
        found = np.empty(count // 4 + 2, dtype=np.int64)
        limit = THRESHOLD * self.waveform.noise_v
        n = _match(volts, pad, count, self.waveform.taps, np.float32(limit), np.empty(count, np.float32), found)
        out = np.zeros((self.RECENT + n, 3))
        recent = self._found[-1][-self.RECENT :]
        out[: len(recent)] = recent
        total = _time(
            volts, first - pad, found[:n], self.waveform.fine, self._bank, self._norms, self.waveform.projector,
            limit, out, len(recent),
        )
        new = out[len(recent) : total].copy()
        self._found[-1] = np.concatenate([self._found[-1], new])
        return np.rint(new[:, 0]).astype(np.int64)

    RECENT = 16  # impacts remembered from before a piece

    def subtract(self, volts: npt.NDArray[np.float32], first: int, pad: int) -> None:
        """Take the waveforms of all impacts found so far out of a piece, in place."""
        start = (first - pad) - ECHO
        table = self._found[-1]
        table = table[np.searchsorted(table[:, 0], start) :]
        _subtract(volts, first - pad, table, self.waveform.fine)

    def impacts(self) -> Impacts:
        """Everything found so far."""
        place, _, score = self._found[-1].T
        noise = self.waveform.noise_v
        shift = np.full(place.size, SHIFTS)
        sigma = noise / np.maximum(score, noise) / self._steep[shift] / self.rate_hz
        return Impacts(place / self.rate_hz, np.minimum(sigma, 1.0 / self.rate_hz), score / noise)


@njit(cache=True, error_model="numpy", fastmath=True)
def _match(x, pad, count, taps, limit, out, found):  # type: ignore[no-untyped-def]
    """Matched filter over ``x[pad : pad + count]`` and its local maxima above ``limit``; returns how many."""
    length = taps.shape[0]
    for i in range(count):
        out[i] = 0.0
    for k in range(length):
        tap = taps[k]
        shift = pad - LEAD + k
        for i in range(count):
            out[i] += tap * x[i + shift]
    n = 0
    last = -length
    for i in range(count):
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


@njit(cache=True, error_model="numpy")
def _echo(lag, size, fine, out):  # type: ignore[no-untyped-def]
    """Add the waveform, begun ``lag`` samples before the snippet, to the snippet ``out``."""
    for k in range(out.shape[0]):
        position = (k + lag) * FINE
        j = int(np.floor(position))
        if 0 <= j < fine.shape[0] - 1:
            share = position - j
            out[k] += size * ((1.0 - share) * fine[j] + share * fine[j + 1])


@njit(cache=True, error_model="numpy")
def _time(x, offset, found, fine, bank, norms, projector, limit, out, n):  # type: ignore[no-untyped-def]
    """Time each candidate ``found`` (index into ``x``; ``x[0]`` is sample ``offset``); rows go to ``out[n:]``."""
    own, echo = np.empty(LENGTH), np.empty(LENGTH)
    shifts = bank.shape[0]
    for index in found:
        echo[:] = 0.0
        for back in range(n - 1, -1, -1):
            lag = index + offset - out[back, 0]
            if lag > ECHO:
                break
            _echo(lag, out[back, 1], fine, echo)
        loud = np.sqrt(np.sum((projector @ echo) ** 2))
        for k in range(LENGTH):
            own[k] = x[index - LEAD + k] - echo[k]
        score = bank @ own
        best = min(max(int(np.argmax(score)), 1), shifts - 2)
        left, middle, right = score[best - 1], score[best], score[best + 1]
        place = index + offset + (best - SHIFTS) / FINE
        if middle < max(limit, ECHO_MARGIN * loud) or (n > 0 and place - out[n - 1, 0] < 0.5 * LEAD):
            continue
        bend = min(left - 2.0 * middle + right, -1e-300)
        vertex = min(max(0.5 * (left - right) / bend, -1.0), 1.0)
        out[n, 0], out[n, 1], out[n, 2] = place + vertex / FINE, middle / norms[best], middle
        n += 1
    return n


@njit(cache=True, error_model="numpy")
def _subtract(x, offset, table, fine):  # type: ignore[no-untyped-def]
    """Take every impact's waveform out of ``x`` (``x[0]`` is sample ``offset``)."""
    for row in range(table.shape[0]):
        begin = int(np.ceil(table[row, 0])) - LEAD
        for sample in range(max(begin, offset), min(begin + ECHO, offset + x.shape[0])):
            position = (sample - table[row, 0] + LEAD) * FINE
            j = int(np.floor(position))
            if 0 <= j < fine.shape[0] - 1:
                share = position - j
                x[sample - offset] -= np.float32(table[row, 1] * ((1.0 - share) * fine[j] + share * fine[j + 1]))


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


def calibrate(
    impacts: Impacts, landing_s: Floats, landing_sigma_s: Floats, reach_s: float
) -> tuple[Impacts, WitnessOffset]:
    """Put impacts on the axis of the electrical edges; ``reach_s`` is how far apart two of one landing may be."""
    if landing_s.size == 0 or impacts.time_s.size == 0:
        return impacts, WitnessOffset(0.0, np.inf, 0.0, 0)
    after = np.minimum(np.searchsorted(landing_s, impacts.time_s), landing_s.size - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(impacts.time_s - landing_s[before]) <= np.abs(impacts.time_s - landing_s[after])
    partner = np.where(nearer, before, after)
    difference = impacts.time_s - landing_s[partner]
    # an elastic ball closes the circuit only at the end of its rebounds, on impacts too weak to date: strong ones count
    paired = (np.abs(difference) < reach_s) & (impacts.strength >= np.median(impacts.strength))
    if paired.sum() < 5:
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
