"""The chain of events that shrinks most steadily, by dynamic programming over pairs of events and ratios of flights."""

from __future__ import annotations

import numpy as np

from kernels.arrays import Floats, Integers

LONGEST_FLIGHT_S = 3.0
_RATIOS = np.linspace(0.20, 0.985, 80)
_WIDTHS = 0.04 + 0.06 * (1.0 - _RATIOS)  # of the logarithm of a ratio from bounce to bounce
_KINDS = np.arange(3)  # impacts that may be missed in one interval
_SKIP_COST = 1.5  # of an event that is left out, in half squares of widths


def best_chain(events: Floats, strength: Floats, may_break: bool = True) -> tuple[list[int], list[int], list[bool]]:
    """Dynamic programme over pairs of events and kinds of interval, for all ratios at once.

    Parameters
    ----------
    events, strength : (n,) float64
        Times, s, and how much of an impact each event is.
    may_break : bool
        Irregular bounces may interrupt the pattern.

    Returns
    -------
    chain, missed, broken
        Indices of its events, impacts missed in each of its intervals, and the impacts where the pattern breaks.
    """
    break_cost = 3.0 if may_break else np.inf
    skipped = np.concatenate(([0.0], np.cumsum(_SKIP_COST * strength)))
    score: dict[tuple[int, int], Floats] = {}  # by the pair that ends a chain: (kinds, ratios)
    back: dict[tuple[int, int], Integers] = {}
    last_flight: dict[tuple[int, int], Floats] = {}
    for j in range(1, len(events)):
        for i in _within_reach(j, skipped):
            interval = events[j] - events[i]
            if not 0.008 <= interval <= LONGEST_FLIGHT_S:
                continue
            # With impacts missing, an interval is a geometric series of flights.
            first = interval * (1.0 - _RATIOS) / (1.0 - _RATIOS ** (_KINDS[:, None] + 1))
            last_flight[i, j] = first * _RATIOS ** _KINDS[:, None]
            # a missed impact costs 3.5 half squares of widths
            entry = -3.5 * _KINDS[:, None] - (skipped[j] - skipped[i + 1])
            best = np.broadcast_to(entry, first.shape).copy()
            link = np.full(first.shape, -1, dtype=np.int64)
            for h in _within_reach(i, skipped):
                if (h, i) not in score:
                    continue
                offset = np.log(first[:, None]) - np.log(_RATIOS * last_flight[h, i][None])
                fits = np.abs(offset) < 3.0 * _WIDTHS  # in widths
                # after an irregular bounce some of the spin may come back: a flight grows by 10 % at most
                cut_short = np.where(offset - np.log(1.1 / _RATIOS) < 0.0, -break_cost, -np.inf)
                # and an impact that fits gains 6 half squares of widths
                gain = np.where(fits, 6.0 * strength[j] - 0.5 * (offset / _WIDTHS) ** 2, cut_short)
                total = score[h, i][None] + gain + entry[:, None]
                kind = total.argmax(axis=1)
                top = np.take_along_axis(total, kind[:, None], axis=1)[:, 0]
                cut = ~np.take_along_axis(fits, kind[:, None], axis=1)[:, 0]
                better = top > best
                best = np.where(better, top, best)
                link = np.where(better, (h * len(_KINDS) + kind) * 2 + cut, link)
            score[i, j], back[i, j] = best, link
    if not score:
        return [], [], []
    (i, j), table = max(score.items(), key=lambda item: float(item[1].max()))
    kind, ratio = (int(x) for x in np.unravel_index(int(table.argmax()), table.shape))
    chain, missed, broken = [j, i], [kind], [False]
    while (step := int(back[i, j][kind, ratio])) >= 0:
        rest, is_cut = divmod(step, 2)
        h, kind = divmod(rest, len(_KINDS))
        chain.append(h)
        missed.append(kind)
        broken.append(bool(is_cut))
        i, j = h, i
    return chain[::-1], missed[::-1], [*broken, False][::-1]


def _within_reach(j: int, skipped: Floats) -> range:
    """Events before ``j`` with so little of an impact between that they may be its predecessor."""
    low = j - 1
    # up to five false events of full strength between two impacts, and 24 of any
    while low > 0 and j - low < 24 and skipped[j] - skipped[low] <= _SKIP_COST * 5:
        low -= 1
    return range(j - 1, low - 1, -1)
