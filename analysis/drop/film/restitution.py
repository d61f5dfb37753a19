"""Restitution against impact speed, from measured speeds before and after each impact.

Each bounce has its measuring error and a restitution a little its own, estimated from the scatter by moments
(DerSimonian and Laird 1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from analysis.drop.thresholds import LEVEL_SIGMAS
from kernels.arrays import Floats


@dataclass(frozen=True)
class RestitutionFit:
    """``e = e0 - e1 u``, or constant."""

    # theta, half_width: (p,) ``e0`` (and ``e1`` per unit speed) with half of the 95 % interval
    theta: Floats
    half_width: Floats
    scatter: float  # standard deviation of the restitution from bounce to bounce, beyond the measuring error
    # predicted, held_out: (n,) restitution of each bounce from all, and from the other bounces (NaN where there are
    # too few)
    predicted: Floats
    held_out: Floats
    scores: Floats  # (n,) held-out log likelihood of each bounce; 0 where there are too few to hold any out
    chi_square: float = 0.0  # of the bounces against nothing but their measuring errors
    freedom: int = 0  # bounces less parameters

    @property
    def relative_scatter(self) -> float:
        """Scatter from bounce to bounce over the restitution."""
        return self.scatter / max(abs(float(self.theta[0])), 0.02)

    @property
    def chance(self) -> float:
        """Probability of a chi-square as large, were the measuring errors all there is (1 without freedom)."""
        return float(stats.chi2.sf(self.chi_square, self.freedom)) if self.freedom > 0 else 1.0


def fit_restitution(speed: Floats, ratio: Floats, sigma: Floats, with_speed: bool) -> RestitutionFit:
    """Fit ``ratio`` (n,) at impact speeds ``speed`` (n,), each with measuring error ``sigma`` (n,)."""
    n = len(ratio)
    if with_speed and n < 3:
        constant = fit_restitution(speed, ratio, sigma, with_speed=False)
        theta, width = np.append(constant.theta, 0.0), np.append(constant.half_width, np.inf)
        return RestitutionFit(theta, width, constant.scatter, constant.predicted, constant.held_out, constant.scores)
    basis = np.column_stack([np.ones(n), -speed]) if with_speed else np.ones((n, 1))
    freedom = n - basis.shape[1]
    theta, covariance, scatter = _weighted(basis, ratio, sigma)
    held_out, scores = np.full(n, np.nan), np.zeros(n)
    if n >= 3 + basis.shape[1] - 1:
        for i in range(n):
            others = np.arange(n) != i
            part, spread, own = _weighted(basis[others], ratio[others], sigma[others])
            held_out[i] = basis[i] @ part
            total = sigma[i] ** 2 + max(own, scatter) ** 2 + basis[i] @ spread @ basis[i]
            scores[i] = stats.t.logpdf(ratio[i], max(freedom - 1, 1), held_out[i], np.sqrt(total))
    weight = 1.0 / np.maximum(sigma, 1e-9)  # without extra scatter
    rows = basis * weight[:, None]
    left = weight * ratio - rows @ np.linalg.lstsq(rows, weight * ratio)[0]
    wide = float(stats.t.ppf(0.975, freedom)) if freedom >= 1 and scatter > 0.0 else LEVEL_SIGMAS
    half = wide * np.sqrt(np.diag(covariance))
    return RestitutionFit(theta, half, scatter, basis @ theta, held_out, scores, float(left @ left), freedom)


def _weighted(basis: Floats, ratio: Floats, sigma: Floats) -> tuple[Floats, Floats, float]:
    """Weighted least squares with a common extra scatter that brings chi-square to its degrees of freedom."""
    freedom = basis.shape[0] - basis.shape[1]
    floor = max(1e-6, 1e-3 * float(np.median(sigma)))

    def fitted(scatter: float) -> tuple[Floats, Floats, float]:
        weight = 1.0 / (sigma**2 + scatter**2 + floor**2)
        covariance = np.asarray(np.linalg.pinv((basis * weight[:, None]).T @ basis, hermitian=True), dtype=np.float64)
        theta = covariance @ (basis.T @ (weight * ratio))
        return theta, covariance, float((weight * (ratio - basis @ theta) ** 2).sum()) - freedom

    scatter = 0.0
    if freedom > 0 and fitted(0.0)[2] > 0.0:
        scatter = float(optimize.brentq(lambda s: fitted(s)[2], 0.0, 10.0 * float(np.ptp(ratio)) + floor, xtol=1e-9))
    theta, covariance, _ = fitted(scatter)
    return theta, covariance, scatter
