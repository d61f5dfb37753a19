"""From a list of event times to the bounces of one ball: missed and false impacts found and named.

Successive flights of a bouncing ball shrink by a factor that changes slowly, so the chain of events that shrinks most
steadily is the ball. An interval that holds an impact not detected is marked, an event that fits nowhere is listed,
and a bounce that breaks the pattern (an edge, a hand) ends a run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from analysis.drop.times.chain_tests import ends_that_stray, ends_unlike_in_loudness, why_no_drop
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers

LONGEST_FLIGHT_S = 3.0
_RATIOS = np.linspace(0.20, 0.985, 80)
_WIDTHS = 0.04 + 0.06 * (1.0 - _RATIOS)  # of the logarithm of a ratio from bounce to bounce
_KINDS = np.arange(3)[:, None]  # impacts that may be missed in one interval
# Scores are in nats: half of the square of an offset over its width.
_FIT_GAIN = 6.0  # of an impact that fits
_SKIP_COST = 1.5  # of an event of full strength that is left out
_MISSED_COST = 3.5
_BREAK_COST = 3.0
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


def drops_of(events: Onsets | Floats, where: str) -> list[Bounces]:
    """All drops among some events, in order of time: a ball may be dropped several times in one recording.

    Raises `InputError` for fewer than three impacts that follow each other, or a chain that is none of a ball's.

    Bare times, s, are of full strength; ``where`` is the file, for the error text.
    """
    events = events if isinstance(events, Onsets) else unheard(np.asarray(events, dtype=np.float64))
    events = events.part(np.unique(events.times_s, return_index=True)[1])
    times = events.times_s
    found: list[Bounces] = []
    reasons: list[str] = []
    for window in _windows(times):
        _search(events.part(window), found, reasons)
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


def _search(events: Onsets, found: list[Bounces], reasons: list[str]) -> None:
    """Every drop among some events: the best chain, then what lies before and after it."""
    rest = [(events, 2)]  # how often a chain that is none of a ball's may be set aside to look at what is left
    best = 0
    while rest:
        part, tries = rest.pop()
        chain, missed, broken = best_chain(part.times_s, part.strength)
        if all(a or b or cut for a, b, cut in zip(missed, missed[1:], broken[1:], strict=False)):
            continue
        drop = _without_strays(part, chain, missed, broken)
        impacts, n = drop.impacts_s, drop.usable
        if len(impacts) < 3 or not len(n):
            continue
        mine, others = part.loudness[np.isin(part.times_s, impacts)], events.without(impacts)
        flights = drop.intervals_s
        why, by_chance = why_no_drop(flights[n - 1], flights[n], mine, impacts, others.times_s, others.strength)
        if why is not None:
            reasons.append(why)
            if tries and not by_chance:
                # A voice or a rally near a drop: look at what is left without the events at even intervals, or
                # without the whole chain where it has none.
                even = np.abs(np.diff(np.log(flights))) < 0.02  # of the ratio of two intervals of a rhythm
                own = np.zeros(len(impacts), dtype=bool)
                for shift in range(3):  # the three events of two even intervals
                    own[shift : shift + len(even)] |= even
                rest.append((part.without(impacts[own] if own.any() else impacts), tries - 1))
            continue
        best = max(best, len(impacts))
        if len(impacts) == best or len(impacts) >= max(_LEAST_OF_FURTHER, best // 2):
            found.append(drop)
            rest += [(part.part(side), tries) for side in (part.times_s < impacts[0], part.times_s > impacts[-1])]


def _without_strays(heard: Onsets, chain: list[int], missed: list[int], broken: list[bool]) -> Bounces:
    """The chain as bounces, ends that belong to something else given up."""
    events = heard.times_s
    inside = events[(events > events[chain[0]]) & (events < events[chain[-1]])]
    first, last = 0, len(chain)
    while True:
        single = np.array(missed[first : last - 1]) == 0
        own = chain[first:last]
        cut = ends_that_stray(events[own], single)
        if cut[0]:  # an event near it may be the first impact in its place: an impact rings, or clips
            near = np.flatnonzero((np.abs(events - events[own[0]]) < 0.1) & (events < events[own[1]])).tolist()
            others = (k for k in near if k != own[0] and not ends_that_stray(events[[k, *own[1:]]], single)[0])
            if (other := next(others, None)) is not None:
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
    )


def _a_loop(drops: list[Bounces], events: Floats) -> bool:
    """Whether drops are parts of one pattern at even intervals: no two drops of a ball are so alike."""
    impacts = np.concatenate([drop.impacts_s for drop in drops])
    first, length = float(impacts[0]), float(drops[0].impacts_s[-1] - drops[0].impacts_s[0])
    periods = events[(events > first + length) & (events < first + 0.5 * (events[-1] - first) + _SAME_S)] - first
    for period in periods[:200]:  # more are not tried
        ahead = impacts[impacts + period < events[-1] + _SAME_S] + period
        after = np.clip(np.searchsorted(events, ahead), 1, len(events) - 1)
        off = np.minimum(np.abs(events[after] - ahead), np.abs(events[after - 1] - ahead))
        # a loop: ten impacts or more come again, nine in ten of them
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


def best_chain(events: Floats, strength: Floats, may_break: bool = True) -> tuple[list[int], list[int], list[bool]]:
    """The chain of events that shrinks most steadily: a dynamic programme over pairs of events, for all ratios at once.

    Returns indices of its events, impacts missed in each of its intervals, and the impacts where the pattern breaks, as
    irregular bounces ``may_break`` it. ``events`` and ``strength`` (n,) are those of `Onsets`.
    """
    skipped = np.concatenate(([0.0], np.cumsum(_SKIP_COST * strength)))
    # by the pair that ends a chain: (kinds, ratios) of scores, of the link to the pair before, of the last flights
    score: dict[tuple[int, int], Floats] = {}
    back: dict[tuple[int, int], Integers] = {}
    last_flight: dict[tuple[int, int], Floats] = {}
    for j in range(1, len(events)):
        for i in _within_reach(j, skipped):
            interval = events[j] - events[i]
            if not 0.008 <= interval <= LONGEST_FLIGHT_S:
                continue
            # With impacts missing, an interval is a geometric series of flights.
            first = interval * (1.0 - _RATIOS) / (1.0 - _RATIOS ** (_KINDS + 1))
            last_flight[i, j] = first * _RATIOS**_KINDS
            entry = -_MISSED_COST * _KINDS - (skipped[j] - skipped[i + 1])
            best = np.broadcast_to(entry, first.shape).copy()
            link = np.full(first.shape, -1, dtype=np.int64)
            for h in (h for h in _within_reach(i, skipped) if (h, i) in score):
                offset = np.log(first[:, None]) - np.log(_RATIOS * last_flight[h, i][None])
                fits = np.abs(offset) < 3.0 * _WIDTHS
                # after an irregular bounce a flight may give back some of the spin, a tenth at most
                grows = offset - np.log(1.1 / _RATIOS) >= 0.0
                cut_short = np.where(grows | (not may_break), -np.inf, -_BREAK_COST)
                gain = np.where(fits, _FIT_GAIN * strength[j] - 0.5 * (offset / _WIDTHS) ** 2, cut_short)
                total = score[h, i][None] + gain + entry[:, None]
                kind = total.argmax(axis=1)
                top, whole = (np.take_along_axis(x, kind[:, None], axis=1)[:, 0] for x in (total, fits))
                better = top > best
                best = np.where(better, top, best)
                link = np.where(better, (h * len(_KINDS) + kind) * 2 + ~whole, link)
            score[i, j], back[i, j] = best, link
    return _traced(score, back)


def _traced(
    score: dict[tuple[int, int], Floats], back: dict[tuple[int, int], Integers]
) -> tuple[list[int], list[int], list[bool]]:
    """The best chain, from its last pair backward."""
    if not score:
        return [], [], []
    (i, j), table = max(score.items(), key=lambda item: float(item[1].max()))
    kind, ratio = (int(x) for x in np.unravel_index(int(table.argmax()), table.shape))
    chain, missed, broken = [j, i], [kind], [False]
    while (step := int(back[i, j][kind, ratio])) >= 0:
        rest, is_cut = divmod(step, 2)
        i, j = rest // len(_KINDS), i
        kind = rest % len(_KINDS)
        chain.append(i)
        missed.append(kind)
        broken.append(bool(is_cut))
    return chain[::-1], missed[::-1], [*broken, False][::-1]


def _within_reach(j: int, skipped: Floats) -> range:
    """Events before ``j`` that may be its predecessor: 24 at most, and few that sound like impacts between the two."""
    low = j - 1
    while low > 0 and j - low < 24 and skipped[j] - skipped[low] <= _SKIP_COST * 5:
        low -= 1
    return range(j - 1, low - 1, -1)
