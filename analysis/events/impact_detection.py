"""The second witness: landings seen in the accelerometer, where the contact was too short for the continuity circuit.

The rule kept here: the learnt waveform finds and times the impacts; the offset between the two witnesses is measured
on landings that both saw, and where no landings agree on one, none is claimed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.events.edges import CLOSES, Edges
from analysis.events.impact_template import FINE, LEAD, LENGTH, SHORTEST_MASK_S, Waveform
from kernels import njit

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

TILE = 64  # outputs of the filter computed together
SHIFTS = 2 * FINE  # search range around a candidate, in fine points
SHAPE_ERROR = 0.004  # part of the score by which the learnt shape disturbs the timing
ECHO_ERROR = 0.1  # of it that disturbs the timing of the next
ECHO_MARGIN = 0.2  # part of an earlier impact's ringing that its waveform may get wrong
REACH_S = 1.5e-3  # farthest that an electrical edge may be from its impact
ONSET_S = 2e-6  # how well the onset of the waveform tells the impact, where no edge confirms it
BELIEVED_S = 1e-4  # offset that needs no proof
AGREE_S = 4e-5  # most that landings may differ on the offset
THRESHOLD = 6.0  # standard deviations of the filter's output that make a candidate


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
        points = np.clip(np.arange(LENGTH) * FINE - shifts[:, None], 0, len(waveform.fine) - 1)
        bank = waveform.fine[points] @ waveform.projector
        self._norms = np.maximum(np.linalg.norm(bank, axis=1), 1e-300)
        self._bank = bank / self._norms[:, None]
        slope = np.gradient(self._bank, axis=0) * FINE
        self._steep = np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
        # columns: place (samples), size (units of fine), score and echo (V)
        self._found: list[Floats] = [np.zeros((0, 4))]

    def add(self, volts: npt.NDArray[np.float32], first: int, pad: int, count: int) -> Ints:
        """Scan ``volts[pad : pad + count]``, sample ``first`` of the recording being ``volts[pad]``; samples found."""
        beyond = max(min(LENGTH - LEAD, len(volts) - pad - count - LENGTH), 0)  # what rings before the next piece's own
        heard = np.empty(count + beyond, np.float32)
        found = np.empty(heard.size // 4 + 2, dtype=np.int64)
        limit = THRESHOLD * self.waveform.noise_v
        n = _match(volts, pad, heard.size, self.waveform.taps, np.float32(limit), heard, found)
        own = int(np.searchsorted(found[:n], pad + count))
        out = np.zeros((self.RECENT + own, 4))
        recent = self._found[-1][-self.RECENT :]
        out[: len(recent)] = recent
        total = _time(
            volts,
            first - pad,
            found[:n],
            own,
            self.waveform.fine,
            self._bank,
            self._norms,
            self.waveform.projector,
            limit,
            out,
            len(recent),
        )
        new = out[len(recent) : total].copy()
        self._found[-1] = np.concatenate([self._found[-1], new])
        return np.rint(new[:, 0]).astype(np.int64)

    RECENT = 16  # impacts remembered from before a piece

    def subtract(self, volts: npt.NDArray[np.float32], first: int, pad: int) -> None:
        """Take the waveforms of all impacts found so far out of a piece, in place."""
        start = (first - pad) - len(self.waveform.fine) // FINE
        table = self._found[-1]
        table = table[np.searchsorted(table[:, 0], start) :]
        _subtract(volts, first - pad, table, self.waveform.fine)

    def impacts(self) -> Impacts:
        """Everything found so far."""
        place, _, score, echo = self._found[-1].T
        noise = self.waveform.noise_v
        unsure = np.sqrt(noise**2 + (ECHO_ERROR * echo) ** 2 + (SHAPE_ERROR * score) ** 2)
        sigma = unsure / np.maximum(score, noise) / self._steep[SHIFTS] / self.rate_hz
        return Impacts(place / self.rate_hz, np.minimum(sigma, 1.0 / self.rate_hz), score / noise)


@njit(error_model="numpy", fastmath=True)
def _match(x, pad, count, taps, limit, out, found):  # type: ignore[no-untyped-def]
    """Matched filter over ``x[pad : pad + count]`` and its local maxima above ``limit``; returns how many."""
    length = taps.shape[0]
    for start in range(0, count, TILE):
        stop = min(start + TILE, count)
        total = out[start:stop]
        total[:] = np.float32(0.0)
        for k in range(length):
            tap = taps[k]
            own = x[start + pad - LEAD + k : stop + pad - LEAD + k]
            for i in range(stop - start):
                total[i] += tap * own[i]
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


@njit(error_model="numpy")
def _echo(lag, size, fine, out):  # type: ignore[no-untyped-def]
    """Add the waveform, begun ``lag`` samples before the snippet, to the snippet ``out``."""
    for k in range(out.shape[0]):
        position = (k + lag) * FINE
        j = int(np.floor(position))
        if 0 <= j < fine.shape[0] - 1:
            share = position - j
            out[k] += size * ((1.0 - share) * fine[j] + share * fine[j + 1])


@njit(error_model="numpy")
def _time(x, offset, found, count, fine, bank, norms, projector, limit, out, n):  # type: ignore[no-untyped-def]
    """Time the first ``count`` candidates ``found`` (index into ``x``; ``x[0]`` is sample ``offset``) into ``out[n:]``.

    The candidates after them belong to the next piece, but may be what these are an echo of.
    """
    own, echo, later = np.empty(LENGTH), np.empty(LENGTH), np.empty(LENGTH)
    shifts, longest = bank.shape[0], fine.shape[0] // FINE
    for c in range(count):
        index = found[c]
        echo[:] = 0.0
        for back in range(n - 1, -1, -1):
            lag = index + offset - out[back, 0]
            if lag > longest:
                break
            _echo(lag, out[back, 1], fine, echo)
        rings = n > 0 and index + offset - out[n - 1, 0] <= longest
        loud = np.sqrt(np.sum((projector @ echo) ** 2)) if rings else 0.0
        for k in range(LENGTH):
            own[k] = x[index - LEAD + k] - echo[k]
        score = bank @ own
        best = min(max(int(np.argmax(score)), 1), shifts - 2)
        left, middle, right = score[best - 1], score[best], score[best + 1]
        place = index + offset + (best - SHIFTS) / FINE
        if middle < max(limit, ECHO_MARGIN * loud) or (n > 0 and place - out[n - 1, 0] < 0.5 * LEAD):
            continue
        # a louder impact soon after looks like one before it, too: a period of its ringing earlier
        heard = 0.0
        for ahead in range(c + 1, found.shape[0]):
            lag = found[ahead] - index
            if lag > LENGTH - LEAD:
                break
            for k in range(LENGTH):
                own[k] = x[found[ahead] - LEAD + k]
            top = bank @ own
            far = int(np.argmax(top))
            later[:] = 0.0
            _echo(-lag - (far - SHIFTS) / FINE, top[far] / norms[far], fine, later)
            heard = max(heard, np.dot(bank[best], later))
        if middle - heard < max(limit, ECHO_MARGIN * heard):
            continue
        bend = min(left - 2.0 * middle + right, -1e-300)
        vertex = min(max(0.5 * (left - right) / bend, -1.0), 1.0)
        out[n, 0], out[n, 1] = place + vertex / FINE, middle / norms[best]
        out[n, 2], out[n, 3] = middle, loud
        n += 1
    return n


@njit(error_model="numpy")
def _subtract(x, offset, table, fine):  # type: ignore[no-untyped-def]
    """Take every impact's waveform out of ``x`` (``x[0]`` is sample ``offset``)."""
    for row in range(table.shape[0]):
        begin = int(np.ceil(table[row, 0])) - LEAD
        for sample in range(max(begin, offset), min(begin + fine.shape[0] // FINE, offset + x.shape[0])):
            position = (sample - table[row, 0] + LEAD) * FINE
            j = int(np.floor(position))
            if 0 <= j < fine.shape[0] - 1:
                share = position - j
                x[sample - offset] -= np.float32(table[row, 1] * ((1.0 - share) * fine[j] + share * fine[j + 1]))


@dataclass(frozen=True)
class SensorOffset:
    """How the accelerometer's times compare with the electrical edges on landings that both saw.

    Attributes
    ----------
    offset_s, uncertainty_s : float
        Accelerometer minus electrical edge (a late contact circuit shows here, negative), and its standard error;
        0 and infinity where no landings agree on one (a ball that chatters before the circuit stays closed).
    scatter_s : float
        Scatter beyond the stated uncertainties of both.
    pairs : int
    """

    offset_s: float
    uncertainty_s: float
    scatter_s: float
    pairs: int


def calibrate(
    impacts: Impacts, takeoff_s: Floats, landing_s: Floats, landing_sigma_s: Floats, edge_bias_s: float
) -> tuple[Impacts, SensorOffset]:
    """Put impacts on the axis of the electrical edges.

    Only flights in which the accelerometer saw a single impact, within `REACH_S` of the edge, can tell; and they must
    agree with each other: an offset of the instrument is the same for all. ``edge_bias_s`` is what all edges may share.
    """
    unknown = SensorOffset(0.0, np.inf, 0.0, 0)
    if landing_s.size == 0 or impacts.time_s.size == 0:
        return _with_bias(impacts, 1.0, ONSET_S), unknown
    begin = np.searchsorted(impacts.time_s, takeoff_s - REACH_S + SHORTEST_MASK_S)
    end = np.searchsorted(impacts.time_s, landing_s + REACH_S)
    lone = np.flatnonzero(end - begin == 1)
    partner = begin[lone]
    d = impacts.time_s[partner] - landing_s[lone]
    own = np.hypot(impacts.uncertainty_s[partner], landing_sigma_s[lone])
    near = np.abs(d) < REACH_S
    d, own = d[near], own[near]
    if d.size < 3:
        return _with_bias(impacts, 1.0, ONSET_S), unknown
    ordered = np.sort(d)
    width = ordered[(d.size - 1) // 2 + np.arange(d.size - (d.size - 1) // 2)] - ordered[: d.size - (d.size - 1) // 2]
    k = int(np.argmin(width))
    centre = float(np.median(ordered[k : k + (d.size - 1) // 2 + 1]))
    spread = max(float(width[k]) / 1.35, float(np.median(own)))
    if spread > AGREE_S or _may_be_chatter(centre, spread, impacts.strength[partner][near]):
        return _with_bias(impacts, 1.0, ONSET_S), unknown
    core = np.abs(d - centre) < 5.0 * spread
    weight = 1.0 / (own[core] ** 2 + max(spread**2 - float(np.median(own)) ** 2, 0.0))
    centre = float(np.average(d[core], weights=weight))
    left = (d[core] - centre) / own[core]
    # beyond what both state: a factor where all are understated, found from the middle of the distribution
    factor = max(1.0, 1.4826 * float(np.median(np.abs(left))))
    own_sigma = float(np.hypot(np.sqrt(1.0 / weight.sum()) * factor, edge_bias_s))
    offset = SensorOffset(centre, own_sigma, spread, int(core.sum()))
    moved = Impacts(impacts.time_s - centre, impacts.uncertainty_s, impacts.strength)
    return _with_bias(moved, factor, own_sigma), offset


def _with_bias(impacts: Impacts, factor: float, bias_s: float) -> Impacts:
    """Impacts with their uncertainties multiplied, and what all may share added."""
    return Impacts(impacts.time_s, np.hypot(factor * impacts.uncertainty_s, bias_s), impacts.strength)


def _may_be_chatter(offset_s: float, spread_s: float, strength: Floats) -> bool:
    """Whether a late edge may be the end of a chatter rather than a slow circuit.

    A chatter's length grows with the impact's speed; a circuit's delay does not. Where the impacts are all alike,
    nobody can tell, and a long delay is not believed.
    """
    if abs(offset_s) < BELIEVED_S:
        return False
    low, middle, high = np.quantile(strength, [0.1, 0.5, 0.9])
    variety = (high - low) / middle
    return bool(variety < 0.3 or spread_s / abs(offset_s) > 0.25 * variety)


def combine_with_impacts(edges: Edges, impacts: Impacts, offset: SensorOffset) -> Edges:
    """Closings with the accelerometer's impact averaged in, each by its uncertainty: it may know sharp edges better."""
    closing = np.flatnonzero(edges.kind == CLOSES)
    if not closing.size or not impacts.time_s.size:
        return edges
    time_s, sigma = edges.time_s.copy(), edges.uncertainty_s.copy()
    after = np.minimum(np.searchsorted(impacts.time_s, time_s[closing]), impacts.time_s.size - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(impacts.time_s[before] - time_s[closing]) < np.abs(impacts.time_s[after] - time_s[closing])
    partner = np.where(nearer, before, after)
    own = np.hypot(impacts.uncertainty_s[partner], offset.uncertainty_s)
    difference = impacts.time_s[partner] - time_s[closing]
    alike = np.abs(difference) < 4.0 * np.hypot(own, sigma[closing])
    chosen, own = closing[alike], own[alike]
    share = sigma[chosen] ** 2 / (sigma[chosen] ** 2 + own**2)
    time_s[chosen] += share * difference[alike]
    sigma[chosen] = sigma[chosen] * own / np.hypot(sigma[chosen], own)
    return Edges(time_s, sigma, edges.kind)
