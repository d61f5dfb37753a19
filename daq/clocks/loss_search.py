"""Searches for latency and losses: the lag of the looped-back drive behind the played samples.

The recorded loop-back is ``r[m] = a d(m + s) + b`` with ``d`` the played samples. Its lag ``s`` is minus the latency
plus everything lost so far. Expanding ``d`` about a whole number of samples makes the fit linear in ``a``, ``a ds`` and
``b``; ten sums over the samples are all it needs, so a piece may come block by block, and the lag is known to
thousandths of a sample.

A question holds copies of all it needs, and its answer depends on nothing else: so it does not matter when the answer
comes. With a device the search runs in a thread, with a simulated rig at once.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import dataclass

import numpy as np

from kernels.arrays import Floats

LARGEST = 20_000  # most samples lost at once that are searched for
LATENCY = 20_000  # longest latency of the loop-back, samples
UNSOLVABLE = 1e-12  # part of a column's square sum below which its remainder is rounding


@dataclass(frozen=True)
class Lag:
    """Place of a recorded piece among the played samples."""

    samples: float
    sigma: float  # standard deviation; infinite where the drive does not determine it
    rms_v: float  # root mean square residual of the fit
    gain: float  # recorded volts a played volt


@dataclass(frozen=True)
class Stretch:
    """Played samples ``held`` (n,) from index ``first`` on."""

    first: int
    held: Floats

    @property
    def stop(self) -> int:
        """Index after the last sample."""
        return self.first + len(self.held)

    def piece(self, start: int, stop: int) -> Floats:
        """Samples ``start .. stop``; beyond what is held the nearest is repeated."""
        if self.first <= start and stop <= self.stop:
            return self.held[start - self.first : stop - self.first]
        index = np.clip(np.arange(start - self.first, stop - self.first), 0, len(self.held) - 1)
        return self.held[index]


class PlayedBuffer:
    """The last ``keep`` played samples (`LATENCY` at least), by their index since the start; zero before it."""

    def __init__(self, keep: int) -> None:
        self._ring = np.zeros(max(keep, LATENCY))
        self.stop = 0

    @property
    def first(self) -> int:
        """Index of the first sample that is left."""
        return max(self.stop - len(self._ring), -LATENCY)

    def add(self, drive_v: Floats) -> None:
        """Append samples handed to the device."""
        n = len(self._ring)
        drive_v = drive_v[-n:]
        place = (self.stop + max(len(drive_v) - n, 0)) % n
        ahead = min(len(drive_v), n - place)
        self._ring[place : place + ahead] = drive_v[:ahead]
        self._ring[: len(drive_v) - ahead] = drive_v[ahead:]
        self.stop += len(drive_v)

    def piece(self, start: int, stop: int) -> Floats:
        """Samples ``start .. stop``; beyond what is left the nearest is repeated."""
        low, high = (min(max(k, self.first), self.stop) for k in (start, stop))
        n = len(self._ring)
        place = low % n
        ahead = min(high - low, n - place)
        inside = np.concatenate([self._ring[place : place + ahead], self._ring[: high - low - ahead]])
        if high - low == stop - start:
            return inside
        return Stretch(low, inside if len(inside) else self._ring[[(low - 1) % n]]).piece(start, stop)

    def stretch(self, start: int, stop: int) -> Stretch:
        """A copy of samples ``start .. stop``, as far as they are left."""
        low = min(max(start, self.first), self.stop - 1)
        return Stretch(low, self.piece(low, min(max(stop, low + 1), self.stop)))


class LagFit:
    """The fit of a piece that comes block by block, about one whole lag."""

    def __init__(self, guess: int) -> None:
        self.guess = guess
        self._sums = np.zeros((4, 4))

    def add(self, played: PlayedBuffer | Stretch, heard: Floats, first: int) -> None:
        """Take in ``heard`` (n,), whose first frame is number ``first``."""
        around = played.piece(first + self.guess - 1, first + self.guess + len(heard) + 1)
        rows = np.empty((4, len(heard)))
        rows[0] = around[1:-1]
        np.subtract(around[2:], around[:-2], out=rows[1])
        rows[1] *= 0.5
        rows[2] = 1.0
        rows[3] = heard
        self._sums += rows @ rows.T

    @property
    def drive_v(self) -> float:
        """Standard deviation of the played drive."""
        n = max(float(self._sums[2, 2]), 1.0)
        return float(np.sqrt(max(self._sums[0, 0] / n - (self._sums[0, 2] / n) ** 2, 0.0)))

    def solve(self) -> Lag:
        """The lag by all samples added."""
        sums = self._sums
        n = sums[2, 2]
        means = sums[2] / max(n, 1.0)  # rows are drive, its slope, one, loop-back
        moments = sums - n * np.outer(means, means)
        (dd, ds, _, dh), (_, ss, _, sh) = moments[0], moments[1]
        hh = max(float(moments[3, 3]), 0.0)
        unknown = Lag(float(self.guess), np.inf, float(np.sqrt(hh / max(n, 1.0))), 0.0)
        if n < 4 or dd <= UNSOLVABLE * sums[0, 0]:
            return unknown
        # normal equations of gain and gain * shift, the mean taken out: two unknowns, solved by elimination
        slope = ss - ds * ds / dd  # of which the drive itself is no part
        if slope <= UNSOLVABLE * sums[1, 1]:
            return unknown
        turned = (sh - ds * dh / dd) / slope
        gain = (dh - ds * turned) / dd
        if gain == 0.0:
            return unknown
        rms_v = float(np.sqrt(max(hh - gain * dh - turned * sh, 0.0) / (n - 3)))
        sigma = rms_v / (abs(gain) * float(np.sqrt(slope)))
        return Lag(self.guess + float(turned / gain), sigma, rms_v, float(gain))


def lag_at(played: PlayedBuffer | Stretch, heard: Floats, first: int, guess: int, iterations: int = 4) -> Lag:
    """Lag of ``heard`` (its first frame is number ``first``) near ``guess``."""
    best = Lag(float(guess), np.inf, float(np.std(heard)), 0.0)
    for _ in range(iterations):
        fit = LagFit(guess)
        fit.add(played, heard, first)
        found = fit.solve()
        if not np.isfinite(found.sigma):
            return best
        best = found
        if abs(best.samples - guess) <= 1.0 or abs(best.samples - guess) > LARGEST:
            return best
        guess = round(best.samples)
    return best


def sliding_products(window: Floats, piece: Floats) -> Floats:
    """Products of ``piece`` (n,) with each stretch of ``window`` (m,), shape (m - n + 1,), by Fourier transforms.

    That is `scipy.signal.correlate`, whose package takes seconds to import.
    """
    size = 1 << (len(window) - 1).bit_length()
    spectrum = np.fft.rfft(window, size) * np.conj(np.fft.rfft(piece, size))
    return np.asarray(np.fft.irfft(spectrum, size)[: len(window) - len(piece) + 1])


def candidates(
    played: PlayedBuffer | Stretch, heard: Floats, first: int, low: int, high: int, gain: float
) -> list[Lag]:
    """Lags between ``low`` and ``high`` at which ``heard`` fits about as well as at the best of them.

    ``gain`` is that of the loop-back, where known; 0 lets it be anything positive.
    """
    high = min(high, played.stop - first - len(heard))  # later samples were not played yet
    if high < low:
        return []
    window = played.piece(first + low, first + high + len(heard))
    centred = heard - heard.mean()
    n = len(heard)
    cross = sliding_products(window, centred)
    sums, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (window, window**2))
    # misfit of every whole lag at once: with a known gain, or with the best positive one
    energy = squares[n:] - squares[:-n] - (sums[n:] - sums[:-n]) ** 2 / n
    if gain:
        misfit = centred @ centred - 2.0 * gain * cross + gain**2 * energy
    else:
        misfit = centred @ centred - np.maximum(cross, 0.0) ** 2 / np.maximum(energy, 1e-12 * (energy.max() + 1e-300))
    inner = np.flatnonzero((misfit <= np.roll(misfit, 1)) & (misfit <= np.roll(misfit, -1)))
    order = inner[np.argsort(misfit[inner])][:24]
    fits = [lag_at(played, heard, first, low + int(k)) for k in order]
    fits = [f for f in fits if np.isfinite(f.sigma) and f.gain > 0]
    if not fits:
        return []
    tolerance = 1.5 * min(f.rms_v for f in fits)
    unique: dict[int, Lag] = {}  # several places of little misfit may lead to one lag
    for f in fits:
        if f.rms_v <= tolerance and (not gain or abs(f.gain / gain - 1.0) < 0.1):
            unique.setdefault(round(f.samples), f)
    return list(unique.values())


SURE_SAMPLES = 0.05  # a lag known less well than this decides nothing
CLOCK_SLACK = 0.02  # seconds by which a block's clock may be late without meaning anything
MISFIT = 4.0  # times what a fit usually leaves over: more does not fit
LIKE_NOISE = 0.1  # of the heard drive: what the fit of a latency may leave over


@dataclass(frozen=True)
class Found:
    """An answer: frames before ``at`` fit the lag known before, the rest fits ``lag``."""

    lag: float | None  # the lag from there on; None where no played sample fits
    at: int = -1  # frame of the piece before which samples are missing
    lost: int = 0  # how many
    uncertainty: int = 0  # of that number
    gain: float = 0.0  # heard volts a played volt
    rms_v: float = 0.0  # residual of the fit


NOTHING = Found(None)


@dataclass(frozen=True)
class WhichLatency:
    """Search for the time that the drive takes to come back, once it moves.

    A drive that grows looks like itself a part of a cycle earlier, only smaller: where several latencies fit, a longer
    piece is taken before one is believed.
    """

    played: Stretch
    heard: Floats  # recorded loop-back, (n,)
    first: int  # number of its first frame
    lost: int  # samples lost so far
    last: bool  # whether there will be no longer piece

    def answer(self) -> Found:
        """The one latency that fits, or the least of them at last."""
        found = candidates(self.played, self.heard, self.first, self.lost - LATENCY, self.lost, 0.0)
        limit_v = LIKE_NOISE * float(np.std(self.heard))
        found = [f for f in found if f.sigma < SURE_SAMPLES and f.rms_v < limit_v]
        if not found or (len(found) > 1 and not self.last):
            return NOTHING
        best = max(found, key=lambda f: f.samples)
        return Found(best.samples, gain=best.gain, rms_v=best.rms_v)


@dataclass(frozen=True)
class WhichLoss:
    """Search for the number and place of the samples missing in a piece."""

    played: Stretch
    heard: Floats  # recorded loop-back, (n,)
    first: int  # number of its first frame
    before: Floats  # loop-back before the piece
    lag: float  # before the piece
    gain: float  # of the loop-back
    usual_v: float  # usual residual of a fit
    chunk: int  # frames that are looked at together
    excess_samples: float | None  # samples by which the blocks' clock ran ahead; None without a clock
    # whether that clock is the device's own count: a loss that it contradicts by half a period is none
    counted: bool = False

    def answer(self) -> Found:
        """The loss that fits; of several the one nearest to the clock's."""
        old, start = self.lag, self.first
        low, limit_v = round(old), MISFIT * self.usual_v
        tail = self.heard[-min(self.chunk, len(self.heard)) // 2 :]
        start += len(self.heard) - len(tail)
        found = candidates(self.played, tail, start, low - self.chunk, low + LARGEST, self.gain)
        found = [f for f in found if f.rms_v < limit_v]
        if not found:  # no lag fits the end of the piece: try the whole piece near the old one
            near = lag_at(self.played, self.heard, self.first, low)
            found = [near] if near.rms_v < limit_v else []
        expected = self.excess_samples or 0.0
        whole = []
        for f in found:
            off = f.samples - old
            contradicted = self.counted and abs(off - expected) > self.chunk / 2
            # a lag goes backwards only where frames are there twice
            if not contradicted and abs(off - round(off)) < 0.3 and (off > -0.5 or self._repeats(round(-off))):
                whole.append(f)
        if not whole:
            return NOTHING
        best = min(whole, key=lambda f: abs(f.samples - old - expected))
        lost = round(best.samples - old)
        if lost == 0:
            return NOTHING
        rivals = [abs(f.samples - best.samples) for f in whole if abs(f.samples - best.samples) > 1.0]
        ambiguity_samples = min(rivals) if rivals and self.excess_samples is None else 0.0
        uncertainty = int(np.ceil(max(ambiguity_samples, 3.0 * best.sigma) - 0.5))
        return Found(old + lost, self._where(old + lost), lost, uncertainty)

    def _repeats(self, n: int) -> bool:
        """Whether ``n`` frames are there twice, noise and all; a loss of the rest of a period only looks like it."""
        at = self._where(self.lag - n) + len(self.before)
        known = np.concatenate([self.before, self.heard])
        again, once = known[at : at + n], known[max(at - n, 0) : at]
        # frames that were handed over twice are equal to the last bit, noise and all
        return again.size == once.size == n and float(np.mean(again == once)) > 0.5

    def _where(self, new: float) -> int:
        """Frame at which the old lag stops fitting and the new one starts."""
        misfit = []
        for lag in (self.lag, new):
            start = self.first + round(lag)
            rest = self.heard - self.gain * self.played.piece(start, start + len(self.heard))
            misfit.append((rest - np.median(rest)) ** 2)
        before = np.concatenate([[0.0], np.cumsum(misfit[0])])
        after = np.concatenate([np.cumsum(misfit[1][::-1])[::-1], [0.0]])
        return int(np.argmin(before + after))


Question = WhichLatency | WhichLoss


class Searcher:
    """Search in a thread of ``executor``, else in the caller's own time; one question at a time: nothing piles up."""

    def __init__(self, executor: Executor | None = None) -> None:
        self._executor = executor
        self._future: Future[Found] = Future()
        self._future.set_result(NOTHING)

    def ask(self, question: Question) -> bool:
        """Answer it, or hand it over where the thread is free."""
        if not self._future.done():
            return False
        if self._executor is not None:
            self._future = self._executor.submit(question.answer)
        else:
            self._future = Future()
            self._future.set_result(question.answer())
        return True

    def answer(self, *, wait: bool) -> Found | None:
        """The answer to the last question, once there is one."""
        return self._future.result() if wait or self._future.done() else None

    def close(self) -> None:
        """Let the thread end when its work is done."""
        if self._executor is not None:
            self._executor.shutdown(wait=False)
