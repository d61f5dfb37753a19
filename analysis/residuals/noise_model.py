"""Robust likelihood: Student-t core (nu = 5) plus a 3 % uniform outlier component for misassociated events.

The loss of one residual is bounded, however large it is. Scatter beyond the uncertainty (excess noise) is common to a
whole channel.

References
----------
K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84, 881 (1989): robust fits with Student's t.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.thresholds import LEAST_EXCESS_S, OUTLIER_FRACTION
from kernels import njit

Array = NDArray[np.float64]

FREEDOM = 5.0  # degrees of freedom of Student's t: robust, and close to normal in the middle
T_PEAK = 0.3796  # density of that t at its centre
LARGEST_EXCESS_S = 2e-2
FEW = 4  # densities whose product neither overflows nor vanishes
NEVER = -np.inf
EXCESSES_S = np.concatenate([[LEAST_EXCESS_S], np.geomspace(1e-6, LARGEST_EXCESS_S, 45)])
EXCESSES_OF_PLATE = np.concatenate([[0.0], np.geomspace(0.3, 1e4, 40)])  # in the median uncertainty


def log_odds(sigma_s: Array, period_s: Array) -> Array:
    """Log odds of an outlier: its density over that of a perfect hit of width ``sigma_s``."""
    return np.asarray(np.log(OUTLIER_FRACTION / (1.0 - OUTLIER_FRACTION) / T_PEAK * sigma_s / period_s))


def robust_loss(z: Array, odds: Array | float = NEVER) -> Array:
    """Negative log density of unit residuals, up to a constant; ``odds`` (a logarithm) of being an outlier."""
    inlier = -0.5 * (FREEDOM + 1.0) * np.log1p(z * z / FREEDOM)
    return np.asarray(-np.logaddexp(inlier, odds))


def robust_weight(z: Array, odds: Array | float = NEVER) -> Array:
    """Weight of each residual in the least-squares step that lowers the robust loss."""
    inlier = -0.5 * (FREEDOM + 1.0) * np.log1p(z * z / FREEDOM)
    return np.asarray((FREEDOM + 1.0) / (FREEDOM + z * z) * np.exp(inlier - np.logaddexp(inlier, odds)))


def robust_curvature(z: Array, odds: Array | float = NEVER) -> Array:
    """Second derivative of the robust loss of each residual."""
    inlier = -0.5 * (FREEDOM + 1.0) * np.log1p(z * z / FREEDOM)
    real = np.exp(inlier - np.logaddexp(inlier, odds))  # probability of being no outlier
    slope = (FREEDOM + 1.0) * z / (FREEDOM + z * z)
    core = (FREEDOM + 1.0) * (FREEDOM - z * z) / (FREEDOM + z * z) ** 2
    return np.asarray(real * core - real * (1.0 - real) * slope**2)


def excess_noise(residual_s: Array, sigma_s: Array, period_s: Array) -> tuple[float, float]:
    """Excess noise: scatter beyond the uncertainty by maximum likelihood on a grid, and the loss with it."""
    if len(residual_s) == 0:
        return LEAST_EXCESS_S, 0.0
    outlier = OUTLIER_FRACTION / (1.0 - OUTLIER_FRACTION) / T_PEAK / period_s
    loss = _losses(EXCESSES_S, residual_s, sigma_s, outlier)
    best = int(np.argmin(loss))
    return float(EXCESSES_S[best]), float(loss[best])


def plate_scale(kind: NDArray[np.int64], residual: Array, sigma: Array) -> tuple[Array, Array]:
    """Uncertainty of plate data with each kind's likeliest excess noise, and its logarithm relative to the bare one."""
    out = sigma.copy()
    for k in np.unique(kind):
        rows = np.flatnonzero(kind == k)
        own = sigma[rows]
        grid = EXCESSES_OF_PLATE * np.median(own)
        best = grid[np.argmin(_losses(grid, residual[rows], own, np.zeros(len(own))))]
        out[rows] = np.sqrt(own * own + best * best)
    return out, np.log(out / sigma)


@njit(error_model="numpy", nogil=True)
def _losses(excess: Array, residual: Array, sigma: Array, outlier: Array) -> Array:
    """Loss of residuals (n,) at each excess, `robust_loss` and the logarithm of the width in one.

    The cube is that of five degrees of freedom; logarithms are taken of products of a few densities.
    """
    out = np.zeros(len(excess))
    for g in range(len(excess)):
        wide, product = excess[g] * excess[g], 1.0
        for i in range(len(residual)):
            variance = sigma[i] * sigma[i] + wide
            far = 1.0 + residual[i] * residual[i] / FREEDOM / variance
            product *= 1.0 / (far * far * far * np.sqrt(variance)) + outlier[i]
            if i % FEW == FEW - 1:
                out[g] -= np.log(product)
                product = 1.0
        out[g] -= np.log(product)
    return out
