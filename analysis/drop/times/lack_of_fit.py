"""Lack of fit of a model of impact times: more scatter than a ball on a flat plate has, or structure left over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from analysis.drop.times.model_fit import Fit
from analysis.drop.times.one_ahead import Rows

Array = NDArray[np.float64]

LARGEST_SCATTER = 0.04  # of the restitution, relative: flat plates and round balls scatter by 0.02 at most
LARGEST_JITTER_S = 8e-3  # of an impact time: a phone's is a tenth of this
LARGEST_RISE = 0.08  # of the restitution over the speeds seen, relative: balls bounce less when faster
_LEAST_ROWS = 8
_CHANCE = 1e-4


def lack_of_fit(fit: Fit, rows: Rows, g_mps2: float) -> list[str]:
    """What the model leaves unexplained, in words; empty where the residuals are noise of a usual size.

    Parameters
    ----------
    fit
        The model fitted.
    rows
        What it was fitted to.
    g_mps2
        Local gravity, m/s^2.
    """
    words = []
    e0 = float(fit.theta[0])
    half = float(fit.half_width()[0])
    slow, fast = _slow_and_fast(fit, rows, g_mps2)
    if e0 - half > 1.0:
        words.append(f"a restitution of {e0:.3f} +- {half:.3f} would gain energy at each impact")
    elif max(slow, fast) > 1.0:
        words.append(f"a restitution of {max(slow, fast):.3f} at some of the speeds seen would gain energy")
    elif fast - slow > LARGEST_RISE * e0:
        words.append(
            f"the restitution would rise from {slow:.3f} at the slowest impact to {fast:.3f} at the fastest; a ball's "
            "falls with the speed: taps of a hand, a plate that gives way, or wrong impacts"
        )
    relative = fit.widths.scatter / max(e0, 0.05)
    if relative > LARGEST_SCATTER:
        words.append(
            f"the restitution scatters by {100 * relative:.1f} % from bounce to bounce, more than a ball on a flat "
            "plate does: a rough ball, a tilted or soft plate, or wrong impacts"
        )
    if fit.widths.jitter_s > LARGEST_JITTER_S:
        words.append(f"impact times scatter by {1e3 * fit.widths.jitter_s:.1f} ms, more than any detector's do")
    chance = structure(fit, rows)
    if chance < _CHANCE:
        words.append(f"what is left over changes steadily with the length of the flight (chance {chance:.1g})")
    return words


def _slow_and_fast(fit: Fit, rows: Rows, g_mps2: float) -> tuple[float, float]:
    """Restitution at the slowest and at the fastest impact that was fitted."""
    before = rows.before_s[rows.valid & ~rows.from_height]
    if not len(before):
        return float(fit.theta[0]), float(fit.theta[0])
    law = fit.model.law(fit.theta, g_mps2)
    speeds = law.return_speed_mps(law.takeoff_speed_mps(np.array([before.min(), before.max()])))
    slow, fast = fit.model.rebound_mps(fit.theta, speeds) / speeds
    return float(slow), float(fast)


def structure(fit: Fit, rows: Rows) -> float:
    """Probability by chance of the trend of the whitened residuals with flight duration (F test; 1 where too few)."""
    length = np.log(rows.before_s[rows.valid])
    taken = ~rows.from_height[rows.valid]
    white, length = fit.white[taken], length[taken]
    n = len(white)
    if n < _LEAST_ROWS or float(np.ptp(length)) < 1e-9:
        return 1.0
    basis = np.vander((length - length.mean()) / float(np.ptp(length)), 3)
    left = white - basis @ np.linalg.lstsq(basis, white, rcond=None)[0]
    explained = float((white**2).sum() - (left**2).sum()) / 3.0
    return float(stats.f.sf(explained / max(float((left**2).sum()) / (n - 3), 1e-300), 3, n - 3))


def chi_square(fit: Fit, jitter_s: float) -> tuple[float, int]:
    """Chi-square of the residuals against a timing jitter alone, and its degrees of freedom.

    A residual joins three impact times: its variance is taken as ``jitter_s^2 (1 + (1 + e)^2 + e^2)``.
    """
    residual = fit.residuals_s[np.isfinite(fit.residuals_s)]
    e = float(fit.theta[0])
    variance = jitter_s**2 * (1.0 + (1.0 + e) ** 2 + e**2)
    return float((residual**2).sum() / max(variance, 1e-300)), fit.freedom
