"""Levels, noise and rise time of the contact circuit, and the crossings of its voltage between the levels.

What other modules count in samples suits an edge of a few samples; `Levels.stretch` says how many times as long an edge
is, so that a slow edge is read alike at every sampling rate. Crossings go through a hysteresis, and keep the samples
around each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from analysis.signals import first_beyond
from analysis.statistics import core_sigma
from kernels import njit
from kernels.arrays import Floats, Integers

PLATEAU_AFTER = 5  # samples that stay on that side, its own included
MIN_PLATEAU = 50  # samples needed to measure a level
NEAR_LEVEL = 0.1  # fraction of the swing within which samples belong to a level
RISE_PART = 0.1  # of the swing, at either end, that a rise time leaves out
USUAL_RISE_SAMPLES = 5.0  # rise time that counts of samples are made for


@dataclass(frozen=True)
class Levels:
    """Levels of the contact circuit in volts, measured where a plateau exists, declared otherwise.

    ``noise_v`` is the standard deviation on a plateau. Behind a coupling capacitor they are the levels
    restored by `analysis.events.ac_coupling`. ``rise_samples`` is the time that an edge takes from 10 to 90 % of the
    swing, in samples. ``ripple`` is how far the voltage typically swings beyond the open level near an edge, as a
    fraction of the swing: what a linear-phase filter of a converter or of a resampling leaves.
    """

    closed_v: float
    open_v: float
    noise_v: float
    rise_samples: float = 0.0
    ripple: float = 0.0

    @property
    def stretch(self) -> int:
        """Times that an edge is as long as one of `USUAL_RISE_SAMPLES`; at least 1."""
        return min(max(round(self.rise_samples / USUAL_RISE_SAMPLES), 1), 32)

    @property
    def swing_v(self) -> float:
        """Voltage from closed to open."""
        return self.open_v - self.closed_v

    def thresholds(self) -> Floats:
        """``(low, high, dip)`` as fractions of the swing: hysteresis, and the upper bound of a visible dip."""
        noise = self.noise_v / abs(self.swing_v)
        # ten sigma of noise, one and a half ripples and 2 % of the swing: a shallower dip is no contact
        dip = max(10.0 * noise, 1.5 * self.ripple, 0.02)
        # hysteresis at 35 and 65 % of the swing: noise about one threshold makes no second crossing
        return np.array([0.35, 0.65, 1.0 - min(dip, 0.3)])


def measure_levels(read: npt.NDArray[np.floating], declared_closed_v: float, declared_open_v: float) -> Levels:
    """Levels and noise from a sample of continuity volts, ``read`` shape (n,).

    A plateau follows sixteen samples (four, where no plateau is so long) on one side of the declared middle, or more
    where edges are slow. Without a plateau the declared level stands.
    """
    # smallest distance of two values; volts stored as float32 differ by 1e-6 of the largest from rounding
    values = np.unique(read).astype(np.float64)
    steps = np.diff(values)
    steps = steps[steps > 1e-6 * np.abs(values).max(initial=0.0)]
    step_v, volts = float(steps.min()) if steps.size else 0.0, read.astype(np.float64, copy=False)
    found = _on_plateaus(volts, step_v, declared_closed_v, declared_open_v, 1)
    edges = _edge_lengths(volts, found.closed_v, found.swing_v)
    found = replace(found, rise_samples=float(np.median(edges)) if edges.size else 0.0)
    if found.stretch > 1:
        settled = _on_plateaus(volts, step_v, declared_closed_v, declared_open_v, found.stretch)
        found = replace(settled, rise_samples=found.rise_samples)
    return replace(found, ripple=_ripple((volts - found.closed_v) / found.swing_v))


def _ripple(fraction: Floats) -> float:
    """Median height to which the open voltage swings beyond its level, after openings or before closings."""
    is_open = fraction > 0.5
    change = np.flatnonzero(np.diff(is_open)) + 1
    heights = [0.0]
    for own, sign in ((change[is_open[change]], 1), (change[~is_open[change]] - 1, -1)):
        # a linear-phase filter rings for some twenty samples about an edge
        index = own[:, None] + sign * np.arange(20)
        index = index[(index.min(axis=1) >= 0) & (index.max(axis=1) < fraction.size)]
        near = fraction[index][is_open[index].all(axis=1)]
        if len(near) >= 8:
            heights.append(float(np.median(near.max(axis=1))) - 1.0)
    return max(heights)


@njit(error_model="numpy")
def _edge_lengths(volts, closed_v, swing_v):  # type: ignore[no-untyped-def]
    """Samples between one level and the other, of every edge."""
    lengths, found, last, level = np.empty(volts.shape[0], dtype=np.int64), 0, -1, 0
    for i in range(volts.shape[0]):
        fraction = (volts[i] - closed_v) / swing_v
        now = -1 if fraction < RISE_PART else 1 if fraction > 1.0 - RISE_PART else 0
        if now != 0:
            if level != 0 and now != level:
                lengths[found] = i - last - 1
                found += 1
            last, level = i, now
    return lengths[:found].copy()


def _on_plateaus(
    volts: Floats, step_v: float, declared_closed_v: float, declared_open_v: float, stretch: int
) -> Levels:
    """Levels and noise where the voltage has been on one side for 16 samples, else for 4, times ``stretch``."""
    swing = declared_open_v - declared_closed_v
    side = (volts - declared_closed_v) / swing > 0.5
    levels, spreads = [], []
    for wanted, declared in ((False, declared_closed_v), (True, declared_open_v)):
        plateau = volts[:0]
        for before in (stretch * n for n in (16, 4)):
            length = before + PLATEAU_AFTER
            if volts.size < length:
                continue
            if plateau.size < MIN_PLATEAU:
                plateau = _settled(volts, side, wanted, before, length)
        plateau = plateau[:: plateau.size // 16384 + 1]  # so many tell a level as well
        if plateau.size < MIN_PLATEAU:
            levels.append(declared)
            continue
        level = float(np.median(plateau))
        near = plateau[np.abs(plateau - level) < NEAR_LEVEL * abs(swing)]
        level = float(np.median(near)) if 0 < near.size < plateau.size else level
        deviation = np.abs(near - level)
        spreads.append(core_sigma(deviation) if deviation.size else 0.0)
        levels.append(level if near.size > 0.5 * plateau.size else declared)
    noise = max([*spreads, step_v / np.sqrt(12.0), 1e-6 * abs(swing)])
    return Levels(levels[0], levels[1], noise)


@njit()
def _settled(volts, side, wanted, before, length):  # type: ignore[no-untyped-def]
    """Volts that are number ``before`` of ``length`` successive ones on the ``wanted`` side."""
    out, found, run = np.empty(volts.shape[0]), 0, 0
    for i in range(volts.shape[0]):
        run = run + 1 if side[i] == wanted else 0
        if run >= length:
            out[found] = volts[i - length + 1 + before]
            found += 1
    return out[:found].copy()


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
        nothing = np.zeros((0, self.around.before + self.around.after), np.float32)
        self._found = [Crossings(np.zeros(0, np.int64), np.zeros(0, np.int8), nothing, self.around)]

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
        columns = {name: [getattr(c, name) for c in self._found] for name in ("sample", "kind", "window")}
        return Crossings(**{name: np.concatenate(x) for name, x in columns.items()}, around=self.around)


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
