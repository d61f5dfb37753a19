"""Parameters over runs: those that all share, by hierarchical least squares, and whether one is constant.

Each run is a quadratic form in its own calibrations and the shared parameters. A run's calibrations are normal about
the means of the population, with one spread a calibration; means, shared parameters and spreads follow from all runs.
Where runs tell little of a calibration, its spread is no more than what is stated of it: spreads have a half-normal
prior of that width.

A parameter is constant by the chi-square of its values, its trend with the date, and whether only one run shows it.

References
----------
N. M. Laird and J. H. Ware, Biometrics 38, 963 (1982): random effects, spreads by the EM algorithm.
M. J. Lindstrom and D. M. Bates, Biometrics 46, 673 (1990): linearised where the population is.
A. Gelman, Bayesian Anal. 1, 515 (2006): half-normal priors of spreads where there are few groups.
A. Gelman and J. Hill, Data Analysis Using Regression and Multilevel Models (Cambridge, 2007), chapter 12.
R. DerSimonian and N. Laird, Control. Clin. Trials 7, 177 (1986): spread between studies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from analysis.linear_algebra import inv, pinv, solve
from analysis.thresholds import CALIBRATION_SIGMAS, NULL_P
from kernels.arrays import Floats, Integers

LEAST_SPREAD = 1e-4  # of a prior's width: below, a calibration is common to all runs


@dataclass(frozen=True)
class Quadratic:
    """Log likelihood of one run about a point, second order; calibrations first (q), then shared parameters."""

    origin: Floats  # the point, (K,)
    gradient: Floats  # slope there, (K,)
    information: Floats  # negative curvature, (K, K)

    def without_own(self, spread: Floats) -> Quadratic:
        """The run's own deviations integrated out: calibrations are then those of the population.

        ``spread`` is the standard deviation of each calibration from run to run, (q,).
        """
        q = len(spread)
        # Woodbury's identity in units of the spreads: a spread of 0 needs no inverse
        inner = np.eye(q) + spread[:, None] * self.information[:q, :q] * spread
        across = spread[:, None] * self.information[:q]
        follow = solve(inner, np.column_stack([across, spread * self.gradient[:q]]))
        return Quadratic(
            self.origin, self.gradient - across.T @ follow[:, -1], self.information - across.T @ follow[:, :-1]
        )

    def slope_at(self, x: Floats) -> Floats:
        """Gradient at a point, (K,)."""
        return self.gradient - self.information @ (x - self.origin)

    def loss_at(self, x: Floats) -> float:
        """Negative log likelihood at a point, above that of the origin, nats."""
        away = x - self.origin
        return float(0.5 * away @ self.information @ away - self.gradient @ away)


@dataclass(frozen=True)
class Priors:
    """What is known before any run: means of the population and their precisions, (K,); precision 0 for nothing."""

    mean: Floats
    precision: Floats


@dataclass(frozen=True)
class Population:
    """All runs together."""

    x: Floats  # means of the calibrations, then shared parameters, (K,); what is not free stays where it began
    free: Integers  # places of what was fitted
    covariance: Floats  # of these
    spread: Floats  # of each calibration from run to run, (q,)
    runs: tuple[Quadratic, ...]  # each run's quadratic, its own deviations integrated out
    prior: Priors

    def sigma(self, place: int) -> float:
        """Standard deviation of a fitted mean or shared parameter; infinite where nothing is known."""
        where = np.flatnonzero(self.free == place)
        return float(np.sqrt(max(self.covariance[where[0], where[0]], 0.0))) if len(where) else np.inf


def fit_population(
    runs: Sequence[Quadratic], start: Floats, spread: Floats, prior: Priors, free: Integers
) -> Population:
    """Means, shared parameters and spreads of greatest posterior probability, from one quadratic a run.

    What is ``free``, all calibrations first, is fitted; the rest stays at ``start`` (K,). ``spread`` (q,) are the
    widths of the spreads' half-normal priors, where they begin; a spread of zero stays zero.
    """
    spread, width = spread.copy(), np.maximum(spread, 1e-300)
    # EM converges slowly where a spread is small: up to 300 rounds
    for _ in range(300):
        found = at_spread(runs, start, spread, prior, free)
        squares = np.mean([_own_squares(run, found) for run in runs], axis=0)
        # where -n log s - S / (2 s^2) - s^2 / (2 w^2) is greatest: S is the sum of the deviations' squares over the n
        # runs, w the width of the half-normal prior (Gelman 2006)
        n, ratio = len(runs), len(runs) * squares * spread**2 / width**2
        after = np.asarray(width * np.sqrt(2.0 * ratio / (n + np.sqrt(n**2 + 4.0 * ratio))))
        change = float(np.max(np.abs(after - spread) / width, initial=0.0))
        spread = np.where(after < LEAST_SPREAD * width, 0.0, after)
        # the spreads, as parts of the widest one, stand still
        if change < 1e-3:
            break
    return at_spread(runs, start, spread, prior, free)


def at_spread(runs: Sequence[Quadratic], start: Floats, spread: Floats, prior: Priors, free: Integers) -> Population:
    """As `fit_population`, at given spreads."""
    runs = [run.without_own(spread) for run in runs]
    normal, push = normal_equations(runs, start, prior, free)
    covariance = np.asarray(pinv(normal, rcond=1e-13, hermitian=True), dtype=np.float64)
    x = start.copy()
    x[free] += covariance @ push
    return Population(x, free, covariance, spread, tuple(runs), prior)


def normal_equations(runs: Sequence[Quadratic], at: Floats, prior: Priors, free: Integers) -> tuple[Floats, Floats]:
    """Curvature and slope of the log posterior at a point, of what is free."""
    normal = np.sum([run.information[np.ix_(free, free)] for run in runs], axis=0)
    normal[np.diag_indices(len(free))] += prior.precision[free]
    push = np.sum([run.slope_at(at)[free] for run in runs], axis=0)
    return normal, push - prior.precision[free] * (at - prior.mean)[free]


def _own_squares(run: Quadratic, found: Population) -> Floats:
    """Expected square of a run's deviations over their spread, (q,)."""
    spread, free = found.spread, found.free
    q = len(spread)
    # E step: variance of the deviations, their squared mean, and what the uncertainty of the means adds
    inverse = inv(np.eye(q) + spread[:, None] * run.information[:q, :q] * spread)
    own = inverse @ (spread * run.slope_at(found.x)[:q])
    follow = inverse @ (spread[:, None] * run.information[:q][:, free])
    return np.asarray(np.diag(inverse) + own**2 + np.einsum("ij,jk,ik->i", follow, found.covariance, follow))


def each_on_its_own(runs: Sequence[Quadratic], found: Population, place: int) -> tuple[Floats, Floats]:
    """Each run's own value of one parameter and its standard deviation, all else as in the population, (R,).

    A run's other calibrations are free within the spreads; the one at ``place`` is not drawn to its mean.
    """
    spread = found.spread.copy()
    if place < len(spread):
        spread[place] = 0.0
    values, sigmas = np.full(len(runs), found.x[place]), np.full(len(runs), np.inf)
    for i, run in enumerate(runs):
        rest = run.without_own(spread)
        known = rest.information[place, place]
        # below 1e-9 of information a coordinate is unknown, and its sigma infinite
        if known > 1e-9:
            values[i] += rest.slope_at(found.x)[place] / known
            sigmas[i] = 1.0 / np.sqrt(known)
    return values, sigmas


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
    tells from ``null`` at `NULL_P`, with their scatter. ``values`` and ``sigmas`` are of each run, (R,), an infinite
    sigma leaves it out. ``width`` is the deviation stated from run to run: a calibration within it is no discovery.
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
