"""Two rings that a card's callback copies from and to: the drive to be played and the frames recorded.

The drive is played by the card's time, and samples that come after their time are not played. Frames
stay in the order they came, and samples that the driver skipped are declared where they are missing. Decision 38.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import BlockFlag

Samples = NDArray[np.float32]

DECAY_S = 0.005  # length of the decay to zero where the drive came too late


class CardRing:
    """Both directions of one stream.

    ``n_inputs`` channels are recorded: 0 of a card that only plays.

    Attributes
    ----------
    received : int
        Frames that came; only the callback moves it.
    lost : int
        Frames that the driver skipped; only the callback moves it.
    written : int
        The card's frame after the last drive sample handed over; only the writer moves it.
    """

    def __init__(self, rate_hz: float, n_inputs: int) -> None:
        self.n_inputs = n_inputs
        # eight seconds of frames: a caller later than half of it has lost the run
        self.size = 1 << round(8.0 * rate_hz).bit_length()
        self._out: Samples = np.zeros(self.size, np.float32)
        self._in: Samples = np.zeros((self.size, n_inputs), np.float32)
        n = max(1, round(DECAY_S * rate_hz))
        self._decay: Samples = (np.cos(0.5 * np.pi * np.arange(1, n + 1) / n) ** 2).astype(np.float32)
        self.reset()

    def reset(self) -> None:
        """As new."""
        self.received = self.lost = self.written = 0
        self._taken = self._lost_taken = 0
        self._out[:] = 0.0
        self._last = np.float32(0.0)
        self._losses: deque[tuple[int, int, int]] = deque()
        self._unsure_to = 0
        self._suspected: deque[tuple[int, int]] = deque()
        self._origin: int | None = None
        self._late = False

    @property
    def at(self) -> int:
        """The card's next frame: what came and what was skipped."""
        return self.received + self.lost

    @property
    def known(self) -> int:
        """The card's frame up to which it is certain what was skipped."""
        suspected = self._suspected
        return (suspected[0][0] if suspected else self.received) + self.lost

    @property
    def taken(self) -> int:
        """The card's frame after the last one taken."""
        return self._taken + self._lost_taken

    @property
    def counted(self) -> bool:
        """Whether the driver counts its frames."""
        return self._origin is not None

    def exchange(self, recorded: Samples | None, out: Samples, counter: int | None) -> None:
        """The callback's work: play into ``out`` (n,), keep ``recorded`` (n, n_inputs).

        ``counter`` is the driver's own count of frames, where it skips callbacks when it is late; else None.
        """
        n = len(out)
        if counter is not None:
            self._reckon(counter)
        at = self.at
        ready = min(max(self.written - at, 0), n)
        place = at % self.size
        first = min(ready, self.size - place)
        out[:first] = self._out[place : place + first]
        out[first:ready] = self._out[: ready - first]
        if ready:
            self._last = out[ready - 1]
        if ready < n:
            # nothing was handed over for these frames: softly to zero, since a jump would shake the plate
            rest = out[ready:]
            n_decay = min(len(rest), len(self._decay))
            rest[:n_decay] = self._last * self._decay[:n_decay]
            rest[n_decay:] = 0.0
            self._late |= bool(self._last != 0.0)
            self._last = np.float32(0.0)
        if recorded is not None:
            place = self.received % self.size
            first = min(n, self.size - place)
            self._in[place : place + first] = recorded[:first]
            self._in[: n - first] = recorded[first:]
        self.received += n

    def _reckon(self, counter: int) -> None:
        """Compare the driver's count with what came.

        A callback that runs late reads a count that is too high, never one too low: what stays missing for some calls
        on end is missing, and was so since the first of them; that one may itself have been late, and the loss after
        it: its frames are of unsure place.
        """
        if self._origin is None:
            self._origin = counter
        missing = (counter - self._origin - self.received) % 2**32
        if missing >= 2**31:  # the first calls were late themselves
            self._origin += missing - 2**32 - self.lost
            missing = self.lost
        if missing <= self.lost:
            self._suspected.clear()
            return
        self._suspected.append((self.received, missing))
        # what is missing for six callbacks on end is missing: a single late callback reads a count too high
        if len(self._suspected) == 6:
            sure = min(missing for _, missing in self._suspected)
            at, _ = self._suspected.popleft()
            if sure > self.lost:
                self._losses.append((at, sure - self.lost, self._suspected[0][0]))
                self.lost = sure

    def begin(self, ahead: int) -> int:
        """Forget what came so far; the next drive is played ``ahead`` frames from now. Returns the card's frame."""
        self._losses.clear()
        self._taken, self._lost_taken = self.received, self.lost
        self.written = self.at + ahead
        return self.taken

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

    def take(self, until: int) -> tuple[int, Samples, int]:
        """What was skipped before them, the next frames (n, n_inputs), and their `BlockFlag` bits.

        They end at the card's frame ``until``, at a skip, or where the frames of unsure place after one end (those are
        flagged as filled). Drive that came too late since the last call is flagged as well.
        """
        begun = [(at, n, unsure_to) for at, n, unsure_to in tuple(self._losses) if at <= self._taken]
        lost = sum(n for _, n, _ in begun)
        unsure_to = max([self._unsure_to, *(to for _, _, to in begun)])
        ends = [at for at, _, _ in tuple(self._losses) if at > self._taken]
        ends += [unsure_to] if unsure_to > self._taken else []
        stop = min([until - self._lost_taken - lost, self.known - self.lost, *ends])
        if stop <= self._taken:
            return 0, np.zeros((0, self.n_inputs), np.float32), 0
        for _ in begun:
            self._losses.popleft()
        flags = BlockFlag.FILLED if unsure_to > self._taken else BlockFlag(0)
        frames: Samples = self._in[np.arange(self._taken, stop) % self.size]
        self._taken, self._lost_taken, self._unsure_to = stop, self._lost_taken + lost, unsure_to
        late, self._late = self._late, False
        return lost, frames, int(flags | BlockFlag.UNDERFLOW) if late else int(flags)

    def still(self, n: int, moved: float) -> bool:
        """Whether all inputs were one and the same for ``n`` frames while the drive moved by more than ``moved``."""
        if self.received < n:
            return False
        recorded = self._in[np.arange(self.received - n, self.received) % self.size]
        played = self._out[np.arange(self.at - n, self.at) % self.size]
        return bool(np.ptp(played) > moved and not np.ptp(recorded, axis=0).any())

    def fade_out(self, n: int) -> None:
        """Follow what was handed over by its last ``n`` samples backwards, ever smaller."""
        tail = self._out[np.arange(self.written - n, self.written) % self.size][::-1]
        if self.written > self.at and tail.any():
            self.write(tail * (0.5 + 0.5 * np.cos(np.pi * np.arange(1, n + 1) / n)).astype(np.float32))
