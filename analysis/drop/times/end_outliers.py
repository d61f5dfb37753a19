"""Events at the ends of a chain that are no impacts of the ball: a click before the drop, a knock after it.

An end is given up when every simple law of the ratio of successive flights (the same for all, changing with the
flight or with its square) that follows the other bounces says that it does not belong to them; or when it is far
quieter, or louder, than an impact of that speed: the peak of a tap goes with the impact speed to a power of 1 to 1.6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from analysis.statistics import mad_sigma

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_CHANCE = 1e-4
_LEAST_OFF = 3e-3  # of the ratio: a ball is no better than that
_LEAST_ROWS = 5
_POOR, _LEAST_JUDGED = 3.0, 7  # a law that leaves so many times more than the best one, on so many rows, has no say
_LOUD_POWER = 1.3  # of the impact speed, with which the peak of a tap goes
_LEAST_LOUDER, _LOUDER_SIGMAS, _LEAST_HEARD = 1.5, 4.0, 4  # log peak; impacts whose loudness is known


def ends_that_stray(impacts_s: Array, single: Flags) -> tuple[bool, bool]:
    """Whether the first and the last of ``impacts_s`` (n,) belong to something else.

    Parameters
    ----------
    single : (n - 1,) bool
        Intervals that are one flight.
    """
    flights = np.diff(impacts_s)
    rows = np.flatnonzero(single[1:] & single[:-1])
    if len(rows) < _LEAST_ROWS:
        return False, False
    before, ratio = flights[rows], np.log(flights[rows + 1] / flights[rows])
    first = rows[0] == 0 and _is_off(before, ratio, 0)
    last = rows[-1] == len(flights) - 2 and _is_off(before, ratio, len(rows) - 1)
    return bool(first), bool(last)


def ends_unlike_in_loudness(loudness: Array, impacts_s: Array, single: Flags) -> tuple[bool, bool]:
    """Whether the first of a chain is far too quiet, and the last far too loud, for the speeds that the flights say.

    Parameters
    ----------
    loudness : (n,) float64
        Logarithm of the peak of each impact, NaN where not known.
    impacts_s : (n,) float64
    single : (n - 1,) bool
        Intervals that are one flight.
    """
    speed = np.where(single, np.log(np.diff(impacts_s)), np.nan)
    after, before = loudness[:-1] - _LOUD_POWER * speed, loudness[1:] - _LOUD_POWER * speed
    return _apart(-after[0], -after[1:]), _apart(before[-1], before[:-1])


def _apart(one: float, others: Array) -> bool:
    """Whether ``one`` lies far above the others."""
    known = others[np.isfinite(others)]
    if not np.isfinite(one) or len(known) < _LEAST_HEARD:
        return False
    middle = float(np.median(known))
    return bool(one - middle > max(_LEAST_LOUDER, _LOUDER_SIGMAS * mad_sigma(known - middle)))


def _is_off(before: Array, ratio: Array, row: int) -> bool:
    """Prediction of one row from all others, by weighted least squares and Student's distribution."""
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
            laws.append((left, bool(off >= _LEAST_OFF and chance <= _CHANCE)))
    most = _POOR * min(left for left, _ in laws) if int(others.sum()) >= _LEAST_JUDGED else np.inf
    return all(excluded for left, excluded in laws if left <= max(most, _LEAST_OFF))
