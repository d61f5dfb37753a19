"""Crossings of the contact voltage through a hysteresis, with the samples around each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.events.levels import Levels
from analysis.signals.search import first_beyond
from kernels import njit
from kernels.arrays import Integers

LEAD, EARLIER, AFTER = 4, 8, 8  # samples stored around a crossing, see `Window`
CLOSED, OPENING, OPEN, DIPPING = range(4)  # states of the scan
CLOSES, OPENS, DIP = -1, 1, 0  # kinds of crossing


@dataclass(frozen=True)
class Window:
    """Samples ``crossing - before ... crossing + after - 1`` around a crossing; more of them where edges are slow."""

    stretch: int = 1  # see `analysis.events.levels.Levels`

    @property
    def lead(self) -> int:
        """Samples before a crossing within which its edge has begun."""
        return LEAD * self.stretch

    @property
    def before(self) -> int:
        """Column of the crossing."""
        return EARLIER + self.lead

    @property
    def after(self) -> int:
        """Samples from the crossing on."""
        return AFTER * self.stretch


@dataclass(frozen=True)
class Crossings:
    """Changes of state of the contact voltage, with the samples around each."""

    sample: Integers  # first sample past the hysteresis threshold (for a dip: its lowest sample), (n,)
    kind: npt.NDArray[np.int8]  # `OPENS`, `CLOSES` or `DIP` (a contact too short to reach the threshold), (n,)
    # fraction of the swing around the crossing: 0 closed, 1 open, (n, around.before + around.after)
    window: npt.NDArray[np.float32]
    around: Window = Window()


class CrossingScan:
    """Hysteresis over successive pieces of the contact voltage, as fractions of the swing."""

    def __init__(self, levels: Levels) -> None:
        self.thresholds, self.around = levels.thresholds(), Window(levels.stretch)
        self.state = np.array([-1, 0], dtype=np.int64)  # state, sample of the lowest value of a dip
        self.lowest = np.array([2.0])
        self.started_open = False
        self._found: list[Crossings] = []

    def add(self, fraction: npt.NDArray[np.float32], first: int, pad: int, count: int) -> Crossings:
        """Scan ``fraction[pad : pad + count]``, sample ``first`` being ``fraction[pad]``; new crossings."""
        if self.state[0] < 0 and count:
            self.started_open = bool(fraction[pad] > 0.5)
        where = np.empty(count, dtype=np.int64)
        kind = np.empty(count, dtype=np.int8)
        slow = self.around.stretch > 1
        n = _scan(fraction[pad : pad + count], self.thresholds, slow, self.state, self.lowest, first, where, kind)
        where, kind = where[:n].copy(), kind[:n].copy()
        around = np.arange(-self.around.before, self.around.after)
        index = (where - first + pad)[:, None] + around
        found = Crossings(where, kind, fraction.take(index, mode="clip"), self.around)
        self._found.append(found)
        return found

    def crossings(self) -> Crossings:
        """All crossings so far, in order."""
        if not self._found:
            nothing = np.zeros((0, self.around.before + self.around.after), np.float32)
            return Crossings(np.zeros(0, np.int64), np.zeros(0, np.int8), nothing, self.around)
        merged = Crossings(
            np.concatenate([c.sample for c in self._found]),
            np.concatenate([c.kind for c in self._found]),
            np.concatenate([c.window for c in self._found]),
            self.around,
        )
        self._found = [merged]
        return merged


@njit(error_model="numpy")
def _scan(x, thresholds, slow, state, lowest, first, where, kind):  # type: ignore[no-untyped-def]
    """Hysteresis over one piece; ``state`` and ``lowest`` persist between pieces."""
    low, high, dip = thresholds
    settled = 0.5 * (1.0 + dip)
    over = settled if slow else dip  # noise takes a slow recovery past the dip's threshold more than once
    s, s_dip = state
    least = lowest[0]
    n, i = 0, -1
    while i + 1 < x.shape[0]:
        i += 1
        if s in (CLOSED, OPEN):  # mostly nothing happens for long
            i = first_beyond(x, i, high if s == CLOSED else dip, s == CLOSED)
            if i == x.shape[0]:
                break
        v = x[i]
        if s == CLOSED:
            if v > high:
                s = OPENING
                where[n], kind[n] = first + i, OPENS
                n += 1
        elif s < 0:
            s = OPENING if v > 0.5 else CLOSED
        elif v < low:
            s = CLOSED
            where[n], kind[n] = first + i, CLOSES
            n += 1
        elif s == OPENING:
            if v > settled:  # a noisy slow edge may pass the dip's threshold more than once
                s = OPEN
        elif s == OPEN:
            if v < dip:
                s, s_dip, least = DIPPING, first + i, v
        elif v < least:
            s_dip, least = first + i, v
        elif v > over:
            s = OPEN
            where[n], kind[n] = s_dip, DIP
            n += 1
    state[0], state[1] = s, s_dip
    lowest[0] = least
    return n
