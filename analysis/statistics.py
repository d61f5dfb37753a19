"""Robust statistics and matching in time that several rooms of the analysis share."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from kernels.arrays import Floats, Integers

MAD_TO_SIGMA = 1.4826  # standard deviation of normal deviations over their median absolute value
Z95 = 1.96  # standard deviations to either end of a 95 % interval
CORE = 0.98  # part of absolute deviations that `core_sigma` takes


def mad_sigma(deviations: npt.ArrayLike) -> float:
    """Standard deviation of normal ``deviations`` (n,) about zero, from their median absolute value."""
    return MAD_TO_SIGMA * float(np.median(np.abs(deviations)))


def core_sigma(sizes: Floats, every: int = 1) -> float:
    """Standard deviation of normal deviations of ``sizes`` (n,), from those up to their `CORE` quantile.

    Few outliers do not count, and quantisation biases it less than a median. The quantile is that of ``every`` so many.
    """
    most = float(np.quantile(sizes[::every], CORE))
    # the smallest 98 % of normal deviations have an rms of 0.9346 standard deviations
    return float(np.sqrt(np.mean(sizes[sizes <= most] ** 2))) / 0.9346


def median(values: Floats) -> float:
    """Median of a short array (n >= 1,): that of NumPy to the last bit, without its many calls."""
    in_order = np.sort(values)
    if np.isnan(in_order[-1]):
        return float("nan")
    middle = in_order.size // 2
    return float(in_order[middle]) if in_order.size % 2 else float((in_order[middle - 1] + in_order[middle]) / 2.0)


def nearest(sorted_values: Floats, wanted: Floats) -> Integers:
    """Index of the entry of ``sorted_values`` (n >= 1,) nearest to each of ``wanted`` (m,); the later one of a tie."""
    after = np.minimum(np.searchsorted(sorted_values, wanted), sorted_values.size - 1)
    before = np.maximum(after - 1, 0)
    earlier = np.abs(sorted_values[before] - wanted) < np.abs(sorted_values[after] - wanted)
    return np.where(earlier, before, after)


def chance_of_squares(total: float, variances: Floats) -> float:
    """Bound of the probability that squares of independent normal errors sum to ``total`` or more.

    Chernoff's bound ``min over s of E[exp(s (sum - total))]``, which holds however far out in the tail: the probability
    is never stated too small, and too large by ten or a few tens of times.

    Parameters
    ----------
    total
        The sum of squares.
    variances
        Of the errors, (n,), in the unit of ``total``.
    """
    if total <= float(np.sum(variances)):
        return 1.0

    def log_bound(x: float) -> float:
        s = x / (2.0 * variances.max())
        return float(-s * total - 0.5 * np.sum(np.log1p(-2.0 * s * variances)))

    found = minimize_scalar(log_bound, bounds=(0.0, 1.0 - 1e-9), method="bounded")
    return math.exp(min(0.0, float(found.fun)))


def mean_sigma(values: Floats) -> float:
    """Uncertainty of the mean of values in order (n,), of which those of a locked motion repeat."""
    sigma = float(values.std()) / math.sqrt(values.size)
    for length in 2 ** np.arange(1, 14):
        blocks = values[: values.size // length * length].reshape(-1, length).mean(axis=1)
        if blocks.size < 6:  # too few say nothing of their spread
            break
        sigma = max(sigma, float(blocks.std(ddof=1)) / math.sqrt(blocks.size))
    return sigma
