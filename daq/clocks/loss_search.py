"""Searches for latency and losses, run at once or in a thread of their own.

A question holds copies of all it needs, and its answer depends on nothing else: so it does not matter when the answer
comes. With a device the search runs in a thread, with a simulated rig at once.
"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from daq.clocks.lag import LARGEST, LATENCY, Stretch, candidates, lag_at
from daq.setup.clock import SYSTEM, Clock
from kernels.arrays import Floats

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


class AtOnce:
    """Search in the caller's own time; one question at a time."""

    def __init__(self) -> None:
        self._future: Future[Found] = Future()
        self._future.set_result(NOTHING)

    def ask(self, question: Question) -> bool:
        """Answer it."""
        self._future = Future()
        self._future.set_result(question.answer())
        return True

    def answer(self, *, wait: bool) -> Found | None:
        """The answer to the last question, once there is one."""
        return self._future.result() if wait or self._future.done() else None

    def close(self) -> None:
        """Do nothing: there is no thread."""


class InThread(AtOnce):
    """Search in a thread; one question at a time, so that nothing piles up."""

    def __init__(self, clock: Clock = SYSTEM) -> None:
        super().__init__()
        self._thread = clock.executor("loss-search")

    def ask(self, question: Question) -> bool:
        """Hand it over, where the thread is free."""
        if not self._future.done():
            return False
        self._future = self._thread.submit(question.answer)
        return True

    def close(self) -> None:
        """Let the thread end when its work is done."""
        self._thread.shutdown(wait=False)
