"""Sample-loss detection: number and place of the samples that a device lost, by loop-back and block clocks.

Driver reports are not used. The looped-back drive is compared with the played samples: a jump of its lag is the
number of samples missing there. A jump by a whole number of the drive's periods is invisible, so the clock of the
blocks decides between the candidates.

The work on a block is bounded by the block's own length: the sums of one fit. Only where they do not fit is a lag
searched for (`daq.clocks.loss_search`), in a thread; the blocks wait for the answer, in order.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from daq.clocks.loss_search import (
    CLOCK_SLACK,
    LARGEST,
    LATENCY,
    LIKE_NOISE,
    MISFIT,
    NOTHING,
    SURE_SAMPLES,
    Found,
    LagFit,
    PlayedBuffer,
    Question,
    Searcher,
    WhichLatency,
    WhichLoss,
    lag_at,
)
from daq.files.tables import Block, BlockFlag
from kernels.arrays import Floats

CHUNK = 1024  # frames looked at together, at least
OPENING = 8  # chunks that give the latency, at most
SMALLEST_MISFIT = 1e-4  # of the drive: what the expansion itself leaves over
HELD_S = 2.0  # of frames that wait for an answer; afterwards they are flagged and go on


class BlockClock:
    """Seconds missing according to the clock at each block's end.

    A block may be reported late, never early, so the least delay over a while is the clock's true one; it is learned
    anew while the loop-back agrees that nothing is missing, so that a drift between two clocks is no loss.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._delays: deque[float] = deque(maxlen=64)

    def excess(self, clock_ns: int, counted: int) -> float | None:
        """Seconds by which the clock ran ahead of ``counted`` samples since it last agreed; None without a clock."""
        if clock_ns == 0 or not self._delays:
            return None
        return clock_ns * 1e-9 - counted / self._rate_hz - min(self._delays)

    @property
    def jitter_s(self) -> float:
        """Standard deviation of the delays while nothing was missing; infinite while it is not known."""
        return float(np.std(self._delays)) if len(self._delays) >= 8 else np.inf

    def agree(self, clock_ns: int, counted: int) -> None:
        """Nothing is missing of ``counted`` samples."""
        if clock_ns:
            self._delays.append(clock_ns * 1e-9 - counted / self._rate_hz)


class LossDetector:
    """Follow the looped-back drive block by block and declare what is missing.

    Parameters
    ----------
    rate_hz
        Samples a second.
    chunk
        Frames looked at together; blocks wait until there are so many.
    searcher
        Runs the searches: at once, or in a thread for a device, which does not wait.

    Attributes
    ----------
    heard_samples, lost_samples : int
        Frames that are settled, and samples found lost before them or declared by the device.
    """

    def __init__(self, rate_hz: float, chunk: int = CHUNK, searcher: Searcher | None = None) -> None:
        self._played = PlayedBuffer(LARGEST + 2 * LATENCY + 8 * chunk + round(2.0 * HELD_S * rate_hz))
        self._clock, self._adc = BlockClock(rate_hz), BlockClock(rate_hz)
        self._rate_hz, self._chunk = rate_hz, chunk
        self._searcher = searcher or Searcher()
        self._queue: deque[tuple[Block, Floats]] = deque()  # not looked at yet
        self._queued = self._declared = 0  # its frames and declared losses
        self._waiting: list[tuple[Block, Floats]] = []  # looked at, not settled
        self._n_waiting = self._look_at = 0
        self._question: Question | None = None
        self._asked = self._patient = False
        self._excess_s: tuple[float | None, float | None] = (None, None)
        self._expected: float | None = None
        self._lag: float | None = None
        self._fit: LagFit | None = None
        self._gain = 0.0
        self._rms: deque[float] = deque(maxlen=31)
        self._before = self._opening = np.zeros(0)
        self._drives = False
        self.heard_samples = self.lost_samples = 0

    def expect(self, latency_samples: float) -> None:
        """Set the measured latency of the loop-back, so that it need not be searched for."""
        self._expected = -latency_samples

    def played(self, drive_v: Floats) -> None:
        """Append the samples handed to the device, before the frames that came back."""
        drive_v = np.asarray(drive_v, np.float64)
        self._drives = self._drives or bool(drive_v.any())
        self._played.add(drive_v)

    def piece(self, start: int, stop: int) -> Floats:
        """Played samples ``start .. stop``; zero before the first."""
        return self._played.piece(start, stop)

    def heard(self, block: Block, loopback_v: Floats) -> list[Block]:
        """Take in a block; gives back the blocks whose losses are settled, renumbered, to be recorded.

        Losses that the device declared itself are taken as said; ``loopback_v`` (n,) is the block's looped-back drive.
        """
        self._queue.append((block, np.asarray(loopback_v, np.float64)))
        self._queued += len(block.codes) + block.lost_before
        # more than one block at a time, so that what has waited for an answer is made up for
        return self._advance(3 * max(len(block.codes), 1), wait=False)

    @property
    def next_sample(self) -> int:
        """The device's own index of the next frame: heard, lost, and waiting to be settled."""
        return self.heard_samples + self.lost_samples + self._n_waiting + self._declared + self._queued

    def flush(self) -> list[Block]:
        """Settle the waiting blocks, however short; call it at the end."""
        out = self._advance(self._queued + 1, wait=True)
        while self._waiting:
            out += self._look(patient=False) + self._advance(0, wait=True)
        self._searcher.close()
        return out

    def _advance(self, frames: int, *, wait: bool) -> list[Block]:
        """Look at queued blocks of about so many frames; gives back what is settled."""
        out: list[Block] = []
        while True:
            if self._question is not None:
                found = self._answer(wait=wait)
                if found is None:
                    return out
                out += self._concluded(found)
            elif not self._queue or frames <= 0:
                return out
            elif self._queue[0][0].lost_before and self._waiting:
                out += self._look(patient=False)  # one piece that is looked at has one lag
            else:
                frames -= len(self._queue[0][1])
                out += self._taken_in(*self._queue.popleft())

    def _answer(self, *, wait: bool) -> Found | None:
        """The answer to the question; none after too long a wait, so that nothing piles up."""
        if self._question is not None and not self._asked:
            if wait:
                self._searcher.answer(wait=True)  # an earlier question, whose answer came too late
            self._asked = self._searcher.ask(self._question)
        found = self._searcher.answer(wait=wait) if self._asked else None
        if found is None and self._queued > HELD_S * self._rate_hz:
            self._patient = False
            return NOTHING
        return found

    def _taken_in(self, block: Block, volts: Floats) -> list[Block]:
        """Add a block to those that are looked at together."""
        self._queued -= len(block.codes) + block.lost_before
        self._declared += block.lost_before
        if block.lost_before and self._lag is not None:
            self._lag += block.lost_before
        if not self._waiting:
            guess = self._lag if self._lag is not None else self._expected_lag
            self._fit = LagFit(round(guess)) if guess is not None else None
            self._look_at = self._chunk
        if self._fit is not None:
            self._fit.add(self._played, volts, self.heard_samples + self._n_waiting)
        self._waiting.append((block, volts))
        self._n_waiting += len(volts)
        if self._n_waiting < self._look_at:
            return []
        self._look_at = self._n_waiting + self._chunk // 2
        # chunks that are held back, at most, to settle a loss
        return self._look(patient=self._n_waiting < 3 * self._chunk)

    @property
    def _expected_lag(self) -> float | None:
        """The lag by the measured latency, if any."""
        lost = self.lost_samples + self._declared
        return None if self._expected is None else self._expected + lost

    def _look(self, *, patient: bool) -> list[Block]:
        """Examine the waiting blocks: settle them, wait for more, or ask for a search."""
        ended_ns, began_ns = self._waiting[-1][0].clock_ns, self._waiting[-1][0].adc_ns
        counted, before_last = self._counted()
        adc_s = self._adc.excess(began_ns, before_last)
        # the device's own time is the better clock, where it has one
        excess_s = adc_s if adc_s is not None else self._clock.excess(ended_ns, counted)
        self._patient, self._excess_s = patient, (excess_s, adc_s)
        if self._lag is None:
            return self._begin()
        volts = self._volts()
        usual_v = max(float(np.median(self._rms)), SMALLEST_MISFIT * float(np.std(volts)))
        fit = self._fit
        now = fit.solve() if fit else lag_at(self._played, volts, self.heard_samples, round(self._lag))
        fits = now.rms_v < MISFIT * usual_v
        moves = fit is not None and self._gain * fit.drive_v > MISFIT * usual_v
        if fits and moves and now.gain < 0.5 * self._gain:  # silent: a search would find nothing
            return self._settled(flag=int(BlockFlag.FILLED))
        if now.sigma > SURE_SAMPLES and fits:  # the drive is too quiet to say more
            return self._settled(*self._by_adc())
        if fits and abs(now.samples - self._lag) < 0.5:
            self._rms.append(now.rms_v)
            self._lag += 0.05 * (now.samples - self._lag)  # follows a slow drift between two clocks
            return self._settled()
        if self._goes_on(volts, usual_v):
            return self._settled(flag=int(BlockFlag.FILLED))
        if patient and any(block.flags & BlockFlag.UNDERFLOW for block, _ in self._waiting):
            return []  # the drive ran dry, as is known: wait until it is back
        low = self.heard_samples + round(self._lag) - self._chunk - LARGEST // 8
        high = self.heard_samples + round(self._lag) + LARGEST + len(volts) + self._chunk
        wanted = None if excess_s is None else excess_s * self._rate_hz if excess_s >= CLOCK_SLACK else 0.0
        # a device's own time with less jitter is a count
        counted_by_device = adc_s is not None and self._adc.jitter_s < 1e-3
        return self._ask(WhichLoss(
            self._played.stretch(low, high), volts, self.heard_samples, self._before, self._lag, self._gain, usual_v,
            self._chunk, wanted, counted_by_device,
        ))  # fmt: skip

    def _goes_on(self, volts: Floats, usual_v: float) -> bool:
        """Whether the latest loop-back fits as before and the clock shows no loss: then it was a disturbance."""
        excess_s, lag = self._excess_s[0], self._lag
        if lag is None or (excess_s is not None and excess_s > CLOCK_SLACK):
            return False
        tail = volts[-self._chunk // 2 :]
        start = self.heard_samples + len(volts) - len(tail)
        last = lag_at(self._played, tail, start, round(lag), iterations=1)
        fits = last.rms_v < MISFIT * usual_v and last.sigma < SURE_SAMPLES
        return fits and abs(last.samples - lag) < 0.5 and abs(last.gain / self._gain - 1.0) < 0.1

    def _begin(self) -> list[Block]:
        """The latency, once the drive moves: as expected, or searched for."""
        volts = self._volts()
        joined = self._declared == 0  # a piece with a hole in it has no single latency
        heard = np.concatenate([self._opening, volts])[-OPENING * self._chunk :] if joined else volts
        self._opening = heard
        if not self._drives or heard.min() == heard.max():
            return self._settled(*self._by_adc())
        expected = self._expected_lag
        if self._fit is not None and expected is not None:
            now = self._fit.solve()
            like_noise = now.rms_v < LIKE_NOISE * float(np.std(volts))
            if now.sigma < SURE_SAMPLES and now.gain > 0 and like_noise and abs(now.samples - expected) < 1.5:
                return self._concluded(Found(now.samples, gain=now.gain, rms_v=now.rms_v))
            if now.sigma > SURE_SAMPLES:  # a search would take a cycle less for as good, while the drive grows slowly
                return self._settled(*self._by_adc())
        first = self.heard_samples + len(volts) - len(heard)
        lost = self.lost_samples + self._declared
        last = len(heard) >= OPENING * self._chunk
        stretch = self._played.stretch(first + lost - LATENCY - 2, first + lost + len(heard) + 2)
        return self._ask(WhichLatency(stretch, heard, first, lost, last))

    def _ask(self, question: Question) -> list[Block]:
        """Put a question; the answer is looked for in `_advance`."""
        self._question, self._asked = question, self._searcher.ask(question)
        return []

    def _concluded(self, found: Found) -> list[Block]:
        """Settle the blocks that waited for an answer, by it."""
        self._question = None
        if self._lag is None:
            if found.lag is not None:
                self._lag, self._gain = found.lag, found.gain
                self._rms.append(found.rms_v)
            return self._settled(*self._by_adc())
        if found.lag is None:
            return [] if self._patient else self._settled(flag=int(BlockFlag.FILLED))
        self._lag = found.lag
        return self._settled(found.at, found.lost, found.uncertainty)

    def _by_adc(self) -> tuple[int, int, int]:
        """Loss by the device's own time, to its jitter, where the drive does not determine it; as for `_settled`."""
        adc_s, jitter_s = self._excess_s[1], self._adc.jitter_s
        if adc_s is None or adc_s < max(1.5 / self._rate_hz, 8.0 * jitter_s):
            return -1, 0, 0
        lost = round(adc_s * self._rate_hz)
        if self._lag is not None:
            self._lag += lost
        return 0, lost, int(np.ceil(jitter_s * self._rate_hz))

    def _volts(self) -> Floats:
        """The looped-back drive of the waiting blocks."""
        return np.concatenate([volts for _, volts in self._waiting])

    def _counted(self) -> tuple[int, int]:
        """Samples counted up to the end of the waiting blocks, and up to the last one."""
        counted = self.heard_samples + self.lost_samples + self._n_waiting + self._declared
        return counted, counted - len(self._waiting[-1][1])

    def _settled(self, at: int = -1, lost: int = 0, sigma: int = 0, flag: int = 0) -> list[Block]:
        """The blocks that waited, with ``lost`` (+- ``sigma``) samples missing before frame ``at`` of them."""
        blocks = [block for block, _ in self._waiting]
        self._before = np.concatenate([self._before, self._volts()])[-2 * self._chunk :]
        if lost == 0 and not flag:
            counted, before_last = self._counted()
            self._clock.agree(blocks[-1].clock_ns, counted)
            self._adc.agree(blocks[-1].adc_ns, before_last)
        self._waiting, self._n_waiting, self._declared, self._fit = [], 0, 0, None
        if lost < 0:
            blocks = _without(blocks, at, -lost)
        out: list[Block] = []
        for block in (replace(block, flags=block.flags | flag) for block in blocks):
            n = len(block.codes)
            parts = [block]
            if lost > 0 and 0 < at < n:  # the loss lies inside the block, which is cut in two
                after = replace(block, codes=block.codes[at:], lost_before=lost, lost_uncertainty=sigma)
                parts = [replace(block, codes=block.codes[:at]), after]
            elif lost > 0 and at == 0:
                parts = [replace(block, lost_before=block.lost_before + lost, lost_uncertainty=sigma)]
            for part in parts:
                out.append(replace(part, first_sample=self.heard_samples))
                self.heard_samples += len(part.codes)
                self.lost_samples += part.lost_before
            at -= n
        return out


def _without(blocks: list[Block], at: int, n: int) -> list[Block]:
    """Blocks without ``n`` repeated frames from frame ``at`` on, flagged where frames were taken out."""
    left = []
    for block in blocks:
        codes = np.delete(block.codes, slice(max(at, 0), max(at + n, 0)), axis=0)
        filled = int(BlockFlag.FILLED) if len(codes) < len(block.codes) else 0
        left.append(replace(block, codes=codes, flags=block.flags | filled))
        at -= len(block.codes)
    return [b for b in left if len(b.codes)]
