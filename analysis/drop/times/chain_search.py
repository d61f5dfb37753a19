"""The chain of events that shrinks most steadily, by dynamic programming over pairs of events and ratios of flights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_RATIOS = np.linspace(0.20, 0.985, 80)
_LOOK_AHEAD = 6  # events of full strength that may be false between two impacts, plus one
_MOST_LOOK_AHEAD = 24  # events of any strength
_MOST_MISSED = 2  # impacts that may be missed in one interval
_GAIN, _MISS_COST, _SKIP_COST, _BREAK_COST = 6.0, 3.5, 1.5, 3.0
_LARGEST_GROWTH = 1.1  # of a flight after an irregular bounce: no bounce adds energy, some of the spin may come back
LONGEST_FLIGHT_S = 3.0
_SHORTEST_FLIGHT_S = 0.008
_LARGEST_LOG_SCATTER = 3.0  # in widths


def _ends(interval: float) -> tuple[Array, Array]:
    """First and last flight (kinds, ratios) of an interval that holds 0, 1, 2 missed impacts."""
    powers = np.arange(_MOST_MISSED + 1)[:, None]
    first = interval * (1.0 - _RATIOS) / (1.0 - _RATIOS ** (powers + 1))
    return first, first * _RATIOS**powers


def best_chain(events: Array, strength: Array, may_break: bool = True) -> tuple[list[int], list[int], list[bool]]:
    """Dynamic programme over pairs of events and kinds of interval, for all ratios at once.

    Parameters
    ----------
    events, strength : (n,) float64
        Times, s, and how much of an impact each event is.
    may_break : bool
        Irregular bounces may interrupt the pattern.
    """
    break_cost = _BREAK_COST if may_break else np.inf
    n = len(events)
    skipped = np.concatenate(([0.0], np.cumsum(_SKIP_COST * strength)))
    width = 0.04 + 0.06 * (1.0 - _RATIOS)
    kinds = _MOST_MISSED + 1
    score: dict[tuple[int, int], Array] = {}
    back: dict[tuple[int, int], NDArray[np.int64]] = {}
    ends: dict[tuple[int, int], tuple[Array, Array]] = {}
    for j in range(1, n):
        for i in _within_reach(j, skipped):
            if not _SHORTEST_FLIGHT_S <= events[j] - events[i] <= LONGEST_FLIGHT_S:
                continue
            ends[i, j] = _ends(events[j] - events[i])
            first = ends[i, j][0]
            entry = -_MISS_COST * np.arange(kinds)[:, None] - (skipped[j] - skipped[i + 1])
            best = np.broadcast_to(entry, (kinds, len(_RATIOS))).copy()
            link = np.full((kinds, len(_RATIOS)), -1, dtype=np.int64)
            for h in _within_reach(i, skipped):
                if (h, i) not in score:
                    continue
                offset = np.log(first[:, None]) - np.log(_RATIOS * ends[h, i][1][None])
                fits = np.abs(offset) < _LARGEST_LOG_SCATTER * width
                cut_short = np.where(offset - np.log(_LARGEST_GROWTH / _RATIOS) < 0.0, -break_cost, -np.inf)
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


def _within_reach(j: int, skipped: Array) -> range:
    """Events before ``j`` with so little of an impact between that they may be its predecessor."""
    low = j - 1
    while low > 0 and j - low < _MOST_LOOK_AHEAD and skipped[j] - skipped[low] <= _SKIP_COST * (_LOOK_AHEAD - 1):
        low -= 1
    return range(j - 1, low - 1, -1)


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
