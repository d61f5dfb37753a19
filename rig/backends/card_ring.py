"""What a card plays and hears, by the card's own frame: two rings that a callback copies from and to.

The rule kept here: a frame has one place, for ever. A drive sample that comes after its frame is not played; a frame
that the driver skipped is in neither ring, and `CardRing.read` ends before it.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from daq.block import BlockFlag

Samples = NDArray[np.float32]

HELD_S = 8.0  # of frames
DECAY_S = 0.005  # to zero, where the drive came too late


class CardRing:
    """Both directions of one stream.

    Parameters
    ----------
    rate_hz
        Frames a second.
    n_inputs
        Channels that are recorded; 0 for a card that only plays.

    Attributes
    ----------
    at : int
        The card's next frame; only the callback moves it.
    written : int
        The frame after the last drive sample handed over; only the writer moves it.
    """

    def __init__(self, rate_hz: float, n_inputs: int) -> None:
        self.n_inputs = n_inputs
        self.size = 1 << round(HELD_S * rate_hz).bit_length()
        self._out: Samples = np.zeros(self.size, np.float32)
        self._in: Samples = np.zeros((self.size, n_inputs), np.float32)
        n = max(1, round(DECAY_S * rate_hz))
        self._decay: Samples = (np.cos(0.5 * np.pi * np.arange(1, n + 1) / n) ** 2).astype(np.float32)
        self._rate_hz = rate_hz
        self.reset()

    def reset(self) -> None:
        """As new."""
        self.at = self.written = 0
        self._out[:] = 0.0
        self._last = np.float32(0.0)
        self._skips: deque[tuple[int, int]] = deque(maxlen=1024)
        self._origin_s: float | None = None
        self._late = False

    def exchange(self, heard: Samples | None, out: Samples, time_s: float | None) -> None:
        """The callback's work: play the frames from `at` on into ``out`` (n,), keep ``heard`` (n, n_inputs).

        Parameters
        ----------
        time_s
            The driver's clock when the callback was due, where a driver that skips callbacks tells it (see `_skipped`).
        """
        n = len(out)
        at = self.at + (self._skipped(time_s, n) if time_s is not None else 0)
        ready = min(max(self.written - at, 0), n)
        place = at % self.size
        first = min(ready, self.size - place)
        out[:first] = self._out[place : place + first]
        out[first:ready] = self._out[: ready - first]
        if ready:
            self._last = out[ready - 1]
        if ready < n:
            self._run_dry(out[ready:])
        if heard is not None:
            first = min(n, self.size - place)
            self._in[place : place + first] = heard[:first]
            self._in[: n - first] = heard[first:]
        self.at = at + n

    def _run_dry(self, rest: Samples) -> None:
        """Nothing was handed over for these frames: soft to zero."""
        n = min(len(rest), len(self._decay))
        rest[:n] = self._last * self._decay[:n]
        rest[n:] = 0.0
        self._late |= bool(self._last != 0.0)
        self._last = np.float32(0.0)

    def _skipped(self, time_s: float, n: int) -> int:
        """Frames the driver skipped: whole callbacks, by which its clock is ahead of the frames counted.

        A callback may come late, never early, so the least delay so far is where the clock really stands.
        """
        delay_s = time_s - self.at / self._rate_hz
        if self._origin_s is None or delay_s < self._origin_s:
            self._origin_s = delay_s
        skipped = int((delay_s - self._origin_s) * self._rate_hz / n + 0.02) * n
        if skipped:
            self._skips.append((self.at, skipped))
        return skipped

    def write(self, drive: Samples) -> None:
        """Hand over drive samples (n,), to be played from `written` on; those whose frame is over are left out."""
        start = max(self.written, self.at)
        late = min(start - self.written, len(drive))
        self._late |= late > 0 and bool(np.any(drive[:late]))
        rest = drive[late:]
        place = (self.written + late) % self.size
        first = min(len(rest), self.size - place)
        self._out[place : place + first] = rest[:first]
        self._out[: len(rest) - first] = rest[first:]
        self.written += len(drive)

    def read(self, first: int, stop: int) -> tuple[int, Samples]:
        """Frames from ``first`` on to ``stop``, or to where some were skipped: where they begin, and (n, n_inputs)."""
        while self._skips and sum(self._skips[0]) <= first:
            self._skips.popleft()
        for at, n in tuple(self._skips):
            if at <= first:
                first = min(max(first, at + n), stop)
            else:
                stop = min(stop, at)
                break
        return first, self._in[np.arange(first, stop) % self.size]

    def take_flags(self) -> int:
        """`BlockFlag.UNDERFLOW` where drive came too late since the last call."""
        late, self._late = self._late, False
        return int(BlockFlag.UNDERFLOW) if late else 0

    def still(self, n: int, moved: float) -> bool:
        """Whether all inputs were one and the same for ``n`` frames while the drive moved by more than ``moved``."""
        frames = np.arange(self.at - n, self.at)
        if frames[0] < 0:
            return False
        heard, played = self._in[frames % self.size], self._out[frames % self.size]
        return bool(np.ptp(played) > moved and not np.ptp(heard, axis=0).any())

    def fade_out(self, n: int) -> None:
        """Follow what was handed over by its last ``n`` samples backwards, ever smaller."""
        tail = self._out[np.arange(self.written - n, self.written) % self.size][::-1]
        if self.written > self.at and tail.any():
            self.write(tail * (np.cos(0.5 * np.pi * np.arange(1, n + 1) / n) ** 2).astype(np.float32))

