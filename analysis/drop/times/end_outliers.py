"""Events at the ends of a chain that are no impacts of the ball: a click before the drop, a knock after it.

An end is given up only when every simple law of the ratio of successive flights (the same for all,
changing with the flight or with its square), fitted to the other bounces, says that it does not belong to them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_CHANCE = 1e-4
_LEAST_OFF = 3e-3  # of the ratio: a ball is no better than that
_LEAST_ROWS = 5


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


def _is_off(before: Array, ratio: Array, row: int) -> bool:
    """Prediction of one row from all others, by weighted least squares and Student's distribution."""
    others = np.arange(len(ratio)) != row
    scale = before / before.max()
    for basis in (np.ones((len(scale), 1)), np.vander(scale, 2), np.vander(scale**2, 2)):
        for weight in (np.ones(len(scale)), scale):  # bounces that scatter alike; times that jitter alike
            a, b = basis[others] * weight[others, None], ratio[others] * weight[others]
            theta = np.linalg.lstsq(a, b, rcond=None)[0]
            freedom = len(b) - basis.shape[1]
            spread = float(((b - a @ theta) ** 2).sum()) / freedom
            leverage = float(basis[row] @ np.linalg.pinv(a.T @ a) @ basis[row])
            off = abs(float(ratio[row] - basis[row] @ theta))
            sigma = np.sqrt(spread * (1.0 / weight[row] ** 2 + leverage))
            if off < _LEAST_OFF or 2.0 * stats.t.sf(off / max(float(sigma), 1e-12), freedom) > _CHANCE:
                return False
    return True
