"""From a list of event times to the bounces of one ball: missed and false impacts found and named.

Successive flights of a bouncing ball shrink by a factor that changes slowly, so the chain of events that shrinks most
steadily is the ball. An interval that holds an impact not detected is marked, an event that fits nowhere is listed,
and a bounce that breaks the pattern (an edge, a hand) ends a run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from analysis.drop.times.chain_search import LONGEST_FLIGHT_S, best_chain
from analysis.drop.times.chain_tests import ends_that_stray, ends_unlike_in_loudness, why_no_drop
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers

_LEAST_OF_FURTHER = 5  # impacts of a second drop in one recording
_WINDOW = 400  # events that are searched at once
_SAME_S = 1e-3  # by which events of a recording played in a loop differ from its period


@dataclass(frozen=True)
class Bounces:
    """The impacts of one drop."""

    impacts_s: Floats  # (n,) impact times, increasing
    missed: Integers  # (n - 1,) impacts missing inside each interval (0: the interval is one flight)
    broken: Bools  # (n,) the bounce at this impact does not follow the pattern and is not used for a model
    false_s: Floats  # (m,) events between the impacts that are none
    uncertainty_s: float = 0.0  # standard deviation of an impact time as the detector states it; the fit finds its own

    @property
    def intervals_s(self) -> Floats:
        """Times between successive impacts, shape (n - 1,)."""
        return np.diff(self.impacts_s)

    @property
    def gaps_s(self) -> Floats:
        """Middle of each interval in which impacts are missing."""
        gaps = np.flatnonzero(self.missed)
        return np.asarray(0.5 * (self.impacts_s[gaps] + self.impacts_s[gaps + 1]))

    @property
    def usable(self) -> Integers:
        """Indices ``n`` of impacts with a whole flight before and after: rows of the one-bounce-ahead prediction."""
        single = self.missed == 0
        return np.flatnonzero(single[:-1] & single[1:] & ~self.broken[1:-1]) + 1


class Onsets(NamedTuple):
    """Events among which a ball's impacts are, in order of time."""

    times_s: Floats  # (n,)
    strength: Floats  # (n,) how much of an impact each is, 0 to 1: its loudness among its neighbours
    loudness: Floats  # (n,) natural logarithm of the peak; NaN where it is clipped or not known

    def part(self, chosen: Bools | slice | Integers) -> Onsets:
        """Only these of the events."""
        return Onsets(*(values[chosen] for values in self))

    def without(self, times_s: Floats) -> Onsets:
        """All but the events at these times."""
        return self.part(~np.isin(self.times_s, times_s))


def unheard(times_s: Floats) -> Onsets:
    """Events of full strength, of whose loudness nothing is known."""
    return Onsets(times_s, np.ones(len(times_s)), np.full(len(times_s), np.nan))


@dataclass(frozen=True)
class _Refused:
    """A chain that is no drop: why, its events, and whether chance makes as good ones."""

    why: str
    impacts_s: Floats
    by_chance: bool


def drops_of(events: Onsets | Floats, where: str, uncertainty_s: float = 0.0) -> list[Bounces]:
    """All drops among some events, in order of time: a ball may be dropped several times in one recording.

    Parameters
    ----------
    events
        Events in any order; bare times, s, are of full strength.
    where
        File, for the error text.
    uncertainty_s
        Passed on.

    Raises
    ------
    InputError
        Fewer than three impacts that follow each other, or a chain that is none of a ball's.
    """
    events = events if isinstance(events, Onsets) else unheard(np.asarray(events, dtype=np.float64))
    events = events.part(np.unique(events.times_s, return_index=True)[1])
    times = events.times_s
    found: list[Bounces] = []
    reasons: list[str] = []
    for window in _windows(times):
        _search(events.part(window), uncertainty_s, found, reasons)
    drops: list[Bounces] = []  # those that do not overlap; the longest first, and short ones near long ones left out
    for drop in sorted(found, key=lambda b: -len(b.impacts_s)):
        clear = all(drop.impacts_s[-1] < b.impacts_s[0] or drop.impacts_s[0] > b.impacts_s[-1] for b in drops)
        if clear and (not drops or len(drop.impacts_s) >= max(_LEAST_OF_FURTHER, len(drops[0].impacts_s) // 2)):
            drops.append(drop)
    drops.sort(key=lambda bounces: float(bounces.impacts_s[0]))
    if len(drops) > 1 and _a_loop(drops, times):
        raise InputError(
            f"{where}: the same events come again and again, equal to a millisecond and at even intervals: a rhythm, "
            "or one recording played in a loop; give each drop once"
        )
    if drops and _two_at_once(drops, events):
        raise InputError(
            f"{where}: two things bounce at the same time: two chains of events shrink steadily side by side; record "
            "one ball at a time, or leave the other out with --from, --until and --ignore"
        )
    if drops:
        return drops
    raise InputError(
        f"{where}: {len(times)} events found, but no three of them follow each other as impacts of one ball do "
        "(each flight shorter than the one before); record the drop from its first impact on, in a quiet room, "
        "and give a table no columns but the impacts'" + (f". The likeliest chain: {reasons[0]}" if reasons else "")
    )


def _windows(times: Floats) -> list[slice]:
    """Groups of events that no flight joins, cut into overlapping pieces where they are many."""
    edges = np.flatnonzero(np.diff(times) > 2.0 * LONGEST_FLIGHT_S) + 1
    out = []
    for start, stop in zip(np.append(0, edges), np.append(edges, len(times)), strict=True):
        first = int(start)
        while stop - first > _WINDOW:
            out.append(slice(first, first + _WINDOW))
            first += _WINDOW - 150  # windows overlap by so many events
        out.append(slice(first, int(stop)))
    return out


def _search(events: Onsets, uncertainty_s: float, found: list[Bounces], reasons: list[str]) -> None:
    """Every drop among some events: the best chain, then what lies before and after it."""
    rest = [(events, 2)]  # chains that are none of a ball's and are set aside to look at what is left
    best = 0
    while rest:
        part, tries = rest.pop()
        drop = _one_drop(part, uncertainty_s, events)
        if isinstance(drop, _Refused):
            reasons.append(drop.why)
            if tries and not drop.by_chance:
                # A voice or a rally near a drop: look at what is left without the events at even intervals, or
                # without the whole chain where it has none.
                chain = drop.impacts_s
                even = np.abs(np.diff(np.log(np.diff(chain)))) < 0.02  # of the ratio of two intervals of a rhythm
                own = np.zeros(len(chain), dtype=bool)
                for shift in range(3):  # the three events of two even intervals
                    own[shift : shift + len(even)] |= even
                rest.append((part.without(chain[own] if own.any() else chain), tries - 1))
        if not isinstance(drop, Bounces):
            continue
        best = max(best, len(drop.impacts_s))
        if len(drop.impacts_s) < best and len(drop.impacts_s) < max(_LEAST_OF_FURTHER, best // 2):
            continue
        found.append(drop)
        rest += [(part.part(part.times_s < drop.impacts_s[0]), tries)]
        rest += [(part.part(part.times_s > drop.impacts_s[-1]), tries)]


def _one_drop(events: Onsets, uncertainty_s: float, everything: Onsets) -> Bounces | _Refused | None:
    """The best chain of some events; why it is no drop among everything heard, where it is none."""
    chain, missed, broken = best_chain(events.times_s, events.strength)
    whole = [not a and not b and not cut for a, b, cut in zip(missed, missed[1:], broken[1:], strict=False)]
    if not any(whole):
        return None
    drop = _without_strays(events, chain, missed, broken, uncertainty_s)
    if len(drop.impacts_s) < 3 or not len(drop.usable):
        return None
    mine, others = np.isin(events.times_s, drop.impacts_s), everything.without(drop.impacts_s)
    before, after = drop.intervals_s[drop.usable - 1], drop.intervals_s[drop.usable]
    why, by_chance = why_no_drop(before, after, events.loudness[mine], drop.impacts_s, others.times_s, others.strength)
    return drop if why is None else _Refused(why, drop.impacts_s, by_chance)


def _without_strays(
    heard: Onsets, chain: list[int], missed: list[int], broken: list[bool], uncertainty_s: float
) -> Bounces:
    """The chain as bounces, ends that belong to something else given up."""
    events = heard.times_s
    inside = events[(events > events[chain[0]]) & (events < events[chain[-1]])]
    first, last = 0, len(chain)
    while True:
        single = np.array(missed[first : last - 1]) == 0
        own = chain[first:last]
        cut = ends_that_stray(events[own], single)
        if cut[0] and (other := _other_first(events, own, single)) is not None:
            chain = [*chain[:first], other, *chain[first + 1 :]]
            continue
        if not any(cut):
            cut = ends_unlike_in_loudness(heard.loudness[own], events[own], single)
        if not any(cut):
            break
        first, last = first + cut[0], last - cut[1]
    used = events[chain[first:last]]
    return Bounces(
        impacts_s=used,
        missed=np.array(missed[first : last - 1], dtype=np.int64),
        broken=np.array([False, *broken[first + 1 : last - 1], False], dtype=np.bool_),
        false_s=np.setdiff1d(np.union1d(inside, events[chain]), used),
        uncertainty_s=uncertainty_s,
    )


def _other_first(events: Floats, chain: list[int], single: Bools) -> int | None:
    """An event near a first impact that strays, and in whose place it does not: an impact rings, or clips."""
    near = np.flatnonzero((np.abs(events - events[chain[0]]) < 0.1) & (events < events[chain[1]]))
    for other in near:
        moved = events[[int(other), *chain[1:]]]
        if int(other) != chain[0] and not ends_that_stray(moved, single)[0]:
            return int(other)
    return None


def _a_loop(drops: list[Bounces], events: Floats) -> bool:
    """Whether drops are parts of one pattern at even intervals: no two drops of a ball are so alike."""
    impacts = np.concatenate([drop.impacts_s for drop in drops])
    first, length = float(impacts[0]), float(drops[0].impacts_s[-1] - drops[0].impacts_s[0])
    periods = events[(events > first + length) & (events < first + 0.5 * (events[-1] - first) + _SAME_S)] - first
    for period in periods[:200]:  # more are not tried
        ahead = impacts[impacts + period < events[-1] + _SAME_S] + period
        after = np.clip(np.searchsorted(events, ahead), 1, len(events) - 1)
        off = np.minimum(np.abs(events[after] - ahead), np.abs(events[after - 1] - ahead))
        # a loop: two drops or more come again, with nine in ten events
        if len(ahead) >= 2 * _LEAST_OF_FURTHER and float(np.mean(off < _SAME_S)) > 0.9:
            return True
    return False


def _two_at_once(drops: list[Bounces], events: Onsets) -> bool:
    """Whether two chains shrink steadily at the same time, neither of them the other's echo."""
    left = sum(len(drop.false_s) + int(drop.broken.sum()) for drop in drops)
    if left < _LEAST_OF_FURTHER - 1:
        return False
    rest = events.part((events.times_s >= drops[0].impacts_s[0]) & (events.times_s <= drops[-1].impacts_s[-1]))
    chains = []
    for _ in range(2):
        if not _LEAST_OF_FURTHER <= len(rest.times_s) <= _WINDOW:
            return False
        chain, missed, _ = best_chain(rest.times_s, rest.strength, may_break=False)
        times = rest.times_s[chain]
        if len(chain) < _LEAST_OF_FURTHER or any(missed):
            return False
        # a ball's flights shrink by one factor, or one that changes evenly, far more closely than chance makes them:
        # scatter of 1 %, 3 % shorter at least
        flights = np.diff(times)
        ratio = np.log(flights[1:] / flights[:-1])
        basis = np.vander(flights[:-1], 2) if len(ratio) >= _LEAST_OF_FURTHER else np.ones((len(ratio), 1))
        scatter = ratio - basis @ np.linalg.lstsq(basis, ratio, rcond=None)[0]
        if not float(np.sqrt((scatter**2).mean())) < 0.01 or not float(np.median(ratio)) < np.log(0.97):
            return False
        chains.append(times)
        rest = rest.without(times)
    one, other = chains
    n = min(len(one), len(other))
    shifts = other[:n] - one[np.abs(one[:, None] - other[None, :n]).argmin(axis=0)]
    together = min(one[-1], other[-1]) - max(one[0], other[0])
    # the delay of an echo varies by less than 2 ms
    return bool(together > 0.5 * min(np.ptp(one), np.ptp(other)) and float(np.ptp(shifts)) >= 2e-3)
