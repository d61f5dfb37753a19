"""Tests whether a chain of events is a ball's: flights that shrink, more steadily than by chance, ever less loud."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.statistics import MAD_TO_SIGMA

Array = NDArray[np.float64]

_EVEN = 0.988  # of successive flights: no ball rebounds so well
_LEAST_SCATTER = 0.01  # of the logarithm of a ratio
_LEAST_TOLERANCE_S = 2e-3
_UNSTEADY = 0.04  # scatter of the logarithm of a ratio, where other events are near: a ball's is half as large
_SOME = 3
_CHANCE = 0.02  # chains as steady expected among as many events at random
_NEAR_S = 5.0
_LOOK_AHEAD = 6
_LEAST_LOUD = 5  # impacts whose loudness is known
_LEAST_RANGE = 0.6  # of the logarithm of the flights
_LEAST_SLOPE = 0.15  # of log peak over log flight; a tap's peak goes with the impact speed, slope 1 to 1.6


def why_no_drop(
    before_s: Array, after_s: Array, loudness: Array, impacts_s: Array, others_s: Array, weight: Array
) -> tuple[str | None, bool]:
    """Why a chain is none of a ball's, in words (None where it may be one), and whether chance makes as good ones.

    Parameters
    ----------
    before_s, after_s : (rows,) float64
        Successive flights.
    loudness : (n,) float64
        Logarithm of the peak of each impact, NaN where not known.
    impacts_s : (n,) float64
        The chain.
    others_s, weight : (m,) float64
        Events outside the chain, and how much of an impact each is, 0 to 1.
    """
    uneven = _uneven(before_s, after_s, impacts_s, others_s) or _louder(loudness, impacts_s)
    if uneven is not None:
        return uneven, False
    expected = by_chance(before_s, after_s, impacts_s, others_s, weight)
    if expected > _CHANCE:
        return f"among as many events {expected:.2g} chains as steady are expected by chance", True
    return None, False


def _uneven(before_s: Array, after_s: Array, impacts_s: Array, others_s: Array) -> str | None:
    """Why the intervals are none of a ball's: even, or not shrinking, or shrinking unsteadily."""
    ratio = np.log(after_s / before_s)
    if float(np.median(ratio)) > np.log(_EVEN):
        return f"it comes at even intervals (ratio {np.exp(float(np.median(ratio))):.3f}), as a metronome; no ball does"
    if len(ratio) >= 3:
        spread = max(float(ratio.std(ddof=1)), _LEAST_SCATTER)
        if float(ratio.mean()) + 2.0 * spread / np.sqrt(len(ratio)) > 0.0:
            return "its intervals do not shrink beyond doubt"
    near = int(((others_s > impacts_s[0] - _NEAR_S) & (others_s < impacts_s[-1] + _NEAR_S)).sum())
    if near >= _SOME and len(ratio) >= _SOME:
        robust = MAD_TO_SIGMA * float(np.median(np.abs(ratio - np.median(ratio))))
        if 0.5 * (robust + float(ratio.std())) > _UNSTEADY:
            return f"its ratios scatter by {float(ratio.std()):.2f}, as those of events at nearly even intervals do"
    return None


def by_chance(before_s: Array, after_s: Array, impacts_s: Array, others_s: Array, weight: Array) -> float:
    """Chains as long and as steady that are expected among the other events at their rate; 0 where there are few."""
    span = float(impacts_s[-1] - impacts_s[0]) + 2.0 * _NEAR_S
    near = (others_s > impacts_s[0] - _NEAR_S) & (others_s < impacts_s[-1] + _NEAR_S)
    count = float(weight[near].sum())
    if count < 1.0:
        return 0.0
    ratio = np.log(after_s / before_s)
    freedom = 2 if len(ratio) >= 6 else 1
    basis = np.vander(before_s / before_s.max(), freedom)
    left = ratio - basis @ np.linalg.lstsq(basis, ratio, rcond=None)[0]
    spread = np.sqrt(float((left**2).sum()) / max(len(ratio) - freedom, 1))
    tolerance = np.maximum(2.5 * max(spread, _LEAST_SCATTER) * after_s, _LEAST_TOLERANCE_S)
    chance = 1.0 - np.exp(-2.0 * tolerance * count / span)
    tested = np.sort(chance)[: max(len(chance) - freedom, 0)] if len(chance) < 6 else np.sort(chance)[:-freedom]
    starts = (float(weight.sum()) + len(impacts_s)) * _LOOK_AHEAD
    return float(starts * np.prod(tested))


def _louder(loudness: Array, impacts_s: Array) -> str | None:
    """Whether impacts fail to grow quieter with the flights."""
    flights = np.diff(impacts_s)
    known = np.isfinite(loudness[:-1]) if len(loudness) == len(impacts_s) else np.zeros(0, dtype=bool)
    if int(known.sum()) < _LEAST_LOUD:
        return None
    x, y = np.log(flights[known]), loudness[:-1][known]
    if float(np.ptp(x)) < _LEAST_RANGE:
        return None
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    left = y - y.mean() - slope * x
    error = float(np.sqrt((left**2).sum() / max(len(x) - 2, 1) / (x @ x)))
    if slope + 2.0 * error < _LEAST_SLOPE:
        return "its events do not grow quieter as the flights grow shorter; loudness goes with the energy of an impact"
    return None
