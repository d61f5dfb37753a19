"""From a list of event times to the bounces of one ball: missed and false impacts found and named.

The rule kept here: nothing is invented. Successive flights of a bouncing ball shrink by a factor that changes slowly,
so the chain of events that shrinks most steadily is the ball; an interval that holds an impact nobody heard is marked,
an event that fits nowhere is dropped and listed, and a bounce that breaks the pattern (an edge, a hand) ends a run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.strays import ends_that_stray
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_RATIOS = np.linspace(0.20, 0.985, 80)
_LOOK_AHEAD = 6  # events that may be false between two impacts, plus one
_MOST_MISSED = 2  # impacts that may be missed in one interval
_GAIN, _MISS_COST, _SKIP_COST, _BREAK_COST = 6.0, 3.5, 1.5, 3.0
_CHANCE = 1.5  # steady bounces wanted for every time that the events outnumber the chain twofold
_LEAST_OF_FURTHER = 5  # impacts of a second drop in one recording
_LARGEST_GROWTH = 1.1  # of a flight after an irregular bounce: no bounce adds energy, some of the spin may come back
_LONGEST_FLIGHT_S = 3.0
_SHORTEST_FLIGHT_S = 0.008
_LARGEST_LOG_SCATTER = 3.0  # in widths


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
    def usable(self) -> NDArray[np.int64]:
        """Indices ``n`` of impacts with a whole flight before and after: rows of the one-bounce-ahead prediction."""
        single = self.missed == 0
        return np.flatnonzero(single[:-1] & single[1:] & ~self.broken[1:-1]) + 1


def bounces_of(events_s: Array, where: str, uncertainty_s: float = 0.0, strength: Array | None = None) -> Bounces:
    """Find the ball's impacts among ``events_s``.

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

    Raises
    ------
    InputError
        Fewer than three impacts that follow each other.
    """
    events, first = np.unique(np.asarray(events_s, dtype=np.float64), return_index=True)
    weight = np.ones(len(events)) if strength is None else np.asarray(strength, dtype=np.float64)[first]
    found = _one_drop(events, weight, uncertainty_s)
    if found is not None:
        return found
    raise InputError(
        f"{where}: {len(events)} events found, but no three of them follow each other as impacts of one ball do "
        "(each flight shorter than the one before); record the drop from its first impact on, in a quiet room, "
        "and give a table no columns but the impacts'"
    )


def drops_of(events_s: Array, where: str, uncertainty_s: float = 0.0, strength: Array | None = None) -> list[Bounces]:
    """All drops among ``events_s``, in order of time: a ball may be dropped several times in one recording.

    Takes what `bounces_of` takes, and raises what it raises where there is not even one.
    """
    best = bounces_of(events_s, where, uncertainty_s, strength)
    events, first = np.unique(np.asarray(events_s, dtype=np.float64), return_index=True)
    weight = np.ones(len(events)) if strength is None else np.asarray(strength, dtype=np.float64)[first]
    least = max(_LEAST_OF_FURTHER, len(best.impacts_s) // 2)
    found, rest = [best], [events < best.impacts_s[0], events > best.impacts_s[-1]]
    while rest:
        part = rest.pop()
        further = _one_drop(events[part], weight[part], uncertainty_s)
        if further is not None and len(further.impacts_s) >= least:
            found.append(further)
            rest += [part & (events < further.impacts_s[0]), part & (events > further.impacts_s[-1])]
    return sorted(found, key=lambda bounces: float(bounces.impacts_s[0]))


def _one_drop(events: Array, strength: Array, uncertainty_s: float) -> Bounces | None:
    if len(events) < 3:
        return None
    chain, kinds, broken = _best_chain(events, strength)
    if len(chain) < 3 or not _holds_a_bounce(kinds, broken):
        return None
    steady = len(chain) - 2 - sum(kinds) - 2 * sum(broken)
    if steady < _CHANCE * np.log2(strength.sum() / strength[chain].sum()):
        return None  # among many events some shrink steadily by chance: the longer the list, the longer the chain
    return _without_strays(events, chain, kinds, broken, uncertainty_s)


def _without_strays(
    events: Array, chain: list[int], kinds: list[int], broken: list[bool], uncertainty_s: float
) -> Bounces:
    """The chain as bounces, ends that belong to something else given up."""
    inside = events[(events > events[chain[0]]) & (events < events[chain[-1]])]
    first, last = 0, len(chain)
    while True:
        cut = ends_that_stray(events[chain[first:last]], np.array(kinds[first : last - 1]) == 0)
        if not any(cut):
            break
        first, last = first + cut[0], last - cut[1]
    kept = events[chain[first:last]]
    return Bounces(
        impacts_s=kept,
        missed=np.array(kinds[first : last - 1], dtype=np.int64),
        broken=np.array([False, *broken[first + 1 : last - 1], False], dtype=np.bool_),
        false_s=np.setdiff1d(np.union1d(inside, events[chain]), kept),
        uncertainty_s=uncertainty_s,
    )


def _holds_a_bounce(kinds: list[int], broken: list[bool]) -> bool:
    return any(
        not first and not second and not cut for first, second, cut in zip(kinds, kinds[1:], broken[1:], strict=False)
    )


def _ends(interval: float) -> tuple[Array, Array]:
    """First and last flight (kinds, ratios) of an interval that holds 0, 1, 2 missed impacts."""
    powers = np.arange(_MOST_MISSED + 1)[:, None]
    first = interval * (1.0 - _RATIOS) / (1.0 - _RATIOS ** (powers + 1))
    return first, first * _RATIOS**powers


def _best_chain(events: Array, strength: Array) -> tuple[list[int], list[int], list[bool]]:
    """Dynamic programme over pairs of events and kinds of interval, for all ratios at once."""
    n = len(events)
    skipped = np.concatenate(([0.0], np.cumsum(_SKIP_COST * strength)))
    width = 0.04 + 0.06 * (1.0 - _RATIOS)
    kinds = _MOST_MISSED + 1
    score: dict[tuple[int, int], Array] = {}
    back: dict[tuple[int, int], NDArray[np.int64]] = {}
    ends: dict[tuple[int, int], tuple[Array, Array]] = {}
    for j in range(1, n):
        for i in range(j - 1, max(-1, j - 1 - _LOOK_AHEAD), -1):
            if not _SHORTEST_FLIGHT_S <= events[j] - events[i] <= _LONGEST_FLIGHT_S:
                continue
            ends[i, j] = _ends(events[j] - events[i])
            first = ends[i, j][0]
            entry = -_MISS_COST * np.arange(kinds)[:, None] - (skipped[j] - skipped[i + 1])
            best = np.broadcast_to(entry, (kinds, len(_RATIOS))).copy()
            link = np.full((kinds, len(_RATIOS)), -1, dtype=np.int64)
            for h in range(i - 1, max(-1, i - 1 - _LOOK_AHEAD), -1):
                if (h, i) not in score:
                    continue
                offset = np.log(first[:, None]) - np.log(_RATIOS * ends[h, i][1][None])
                fits = np.abs(offset) < _LARGEST_LOG_SCATTER * width
                cut_short = np.where(offset - np.log(_LARGEST_GROWTH / _RATIOS) < 0.0, -_BREAK_COST, -np.inf)
                gain = np.where(fits, _GAIN * strength[j] - 0.5 * (offset / width) ** 2, cut_short)
                total = score[h, i][None] + gain + entry[:, None]
                kind = total.argmax(axis=1)
                top = np.take_along_axis(total, kind[:, None], axis=1)[:, 0]
                cut = ~np.take_along_axis(fits, kind[:, None], axis=1)[:, 0]
                better = top > best
                best = np.where(better, top, best)
                link = np.where(better, (h * kinds + kind) * 2 + cut, link)
            score[i, j], back[i, j] = best, link
    return _walk_back(score, back)


def _walk_back(
    score: dict[tuple[int, int], Array], back: dict[tuple[int, int], NDArray[np.int64]]
) -> tuple[list[int], list[int], list[bool]]:
    """The best chain: event indices, kind of each interval, and the impacts where the pattern breaks."""
    if not score:
        return [], [], []
    (i, j), table = max(score.items(), key=lambda item: float(item[1].max()))
    kind, ratio = (int(x) for x in np.unravel_index(int(table.argmax()), table.shape))
    chain, kinds, broken = [j, i], [kind], [False]
    while (link := int(back[i, j][kind, ratio])) >= 0:
        rest, cut = divmod(link, 2)
        h, kind = divmod(rest, _MOST_MISSED + 1)
        chain.append(h)
        kinds.append(kind)
        broken.append(bool(cut))
        i, j = h, i
    return chain[::-1], kinds[::-1], [*broken, False][::-1]
