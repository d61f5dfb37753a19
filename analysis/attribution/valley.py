"""A fit led on along a valley: a direction in which parameters can hardly be told from each other.

There a damped step gains too little to go on, and an undamped one leaves the valley where it bends. So each step is
bent as the residuals are (geodesic acceleration). Decision 593.

References
----------
M. K. Transtrum, J. P. Sethna, arXiv:1201.5885 (2012).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.attribution.fit import LEAST_GAIN, Fitted, damped_step, linear_gain, of_same_events
from analysis.residuals.noise.noise_model import robust_weight
from kernels.arrays import Floats

DAMPING = 1e-10
REACH = 0.1  # of a step, over which the curvature is taken
PARTS = (1.0, 0.5, 0.25, 0.125)
MOST_STEPS = 12


def to_the_bottom(fitted: Fitted) -> Fitted:
    """The fit where no step gains more than `LEAST_GAIN` any more, by slopes of all parameters taken anew."""
    for _ in range(MOST_STEPS):
        if _promised(fitted) < LEAST_GAIN:
            break
        fitted = replace(fitted, bare=_slopes(fitted))
        further = _further(fitted)
        if further is None:
            break
        fitted = further
    return fitted


def _slopes(fitted: Fitted) -> Floats:
    """Derivatives of the bare residuals where the fit stands."""
    bare = np.zeros_like(fitted.bare)
    fitted.state.fill(bare, fitted.x, fitted.raw, range(len(fitted.x)))
    return bare


def _promised(fitted: Fitted) -> float:
    """Gain in nats of a step to the bottom if residuals were linear."""
    normal, gradient = fitted.normal(fitted.state.mask)
    step = damped_step(normal, gradient, DAMPING, fitted.state.low - fitted.x, fitted.state.high - fitted.x)
    return linear_gain(normal, gradient, step)


def _further(fitted: Fitted) -> Fitted | None:
    """The fit after one bent step, or a part of it; None where nothing gains."""
    state, here = fitted.state, fitted.x
    low, high = state.low - here, state.high - here
    normal, gradient = fitted.normal(state.mask)
    step = damped_step(normal, gradient, DAMPING, low, high)
    change = state.raw(here + REACH * step) - fitted.raw
    same = (change == of_same_events(change, state.whitener)) & ~state.leaping
    curved = np.where(same, 2.0 / REACH * (change / REACH - fitted.bare @ step), 0.0)
    white = state.whitener
    jacobian = white.white_slopes(np.column_stack([fitted.bare, curved]), fitted.raw)
    weight = np.where(state.mask, robust_weight(white.white_all(fitted.raw), white.odds), 0.0)
    bend = damped_step(normal, -(jacobian[:, :-1].T @ (weight * jacobian[:, -1])), DAMPING, low - step, high - step)
    for part in PARTS:
        x = np.clip(here + part * step + 0.5 * part**2 * bend, state.low, state.high)
        raw = state.raw(x)
        loss = state.loss(raw, x)
        if loss < fitted.loss:
            return replace(fitted, x=x, raw=raw, loss=loss)
    return None
