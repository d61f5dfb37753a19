"""Constancy of a parameter over runs: chi-square of its values, its trend with the date, and whether only one run
shows it.

References
----------
R. DerSimonian and N. Laird, Control. Clin. Trials 7, 177 (1986): spread between studies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from analysis.thresholds import CALIBRATION_SIGMAS, NULL_P
from kernels.arrays import Floats


@dataclass(frozen=True)
class Constancy:
    """Whether values of several runs are one."""

    chi_square: float  # of the values about their weighted mean
    degrees: int  # of freedom
    p: float  # probability of so large a chi-square for a constant
    spread: float  # standard deviation between runs beyond the values' own uncertainty
    slope: float  # linear trend, per unit of time
    slope_sigma: float  # its standard deviation
    p_trend: float  # probability of so large a trend for a constant

    def differs(self, p: float) -> bool:
        """Whether chance explains neither the scatter nor the trend; ``p`` is shared by both tests."""
        return min(self.p, self.p_trend) < 0.5 * p


def constancy(values: Floats, sigmas: Floats, time: Floats) -> Constancy:
    """Test of values of runs at given times.

    All (R,), the time in any unit; a sigma that is infinite leaves the run out.
    """
    known = np.isfinite(sigmas)
    v, weight, t = values[known], sigmas[known] ** -2.0, time[known]
    if len(v) < 2:
        return Constancy(0.0, 0, 1.0, 0.0, 0.0, np.inf, 1.0)
    total = weight.sum()
    mean, middle = float(weight @ v / total), float(weight @ t / total)
    chi_square, degrees = float(weight @ (v - mean) ** 2), len(v) - 1
    # DerSimonian and Laird: the variance that raises the expected chi square to the one found
    excess = float(max(chi_square - degrees, 0.0) / (total - float(weight @ weight) / total))
    lever = float(weight @ (t - middle) ** 2)
    if lever <= 0.0:
        return Constancy(chi_square, degrees, float(chi2.sf(chi_square, degrees)), excess**0.5, 0.0, np.inf, 1.0)
    # weighted regression on the date
    slope, sigma = float(weight @ ((t - middle) * v)) / lever, float(lever**-0.5)
    p_trend = float(2.0 * norm.sf(abs(slope) / sigma))
    return Constancy(chi_square, degrees, float(chi2.sf(chi_square, degrees)), excess**0.5, slope, sigma, p_trend)


@dataclass(frozen=True)
class OneRun:
    """The only run that shows a parameter."""

    place: int  # of the run
    others: float  # mean of all other runs
    others_sigma: float  # its standard deviation


def one_run_alone(values: Floats, sigmas: Floats, null: float, width: float) -> OneRun | None:
    """The only run that shows a parameter to differ from what does nothing; None where more do, or none does.

    Of a run, a value counts that is farther off than `CALIBRATION_SIGMAS`; of the others together, one that Wald's test
    tells from ``null`` at `NULL_P`, with their scatter.

    Parameters
    ----------
    values, sigmas
        Of each run, (R,); a sigma that is infinite leaves the run out.
    null
        Value that does nothing.
    width
        Standard deviation of what is stated from run to run: a calibration within it is no discovery. 0 for an effect.
    """
    known = np.flatnonzero(np.isfinite(sigmas))
    far = np.abs(values[known] - null) / np.hypot(sigmas[known], width)
    if len(known) < 3 or np.count_nonzero(far > CALIBRATION_SIGMAS) != 1:
        return None
    place = int(known[np.argmax(far)])
    rest = known[known != place]
    # the other runs may scatter by more than they state: their mean is known no better than that
    spread = max(constancy(values[rest], sigmas[rest], np.zeros(len(rest))).spread, width)
    weight = 1.0 / (sigmas[rest] ** 2 + spread**2)
    mean, sigma = float(weight @ values[rest] / weight.sum()), float(weight.sum() ** -0.5)
    shared = abs(mean - null) > norm.isf(0.5 * NULL_P) * sigma
    return None if shared else OneRun(place, mean, sigma)
