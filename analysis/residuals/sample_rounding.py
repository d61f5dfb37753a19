"""Rounding of edges to samples: an error that repeats where the motion does.

A contact circuit that is read once a sample rounds the time of an edge. The error depends on the edge's place between
two samples only, so that edges at the same place err alike: in every cycle, where the drive's period is a whole number
of samples. Edges that are known to less than the rounding were not rounded.

References
----------
B. Widrow, I. Kollar, Quantization Noise (Cambridge, 2008), ch. 5 and 19: the error as a sawtooth, and its dither.
"""

from __future__ import annotations

import math

import numpy as np

from analysis.events.edge_jitter import rounded
from kernels.arrays import Floats

HARMONICS = 4  # of the sawtooth; the rest, a tenth of its variance, counts as each edge's own


def rounding_errors(time_s: Floats, sigma_s: Floats, sampling_s: float, jitter_s: float) -> Floats:
    """Errors of edges that edges at the same place between two samples share, of one sigma each.

    The place of the samples is unknown, so that the covariance of two errors is that of a sawtooth of random phase,
    ``T^2 cos(2 pi m d) / (2 pi^2 m^2)`` summed over its harmonics ``m``, for places that differ by ``d`` samples.
    Jitter of standard deviation ``J`` before the rounding makes it smaller by ``exp(-(2 pi m J / T)^2)``.

    Parameters
    ----------
    time_s : array, shape (n,)
        Predicted edges; NaN where none was.
    sigma_s : array, shape (n,)
        Standard deviation of each measured edge, its rounding included.
    sampling_s : float
        Interval ``T`` between samples; 0 where edges are not rounded.
    jitter_s : float
        Jitter ``J``; infinite where nothing tells it.

    Returns
    -------
    array, shape (n, 2 * HARMONICS)
        Zero for edges that were not rounded.
    """
    if sampling_s == 0.0 or math.isinf(jitter_s):
        return np.zeros((len(time_s), 2 * HARMONICS))
    m = np.arange(1, HARMONICS + 1)
    own = np.isfinite(time_s) & rounded(sigma_s, sampling_s)
    turn = 2.0 * np.pi * m * np.where(own, np.mod(time_s / sampling_s, 1.0), 0.0)[:, None]
    damping = np.exp(-0.5 * (2.0 * np.pi * m * jitter_s / sampling_s) ** 2)
    size = sampling_s / (math.sqrt(2.0) * np.pi * m) * damping
    return np.asarray(np.where(own[:, None], np.hstack([size * np.cos(turn), size * np.sin(turn)]), 0.0))
