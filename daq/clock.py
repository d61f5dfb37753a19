"""Count the samples that a device lost, and say where: loop-back, block clocks, and the sum of it all.

The rule kept here: drivers are not believed. The looped-back drive is compared with what was played; where it slips,
samples are missing, and by how much it slips says how many. A slip that is a whole number of the drive's periods
looks like none, so the clock that ran beside the blocks decides between the candidates.

What was heard is ``r[m] = a d(m + s) + b`` with ``d`` the played samples and ``s`` the slip (minus the latency, plus
everything lost so far). Expanding ``d`` about a whole number of samples makes the fit linear in ``a``, ``a ds`` and
``b``; the slip comes out to thousandths of a sample.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from daq.block import Block, BlockFlag

Floats = NDArray[np.float64]

CHUNK = 1024  # frames looked at together, at least
LARGEST = 20_000  # samples lost at once that are looked for
LATENCY = 20_000  # samples between playing and hearing, at most
SURE_SAMPLES = 0.05  # a slip known less well than this decides nothing
OPENING = 8  # chunks from which the latency is told, at most
PATIENCE = 3  # chunks held back, at most, to settle a loss
SMALLEST_MISFIT = 1e-4  # of the drive: what the expansion itself leaves over
SAME_PART = 0.5  # of frames that are equal to the last bit in what was handed over twice
CLOCK_SLACK = 0.02  # seconds by which a block's clock may be late without meaning anything


@dataclass(frozen=True)
class Slip:
    """Where in the played samples a piece was heard.

    Attributes
    ----------
    samples, sigma
        Slip and its standard deviation; infinite where the drive says nothing.
    rms_v
        What the fit leaves over.
    gain
        Heard volts a played volt.
    """

    samples: float
    sigma: float
    rms_v: float
    gain: float


class Played:
    """The last played samples, by their index since the start; zero before it."""

    def __init__(self, keep: int) -> None:
        self._keep = keep
        self.first = -LATENCY
        self._held = np.zeros(LATENCY)

    @property
    def stop(self) -> int:
        """Index after the last played sample."""
        return self.first + len(self._held)

    def add(self, drive_v: Floats) -> None:
        """Append what was handed to the device."""
        self._held = np.concatenate([self._held, drive_v])
        if len(self._held) > 2 * self._keep:
            self.first += len(self._held) - self._keep
            self._held = self._held[-self._keep :]

    def piece(self, start: int, stop: int) -> Floats:
        """Samples ``start .. stop``; beyond what is held the nearest is repeated."""
        index = np.clip(np.arange(start - self.first, stop - self.first), 0, len(self._held) - 1)
        return self._held[index]


def slip_at(played: Played, heard: Floats, first: int, guess: int) -> Slip:
    """Slip of ``heard`` (its first frame is number ``first``) near ``guess``."""
    best = Slip(float(guess), np.inf, float(np.std(heard)), 0.0)
    for _ in range(4):
        around = played.piece(first + guess - 1, first + guess + len(heard) + 1)
        design = np.column_stack([around[1:-1], np.gradient(around)[1:-1], np.ones(len(heard))])
        solution, _, rank, _ = np.linalg.lstsq(design, heard, rcond=1e-9)
        if rank < 3 or solution[0] == 0.0:
            return best
        rest = heard - design @ solution
        rms = float(np.sqrt(rest @ rest / max(len(heard) - 3, 1)))
        rest_of_slope = design[:, 1] - design[:, ::2] @ np.linalg.lstsq(design[:, ::2], design[:, 1], rcond=None)[0]
        sigma = rms / (abs(solution[0]) * max(float(np.sqrt(rest_of_slope @ rest_of_slope)), 1e-300))
        slip = guess + float(solution[1] / solution[0])
        best = Slip(slip, sigma, rms, float(solution[0]))
        if abs(slip - guess) <= 1.0 or abs(slip - guess) > LARGEST:
            return best
        guess = round(slip)
    return best


def candidates(played: Played, heard: Floats, first: int, low: int, high: int, gain: float) -> list[Slip]:
    """Slips between ``low`` and ``high`` at which ``heard`` fits about as well as at the best of them.

    Parameters
    ----------
    gain
        Known gain of the loop-back; 0 lets it be anything positive.
    """
    high = min(high, played.stop - first - len(heard))
    if high < low:
        return []
    window = played.piece(first + low, first + high + len(heard))
    centred = heard - heard.mean()
    n = len(heard)
    cross = fftconvolve(window, centred[::-1], mode="valid")
    sums, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (window, window**2))
    energy = squares[n:] - squares[:-n] - (sums[n:] - sums[:-n]) ** 2 / n
    if gain:
        misfit = centred @ centred - 2.0 * gain * cross + gain**2 * energy
    else:
        misfit = centred @ centred - np.maximum(cross, 0.0) ** 2 / np.maximum(energy, 1e-12 * (energy.max() + 1e-300))
    inner = np.flatnonzero((misfit <= np.roll(misfit, 1)) & (misfit <= np.roll(misfit, -1)))
    order = inner[np.argsort(misfit[inner])][:24]
    fits = [slip_at(played, heard, first, low + int(k)) for k in order]
    fits = [f for f in fits if np.isfinite(f.sigma) and f.gain > 0]
    if not fits:
        return []
    tolerance = 1.5 * min(f.rms_v for f in fits)
    unique: dict[int, Slip] = {}
    for f in fits:
        if f.rms_v <= tolerance and (not gain or abs(f.gain / gain - 1.0) < 0.1):
            unique.setdefault(round(f.samples), f)
    return list(unique.values())


class BlockClock:
    """Seconds missing according to the clock at each block's end.

    A block may be reported late, never early, so the least delay over a while is what the clock really says; it is
    learned anew while the loop-back agrees that nothing is missing, so that two clocks that drift apart are no loss.
    """

    def __init__(self, rate_hz: float, keep: int = 64) -> None:
        self._rate_hz = rate_hz
        self._delays: deque[float] = deque(maxlen=keep)

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


class LossFinder:
    """Follow the looped-back drive block by block and declare what is missing.

    Parameters
    ----------
    rate_hz
        Samples a second.
    chunk
        Frames looked at together; blocks wait until there are so many.
    """

    def __init__(self, rate_hz: float, chunk: int = CHUNK) -> None:
        self._played = Played(LARGEST + LATENCY + 8 * chunk)
        self._clock, self._adc = BlockClock(rate_hz), BlockClock(rate_hz)
        self._rate_hz, self._chunk = rate_hz, chunk
        self._waiting: list[tuple[Block, Floats]] = []
        self._slip: float | None = None
        self._gain = 0.0
        self._rms: deque[float] = deque(maxlen=31)
        self._before = self._opening = np.zeros(0)
        self.heard_samples = self.lost_samples = 0

    def played(self, drive_v: Floats) -> None:
        """Say what was handed to the device, before the frames that came back."""
        self._played.add(np.asarray(drive_v, np.float64))

    def piece(self, start: int, stop: int) -> Floats:
        """Played samples ``start .. stop``; zero before the first."""
        return self._played.piece(start, stop)

    def heard(self, block: Block, loopback_v: Floats) -> list[Block]:
        """Take in a block; gives back the blocks whose losses are settled, renumbered, to be recorded.

        Parameters
        ----------
        block
            Frames as the device gave them; losses that it declared itself are taken as said.
        loopback_v
            Its looped-back drive in volts ``(n,)``.
        """
        before: list[Block] = []
        if block.lost_before:
            before = self.flush()  # one piece that is looked at has one slip
            if self._slip is not None:
                self._slip += block.lost_before
        self._waiting.append((block, np.asarray(loopback_v, np.float64)))
        waiting = sum(len(volts) for _, volts in self._waiting)
        return before + ([] if waiting < self._chunk else self._settled(patient=waiting < PATIENCE * self._chunk))

    @property
    def next_sample(self) -> int:
        """The device's own index of the next frame: heard, lost, and waiting to be settled."""
        waiting = sum(len(block.codes) + block.lost_before for block, _ in self._waiting)
        return self.heard_samples + self.lost_samples + waiting

    def flush(self) -> list[Block]:
        """Settle what is waiting, however short; call it at the end."""
        return self._settled(patient=False) if self._waiting else []

    def _settled(self, *, patient: bool) -> list[Block]:
        """What is waiting, its losses declared; nothing where patience may tell more."""
        blocks = [block for block, _ in self._waiting]
        volts = np.concatenate([v for _, v in self._waiting])
        ended_ns, began_ns = blocks[-1].clock_ns, blocks[-1].adc_ns
        counted = self.heard_samples + self.lost_samples + len(volts) + sum(b.lost_before for b in blocks)
        before_last = counted - len(blocks[-1].codes)
        adc_s = self._adc.excess(began_ns, before_last)
        excess_s = adc_s if adc_s is not None else self._clock.excess(ended_ns, counted)
        at, lost, sigma, flag = self._look(volts, self.heard_samples, excess_s, adc_s)
        if lost == 0 and flag and patient:
            return []  # the loss may lie in the part from which it would be measured: look again with more
        self._waiting = []
        self._before = np.concatenate([self._before, volts])[-2 * self._chunk :]
        if lost == 0 and not flag:
            self._clock.agree(ended_ns, counted)
            self._adc.agree(began_ns, before_last)
        if lost < 0:
            blocks = _without(blocks, at, -lost)
        out: list[Block] = []
        for block in blocks:
            out += self._renumbered(block, at, lost, sigma, flag)
            at -= len(block.codes)
        return out

    def _look(
        self, volts: Floats, first: int, excess_s: float | None, adc_s: float | None
    ) -> tuple[int, int, int, int]:
        """``(where in volts, samples lost, uncertainty, flags)`` of one chunk."""
        if self._slip is None:
            self._begin(volts, first)
            return self._by_adc(adc_s)
        usual = max(float(np.median(self._rms)), SMALLEST_MISFIT * float(np.std(volts)))
        now = slip_at(self._played, volts, first, round(self._slip))
        fits = now.rms_v < 4.0 * usual
        if now.sigma > SURE_SAMPLES and fits:
            return self._by_adc(adc_s)
        if fits and abs(now.samples - self._slip) < 0.5:
            self._rms.append(now.rms_v)
            self._slip += 0.05 * (now.samples - self._slip)
            return -1, 0, 0, 0
        return self._settle(volts, first, excess_s, now if fits else None, usual)

    def _by_adc(self, adc_s: float | None) -> tuple[int, int, int, int]:
        """Where the drive says nothing, the device's own time does, to its jitter."""
        jitter_s = self._adc.jitter_s
        if adc_s is None or adc_s < max(1.5 / self._rate_hz, 8.0 * jitter_s):
            return -1, 0, 0, 0
        lost = round(adc_s * self._rate_hz)
        if self._slip is not None:
            self._slip += lost
        return 0, lost, int(np.ceil(jitter_s * self._rate_hz)), 0

    def _begin(self, volts: Floats, first: int) -> None:
        """The latency, once the drive moves.

        A drive that grows looks like itself a part of a cycle earlier, only smaller: where several latencies fit, more
        is listened to before one is believed.
        """
        now_lost = sum(block.lost_before for block, _ in self._waiting)
        heard = volts if now_lost else np.concatenate([self._opening, volts])[-OPENING * self._chunk :]
        self._opening = heard
        if heard.min() == heard.max():
            return
        first += len(volts) - len(heard)
        lost = self.lost_samples + now_lost
        found = candidates(self._played, heard, first, lost - LATENCY, lost, 0.0)
        found = [f for f in found if f.sigma < SURE_SAMPLES and f.rms_v < 0.1 * float(np.std(heard))]
        if len(found) == 1 or (found and len(heard) >= OPENING * self._chunk):
            best = max(found, key=lambda f: f.samples)  # where several fit, the least latency
            self._slip, self._gain = best.samples, best.gain
            self._rms.append(best.rms_v)

    def _settle(
        self, volts: Floats, first: int, excess_s: float | None, near: Slip | None, usual: float
    ) -> tuple[int, int, int, int]:
        """Which loss, and where it is, in a chunk that does not go on as it should."""
        old = self._slip if self._slip is not None else 0.0
        tail = volts[-min(self._chunk, len(volts)) // 2 :]
        start = first + len(volts) - len(tail)
        found = candidates(self._played, tail, start, round(old) - self._chunk, round(old) + LARGEST, self._gain)
        found = [f for f in found if f.rms_v < 4.0 * usual] or ([near] if near is not None else [])
        whole = [f for f in found if abs((f.samples - old) - round(f.samples - old)) < 0.3]
        whole = [f for f in whole if f.samples > old - 0.5 or self._repeats(volts, first, old, round(old - f.samples))]
        if not whole:
            return -1, 0, 0, int(BlockFlag.FILLED)  # nothing that was played sounds like this
        wanted = 0.0 if excess_s is None or excess_s < CLOCK_SLACK else excess_s * self._rate_hz
        best = min(whole, key=lambda f: abs(f.samples - old - wanted))
        lost = round(best.samples - old)
        rivals = [abs(f.samples - best.samples) for f in whole if abs(f.samples - best.samples) > 1.0]
        doubt = min(rivals) if rivals and excess_s is None else 0.0
        if lost == 0:
            return -1, 0, 0, int(BlockFlag.FILLED)
        at = self._where(volts, first, old, old + lost)
        self._slip = old + lost
        return at, lost, int(np.ceil(max(doubt, 3.0 * best.sigma) - 0.5)), 0

    def _repeats(self, volts: Floats, first: int, old: float, n: int) -> bool:
        """Whether ``n`` frames are there twice, noise and all; a loss of the rest of a period only looks like it."""
        at = self._where(volts, first, old, old - n) + len(self._before)
        known = np.concatenate([self._before, volts])
        again, once = known[at : at + n], known[max(at - n, 0) : at]
        return again.size == once.size == n and float(np.mean(again == once)) > SAME_PART

    def _where(self, volts: Floats, first: int, old: float, new: float) -> int:
        """Frame at which the old slip stops fitting and the new one starts."""
        misfit = []
        for slip in (old, new):
            fits = self._gain * self._played.piece(first + round(slip), first + round(slip) + len(volts))
            rest = volts - fits
            misfit.append((rest - np.median(rest)) ** 2)
        before = np.concatenate([[0.0], np.cumsum(misfit[0])])
        after = np.concatenate([np.cumsum(misfit[1][::-1])[::-1], [0.0]])
        return int(np.argmin(before + after))

    def _renumbered(self, block: Block, at: int, lost: int, sigma: int, flag: int) -> list[Block]:
        """The block with its place in the recording, cut in two where the loss lies inside it."""
        n = len(block.codes)
        flags = block.flags | flag
        parts: list[Block]
        if lost > 0 and 0 < at < n:
            parts = [
                replace(block, codes=block.codes[:at], flags=flags),
                replace(block, codes=block.codes[at:], flags=flags, lost_before=lost, lost_uncertainty=sigma),
            ]
        elif lost > 0 and at == 0:
            total = block.lost_before + lost
            parts = [replace(block, flags=flags, lost_before=total, lost_uncertainty=sigma)]
        else:
            parts = [replace(block, flags=flags)]
        placed = []
        for part in parts:
            placed.append(replace(part, first_sample=self.heard_samples))
            self.heard_samples += len(part.codes)
            self.lost_samples += part.lost_before
        return placed


def _without(blocks: list[Block], at: int, n: int) -> list[Block]:
    """Blocks without ``n`` repeated frames from frame ``at`` on, flagged where frames were taken out."""
    kept = []
    for block in blocks:
        mask = np.ones(len(block.codes), np.bool_)
        mask[max(at, 0) : max(at + n, 0)] = False
        changed = not mask.all()
        flags = block.flags | (int(BlockFlag.FILLED) if changed else 0)
        kept.append(replace(block, codes=block.codes[mask], flags=flags))
        at -= len(block.codes)
    return [b for b in kept if len(b.codes)]
