"""Tests whether a chain of events is a ball's, and whether its ends are: flights that shrink, more steadily than by
chance, ever less loud.

The peak of a tap goes with the impact speed to a power of 1 to 1.6, and the speed with the length of the flight.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

from analysis.drop.thresholds import CHANCE_CHAINS, STRAY_CHANCE
from analysis.statistics import mad_sigma
from kernels.arrays import Bools, Floats

_LEAST_SCATTER = 0.01  # of the logarithm of a ratio
_NEAR_S = 5.0
_LEAST_OFF = 3e-3  # of the ratio: a ball is no better than that


def why_no_drop(
    before_s: Floats, after_s: Floats, loudness: Floats, impacts_s: Floats, others_s: Floats, weight: Floats
) -> tuple[str | None, bool]:
    """Reason why a chain is none of a ball's (None where it may be one), and whether chance makes as good ones.

    ``before_s`` and ``after_s`` (rows,) are successive flights of the chain ``impacts_s`` (n,), ``loudness`` (n,)
    logarithms of peaks, NaN where not known; ``others_s`` (m,) events outside it, each by its ``weight`` an impact.
    """
    ratio = np.log(after_s / before_s)
    near = (others_s > impacts_s[0] - _NEAR_S) & (others_s < impacts_s[-1] + _NEAR_S)
    why = _uneven(ratio, int(near.sum()))
    if why is None and _grows_louder(loudness, impacts_s):
        why = "its events do not grow quieter as the flights grow shorter; loudness goes with the energy of an impact"
    if why is not None:
        return why, False
    count = float(weight[near].sum())
    if count < 1.0:
        return None, False
    # Chains as long and as steady that are expected among the other events at their rate: the product of the chances
    # that an event falls where each flight should end, for every event that such a chain may start from.
    freedom = 2 if len(ratio) >= 6 else 1
    basis = np.vander(before_s / before_s.max(), freedom)
    left = ratio - basis @ np.linalg.lstsq(basis, ratio, rcond=None)[0]
    spread = np.sqrt(float((left**2).sum()) / max(len(ratio) - freedom, 1))
    tolerance = np.maximum(2.5 * max(spread, _LEAST_SCATTER) * after_s, 2e-3)
    span = float(impacts_s[-1] - impacts_s[0]) + 2.0 * _NEAR_S
    chance = np.sort(1.0 - np.exp(-2.0 * tolerance * count / span))
    # a chain by chance may begin with any event and any of the six after it
    starts = (float(weight.sum()) + len(impacts_s)) * 6
    expected = float(starts * np.prod(chance[: max(len(chance) - freedom, 0)]))
    if expected > CHANCE_CHAINS:
        return f"among as many events {expected:.2g} chains as steady are expected by chance", True
    return None, False


def _uneven(ratio: Floats, near: int) -> str | None:
    """Reason why intervals with these log ratios are none of a ball's: even, not shrinking, or shrinking unsteadily."""
    if float(np.median(ratio)) > np.log(0.988):  # of successive flights: no ball rebounds so well
        return f"it comes at even intervals (ratio {np.exp(float(np.median(ratio))):.3f}), as a metronome; no ball does"
    if len(ratio) >= 3:
        spread = max(float(ratio.std(ddof=1)), _LEAST_SCATTER)
        if float(ratio.mean()) + 2.0 * spread / np.sqrt(len(ratio)) > 0.0:
            return "its intervals do not shrink beyond doubt"
    if near >= 3 and len(ratio) >= 3:  # else chance has made no such chain
        robust = mad_sigma(ratio - np.median(ratio))
        # a ball's log ratios scatter half as much: with other events near, more is chance
        if 0.5 * (robust + float(ratio.std())) > 0.04:
            return f"its ratios scatter by {float(ratio.std()):.2f}, as those of events at nearly even intervals do"
    return None


def _grows_louder(loudness: Floats, impacts_s: Floats) -> bool:
    """Whether impacts fail to grow quieter with the flights, beyond two standard errors of the slope."""
    flights = np.diff(impacts_s)
    known = np.isfinite(loudness[:-1]) if len(loudness) == len(impacts_s) else np.zeros(0, dtype=bool)
    if int(known.sum()) < 5:  # impacts whose loudness is known, for a trend of it
        return False
    x, y = np.log(flights[known]), loudness[:-1][known]
    if float(np.ptp(x)) < 0.6:  # of the logarithm of the flights
        return False
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    left = y - y.mean() - slope * x
    error = float(np.sqrt((left**2).sum() / max(len(x) - 2, 1) / (x @ x)))
    return slope + 2.0 * error < 0.15  # of log peak over log flight


def ends_that_stray(impacts_s: Floats, single: Bools) -> tuple[bool, bool]:
    """Whether the first and the last of ``impacts_s`` (n,) belong to something else: a click, a knock.

    An end is given up when every simple law of the ratio of successive flights (the same for all, changing with the
    flight or with its square) that follows the other bounces says that it does not belong to them.

    ``single`` (n - 1,): intervals that are one flight.
    """
    flights = np.diff(impacts_s)
    rows = np.flatnonzero(single[1:] & single[:-1])
    if len(rows) < 5:  # too few to judge an end by
        return False, False
    before, ratio = flights[rows], np.log(flights[rows + 1] / flights[rows])
    first = rows[0] == 0 and _strays(before, ratio, 0)
    last = rows[-1] == len(flights) - 2 and _strays(before, ratio, len(rows) - 1)
    return bool(first), bool(last)


def _strays(before: Floats, ratio: Floats, row: int) -> bool:
    """Whether one row is not what all others predict, by weighted least squares and Student's distribution."""
    others = np.arange(len(ratio)) != row
    scale = before / before.max()
    laws: list[tuple[float, bool]] = []  # what each law leaves of the others, and whether it excludes the row
    for basis in (np.ones((len(scale), 1)), np.vander(scale, 2), np.vander(scale**2, 2)):
        for weight in (np.ones(len(scale)), scale):  # bounces that scatter alike; times that jitter alike
            a, b = basis[others] * weight[others, None], ratio[others] * weight[others]
            theta = np.linalg.lstsq(a, b, rcond=None)[0]
            freedom = len(b) - basis.shape[1]
            spread = float(((b - a @ theta) ** 2).sum()) / freedom
            leverage = float(basis[row] @ np.linalg.pinv(a.T @ a) @ basis[row])
            off = abs(float(ratio[row] - basis[row] @ theta))
            sigma = np.sqrt(spread * (1.0 / weight[row] ** 2 + leverage))
            chance = 2.0 * stats.t.sf(off / max(float(sigma), 1e-12), freedom)
            left = float(np.sqrt(((ratio[others] - basis[others] @ theta) ** 2).mean()))
            laws.append((left, bool(off >= _LEAST_OFF and chance <= STRAY_CHANCE)))
    # a law that leaves three times more than the best one has no say about an end, if seven rows compare them
    most = 3.0 * min(left for left, _ in laws) if int(others.sum()) >= 7 else np.inf
    return all(excluded for left, excluded in laws if left <= max(most, _LEAST_OFF))


def ends_unlike_in_loudness(loudness: Floats, impacts_s: Floats, single: Bools) -> tuple[bool, bool]:
    """Whether the first of a chain is far too quiet, and the last far too loud, for the speeds that the flights say.

    ``loudness`` (n,) are logarithms of peaks, NaN where not known; ``single`` as in `ends_that_stray`.
    """
    speed = np.where(single, np.log(np.diff(impacts_s)), np.nan)
    loud = 1.3 * speed  # the peak goes with a power of 1 to 1.6
    after, before = loudness[:-1] - loud, loudness[1:] - loud
    return _far_above(-after[0], -after[1:]), _far_above(before[-1], before[:-1])


def _far_above(one: float, others: Floats) -> bool:
    known = others[np.isfinite(others)]
    # an end is judged by its own loudness only against four others
    if not np.isfinite(one) or len(known) < 4:
        return False
    middle = float(np.median(known))
    # louder by a factor of e^1.5, and by four of what scatter makes
    return bool(one - middle > max(1.5, 4.0 * mad_sigma(known - middle)))
