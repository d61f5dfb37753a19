"""Robust likelihood: Student-t core (nu = 5) plus a 3 % uniform outlier component for misassociated events.

The loss of one residual is bounded, however large it is. Scatter beyond the uncertainty (excess noise) is common to a
whole channel.

References
----------
K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84, 881 (1989): robust fits with Student's t.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Self

import numpy as np

from analysis.thresholds import LEAST_EXCESS_S, OUTLIER_FRACTION
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

FREEDOM = 5.0  # degrees of freedom of Student's t: robust, and close to normal in the middle
T_PEAK = 0.3796  # density of that t at its centre
FEW = 4  # densities whose product neither overflows nor vanishes
NEVER = -np.inf
EXCESSES_S = np.concatenate([[LEAST_EXCESS_S], np.geomspace(1e-6, 2e-2, 45)])
EXCESSES_OF_PLATE = np.concatenate([[0.0], np.geomspace(0.3, 1e4, 40)])  # in the median uncertainty


def log_odds(sigma_s: Floats, period_s: Floats) -> Floats:
    """Log odds of an outlier: its density over that of a perfect hit of width ``sigma_s``."""
    return np.asarray(np.log(OUTLIER_FRACTION / (1.0 - OUTLIER_FRACTION) / T_PEAK * sigma_s / period_s))


def robust_loss(z: Floats, odds: Floats | float = NEVER) -> Floats:
    """Negative log density of unit residuals, up to a constant; ``odds`` (a logarithm) of being an outlier."""
    inlier = -0.5 * (FREEDOM + 1.0) * np.log1p(z * z / FREEDOM)
    return np.asarray(-np.logaddexp(inlier, odds))


def robust_weight(z: Floats, odds: Floats | float = NEVER) -> Floats:
    """Weight of each residual in the least-squares step that lowers the robust loss."""
    inlier = -0.5 * (FREEDOM + 1.0) * np.log1p(z * z / FREEDOM)
    return np.asarray((FREEDOM + 1.0) / (FREEDOM + z * z) * np.exp(inlier - np.logaddexp(inlier, odds)))


def robust_curvature(z: Floats, odds: Floats | float = NEVER) -> Floats:
    """Second derivative of the robust loss of each residual."""
    inlier = -0.5 * (FREEDOM + 1.0) * np.log1p(z * z / FREEDOM)
    real = np.exp(inlier - np.logaddexp(inlier, odds))  # probability of being no outlier
    slope = (FREEDOM + 1.0) * z / (FREEDOM + z * z)
    core = (FREEDOM + 1.0) * (FREEDOM - z * z) / (FREEDOM + z * z) ** 2
    return np.asarray(real * core - real * (1.0 - real) * slope**2)


def excess_noise(residual_s: Floats, sigma_s: Floats, period_s: Floats) -> tuple[float, float]:
    """Excess noise: scatter beyond the uncertainty by maximum likelihood on a grid, and the loss with it."""
    if len(residual_s) == 0:
        return LEAST_EXCESS_S, 0.0
    outlier = OUTLIER_FRACTION / (1.0 - OUTLIER_FRACTION) / T_PEAK / period_s
    loss = _losses(EXCESSES_S, residual_s, sigma_s, outlier)
    best = int(np.argmin(loss))
    return float(EXCESSES_S[best]), float(loss[best])


@dataclass(frozen=True)
class PlateNoise:
    """Noise of plate data: their uncertainty, and an excess that is common to each kind."""

    rows: Integers  # data in the order of their kinds, (n,)
    bounds: Integers  # where each kind begins in ``rows``, and where the last ends
    sigma: Floats  # uncertainty of ``rows``
    grids: Floats  # excesses that are tried, of each kind, (kinds, g)

    @classmethod
    def of(cls, kind: Integers, sigma: Floats, among: Bools | None = None) -> Self:
        """Of data with a ``kind`` and an uncertainty each, (r,); only those ``among`` (r,) where given."""
        rows = np.argsort(kind, kind="stable")
        if among is not None:
            rows = rows[among[rows]]
        bounds = np.flatnonzero(np.diff(kind[rows], prepend=-1, append=-1)).astype(np.int64)
        own = [sigma[rows[a:b]] for a, b in itertools.pairwise(bounds)]
        grids = np.array([EXCESSES_OF_PLATE * np.median(x) for x in own]).reshape(len(own), len(EXCESSES_OF_PLATE))
        return cls(rows, bounds, sigma[rows], grids)

    def scaled(self, residual: Floats) -> tuple[Floats, Floats]:
        """Uncertainty of ``rows`` with the excess of each kind that is likeliest for these residuals (r,) of all data.

        And its logarithm, relative to the bare uncertainty; (n,) each.
        """
        out = np.empty_like(self.sigma)
        _widen(residual[self.rows], self.sigma, self.bounds, self.grids, out)
        return out, np.log(out / self.sigma)

    def loss(self, residual: Floats) -> float:
        """Loss of ``rows`` with the likeliest excess of each kind, from residuals (r,) of all data."""
        sigma, log = self.scaled(residual)
        return float(np.sum(robust_loss(residual[self.rows] / sigma) + log))


@njit(error_model="numpy", nogil=True)
def _loss(excess: float, residual: Floats, sigma: Floats, outlier: Floats, first: int, last: int) -> float:
    """Loss of residuals from ``first`` to ``last`` at an excess, `robust_loss` and the logarithm of the width in one.

    The cube is that of five degrees of freedom; logarithms are taken of products of a few densities.
    """
    wide, product, total = excess * excess, 1.0, 0.0
    for i in range(first, last):
        variance = sigma[i] * sigma[i] + wide
        far = 1.0 + residual[i] * residual[i] / FREEDOM / variance
        product *= 1.0 / (far * far * far * np.sqrt(variance)) + outlier[i]
        if (i - first) % FEW == FEW - 1:
            total -= np.log(product)
            product = 1.0
    return float(total - np.log(product))


@njit(error_model="numpy", nogil=True)
def _losses(excess: Floats, residual: Floats, sigma: Floats, outlier: Floats) -> Floats:
    """Loss of residuals (n,) at each excess."""
    out = np.empty(len(excess))
    for g in range(len(excess)):
        out[g] = _loss(excess[g], residual, sigma, outlier, 0, len(residual))
    return out


@njit(error_model="numpy", nogil=True)
def _widen(residual: Floats, sigma: Floats, bounds: Integers, grids: Floats, out: Floats) -> None:
    """Uncertainties (n,) with the excess of each kind, between its ``bounds``, that has the lowest loss."""
    never = np.zeros(len(residual))
    for k in range(len(bounds) - 1):
        lowest, wide = np.inf, 0.0
        for g in range(grids.shape[1]):
            loss = _loss(grids[k, g], residual, sigma, never, bounds[k], bounds[k + 1])
            if loss < lowest:
                lowest, wide = loss, grids[k, g]
        for i in range(bounds[k], bounds[k + 1]):
            out[i] = np.sqrt(sigma[i] * sigma[i] + wide * wide)
