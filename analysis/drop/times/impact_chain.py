"""From a list of event times to the bounces of one ball: missed and false impacts found and named.

Successive flights of a bouncing ball shrink by a factor that changes slowly, so the chain of events that shrinks most
steadily is the ball. An interval that holds an impact not detected is marked, an event that fits nowhere is listed,
and a bounce that breaks the pattern (an edge, a hand) ends a run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.times.chain_search import LONGEST_FLIGHT_S, best_chain
from analysis.drop.times.chain_tests import why_no_drop
from analysis.drop.times.end_outliers import ends_that_stray, ends_unlike_in_loudness
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_LEAST_OF_FURTHER = 5  # impacts of a second drop in one recording
_LEAST_OF_LOOP, _SAME_S, _LOOPED, _PERIODS = 2, 1e-3, 0.9, 200
_RING_S = 0.1
_TRIES = 2  # chains that are none of a ball's and are set aside to look at what is left
_EVEN_LOG = 0.02  # of the ratio of two intervals of a rhythm
_STEADY, _SHRINKS, _ECHO_S = 0.01, 0.97, 2e-3  # of two chains side by side: scatter of log ratios, ratio, echo's delay
_WINDOW, _OVERLAP = 400, 150  # events that are searched at once


@dataclass(frozen=True)
class Bounces:
    """The impacts of one drop.

    Attributes
    ----------
    impacts_s : (n,) float64
        Impact times, increasing.
    missed : (n - 1,) int64
        Impacts missing inside each interval (0: the interval is one flight).
    broken : (n,) bool
        The bounce at this impact does not follow the pattern and is not used for a model.
    false_s : (m,) float64
        Events between the impacts that are none.
    uncertainty_s : float
        Standard deviation of an impact time as the detector states it; the fit finds its own.
    """

    impacts_s: Array
    missed: NDArray[np.int64]
    broken: NDArray[np.bool_]
    false_s: Array
    uncertainty_s: float = 0.0

    @property
    def intervals_s(self) -> Array:
        """Times between successive impacts, shape (n - 1,)."""
        return np.diff(self.impacts_s)

    @property
    def gaps_s(self) -> Array:
        """Middle of each interval in which impacts are missing."""
        gaps = np.flatnonzero(self.missed)
        return np.asarray(0.5 * (self.impacts_s[gaps] + self.impacts_s[gaps + 1]))

    @property
    def usable(self) -> NDArray[np.int64]:
        """Indices ``n`` of impacts with a whole flight before and after: rows of the one-bounce-ahead prediction."""
        single = self.missed == 0
        return np.flatnonzero(single[:-1] & single[1:] & ~self.broken[1:-1]) + 1


@dataclass(frozen=True)
class _Events:
    """Event times, increasing, with strength and loudness."""

    times_s: Array
    strength: Array
    loudness: Array

    def part(self, keep: NDArray[np.bool_] | slice) -> _Events:
        return _Events(self.times_s[keep], self.strength[keep], self.loudness[keep])


def bounces_of(
    events_s: Array,
    where: str,
    uncertainty_s: float = 0.0,
    strength: Array | None = None,
    loudness: Array | None = None,
) -> Bounces:
    """Find the ball's impacts among ``events_s``: the drop with the most impacts.

    Parameters
    ----------
    events_s : (n,) float64
        Candidate times, s, any order.
    where : str
        File, for the error text.
    uncertainty_s : float
        Passed on.
    strength : (n,) float64, optional
        How much of an impact each event is, 0 to 1: loudness against its neighbours. All 1 where left out.
    loudness : (n,) float64, optional
        Logarithm of the peak; NaN where not known.

    Raises
    ------
    InputError
        Fewer than three impacts that follow each other, or a chain that is none of a ball's.
    """
    return max(drops_of(events_s, where, uncertainty_s, strength, loudness), key=lambda b: len(b.impacts_s))


def drops_of(
    events_s: Array,
    where: str,
    uncertainty_s: float = 0.0,
    strength: Array | None = None,
    loudness: Array | None = None,
) -> list[Bounces]:
    """All drops among ``events_s``, in order of time: a ball may be dropped several times in one recording.

    Takes what `bounces_of` takes, and raises what it raises where there is not even one.
    """
    times, first = np.unique(np.asarray(events_s, dtype=np.float64), return_index=True)
    weight = np.ones(len(times)) if strength is None else np.asarray(strength, dtype=np.float64)[first]
    loud = np.full(len(times), np.nan) if loudness is None else np.asarray(loudness, dtype=np.float64)[first]
    events = _Events(times, weight, loud)
    found: list[Bounces] = []
    reasons: list[str] = []
    for part in _windows(times):
        _search(events.part(part), uncertainty_s, found, reasons)
    kept = _apart(found)
    if len(kept) > 1 and _a_loop(kept, times):
        raise InputError(
            f"{where}: the same events come again and again, equal to a millisecond and at even intervals: a rhythm, "
            "or one recording played in a loop; give each drop once"
        )
    if kept and _two_side_by_side(kept, events):
        raise InputError(
            f"{where}: two things bounce at the same time: two chains of events shrink steadily side by side; record "
            "one ball at a time, or leave the other out with --from, --until and --ignore"
        )
    if kept:
        return kept
    raise InputError(
        f"{where}: {len(times)} events found, but no three of them follow each other as impacts of one ball do "
        "(each flight shorter than the one before); record the drop from its first impact on, in a quiet room, "
        "and give a table no columns but the impacts'" + (f". The likeliest chain: {reasons[0]}" if reasons else "")
    )


def _windows(times: Array) -> list[slice]:
    """Groups of events that no flight joins, cut into overlapping pieces where they are many."""
    edges = np.flatnonzero(np.diff(times) > 2.0 * LONGEST_FLIGHT_S) + 1
    out = []
    for start, stop in zip(np.append(0, edges), np.append(edges, len(times)), strict=True):
        first = int(start)
        while stop - first > _WINDOW:
            out.append(slice(first, first + _WINDOW))
            first += _WINDOW - _OVERLAP
        out.append(slice(first, int(stop)))
    return out


def _search(events: _Events, uncertainty_s: float, found: list[Bounces], reasons: list[str]) -> None:
    """Every drop among some events: the best chain, then what lies before and after it."""
    rest = [(events, _TRIES)]
    best = 0
    while rest:
        part, tries = rest.pop()
        drop = _one_drop(part, uncertainty_s, events)
        if isinstance(drop, _Refused):
            reasons.append(drop.why)
            if tries and not drop.by_chance:  # a voice or a rally beside a drop: look at what is left without it
                rest.append((part.part(~np.isin(part.times_s, _rhythm(drop.impacts_s))), tries - 1))
        if not isinstance(drop, Bounces):
            continue
        best = max(best, len(drop.impacts_s))
        if len(drop.impacts_s) < best and len(drop.impacts_s) < max(_LEAST_OF_FURTHER, best // 2):
            continue
        found.append(drop)
        parts = (part.part(part.times_s < drop.impacts_s[0]), part.part(part.times_s > drop.impacts_s[-1]))
        rest += [(one, tries) for one in parts]


def _rhythm(chain_s: Array) -> Array:
    """The events of a chain that come at even intervals; all of it, where none do."""
    even = np.abs(np.diff(np.log(np.diff(chain_s)))) < _EVEN_LOG
    own = np.zeros(len(chain_s), dtype=bool)
    for shift in range(3):  # the three events of two even intervals
        own[shift : shift + len(even)] |= even
    return chain_s[own] if own.any() else chain_s


def _apart(found: list[Bounces]) -> list[Bounces]:
    """Drops that do not overlap, those with more impacts first, short ones beside long ones left out; by time."""
    kept: list[Bounces] = []
    for drop in sorted(found, key=lambda b: -len(b.impacts_s)):
        clear = all(drop.impacts_s[-1] < b.impacts_s[0] or drop.impacts_s[0] > b.impacts_s[-1] for b in kept)
        enough = not kept or len(drop.impacts_s) >= max(_LEAST_OF_FURTHER, len(kept[0].impacts_s) // 2)
        if clear and enough:
            kept.append(drop)
    return sorted(kept, key=lambda bounces: float(bounces.impacts_s[0]))


def _a_loop(drops: list[Bounces], events: Array) -> bool:
    """Whether drops are parts of one pattern at even intervals: no two drops of a ball are so alike."""
    impacts = np.concatenate([drop.impacts_s for drop in drops])
    first, length = float(impacts[0]), float(drops[0].impacts_s[-1] - drops[0].impacts_s[0])
    periods = events[(events > first + length) & (events < first + 0.5 * (events[-1] - first) + _SAME_S)] - first
    for period in periods[:_PERIODS]:
        ahead = impacts[impacts + period < events[-1] + _SAME_S] + period
        after = np.clip(np.searchsorted(events, ahead), 1, len(events) - 1)
        off = np.minimum(np.abs(events[after] - ahead), np.abs(events[after - 1] - ahead))
        if len(ahead) >= _LEAST_OF_LOOP * _LEAST_OF_FURTHER and float(np.mean(off < _SAME_S)) > _LOOPED:
            return True
    return False


@dataclass(frozen=True)
class _Refused:
    """A chain that is no drop: why, its events, and whether chance makes as good ones."""

    why: str
    impacts_s: Array
    by_chance: bool


def _one_drop(events: _Events, uncertainty_s: float, everything: _Events) -> Bounces | _Refused | None:
    """The best chain of some events; why it is no drop among everything heard, where it is none."""
    if len(events.times_s) < 3:
        return None
    chain, kinds, broken = best_chain(events.times_s, events.strength)
    if len(chain) < 3 or not _holds_a_bounce(kinds, broken):
        return None
    drop = _without_strays(events, chain, kinds, broken, uncertainty_s)
    if len(drop.impacts_s) < 3 or not len(drop.usable):
        return None
    mine, others = np.isin(events.times_s, drop.impacts_s), ~np.isin(everything.times_s, drop.impacts_s)
    flights, rows = drop.intervals_s, drop.usable
    why, by_chance = why_no_drop(
        flights[rows - 1], flights[rows], events.loudness[mine], drop.impacts_s, everything.times_s[others],
        everything.strength[others],
    )  # fmt: skip
    return drop if why is None else _Refused(why, drop.impacts_s, by_chance)


def _two_side_by_side(drops: list[Bounces], events: _Events) -> bool:
    """Whether two chains shrink steadily at the same time, neither of them the other's echo."""
    left = sum(len(drop.false_s) + int(drop.broken.sum()) for drop in drops)
    if left < _LEAST_OF_FURTHER - 1:
        return False
    inside = (events.times_s >= drops[0].impacts_s[0]) & (events.times_s <= drops[-1].impacts_s[-1])
    rest, chains = events.part(inside), []
    for _ in range(2):
        if len(rest.times_s) > _WINDOW or len(rest.times_s) < _LEAST_OF_FURTHER:
            return False
        chain, kinds, _ = best_chain(rest.times_s, rest.strength, may_break=False)
        times = rest.times_s[chain]
        single = np.array(kinds, dtype=np.int64) == 0
        if len(chain) < _LEAST_OF_FURTHER or not single.all() or not _steady(np.diff(times)):
            return False
        chains.append(times)
        rest = rest.part(~np.isin(rest.times_s, times))
    one, other = chains
    n = min(len(one), len(other))
    shifts = other[:n] - one[np.abs(one[:, None] - other[None, :n]).argmin(axis=0)]
    together = min(one[-1], other[-1]) - max(one[0], other[0])
    echo = float(np.ptp(shifts)) < _ECHO_S
    return bool(together > 0.5 * min(np.ptp(one), np.ptp(other)) and not echo)


def _steady(flights: Array) -> bool:
    """Whether flights shrink by one factor, or one that changes evenly, far more closely than chance makes them."""
    ratio = np.log(flights[1:] / flights[:-1])
    basis = np.vander(flights[:-1], 2) if len(ratio) >= _LEAST_OF_FURTHER else np.ones((len(ratio), 1))
    left = ratio - basis @ np.linalg.lstsq(basis, ratio, rcond=None)[0]
    return bool(float(np.sqrt((left**2).mean())) < _STEADY and float(np.median(ratio)) < np.log(_SHRINKS))


def _without_strays(
    heard: _Events, chain: list[int], kinds: list[int], broken: list[bool], uncertainty_s: float
) -> Bounces:
    """The chain as bounces, ends that belong to something else given up."""
    events = heard.times_s
    inside = events[(events > events[chain[0]]) & (events < events[chain[-1]])]
    first, last = 0, len(chain)
    while True:
        single = np.array(kinds[first : last - 1]) == 0
        own = chain[first:last]
        cut = ends_that_stray(events[own], single)
        if not any(cut):
            cut = ends_unlike_in_loudness(heard.loudness[own], events[own], single)
            if not any(cut):
                break
            first, last = first + cut[0], last - cut[1]
            continue
        if cut[0] and (other := _other_first(events, chain[first:last], single)) is not None:
            chain = [*chain[:first], other, *chain[first + 1 :]]
            continue
        first, last = first + cut[0], last - cut[1]
    kept = events[chain[first:last]]
    return Bounces(
        impacts_s=kept,
        missed=np.array(kinds[first : last - 1], dtype=np.int64),
        broken=np.array([False, *broken[first + 1 : last - 1], False], dtype=np.bool_),
        false_s=np.setdiff1d(np.union1d(inside, events[chain]), kept),
        uncertainty_s=uncertainty_s,
    )


def _other_first(events: Array, chain: list[int], single: NDArray[np.bool_]) -> int | None:
    """An event near a first impact that strays, and in whose place it does not: an impact rings, or clips."""
    near = np.flatnonzero((np.abs(events - events[chain[0]]) < _RING_S) & (events < events[chain[1]]))
    for other in near:
        moved = events[[int(other), *chain[1:]]]
        if int(other) != chain[0] and not ends_that_stray(moved, single)[0]:
            return int(other)
    return None


def _holds_a_bounce(kinds: list[int], broken: list[bool]) -> bool:
    return any(
        not first and not second and not cut for first, second, cut in zip(kinds, kinds[1:], broken[1:], strict=False)
    )
