"""Contacts so brief that the continuity voltage never settles: both edges from the dent they leave.

The rule kept here: closing and opening are fitted together to the samples (and to the impact in the accelerometer,
where there is one); a dent that fits many pairs says so in its uncertainty.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from analysis.events.edges import AFTER, BEFORE, CLOSES, DIP, OPENS, Crossings, Edges, EdgeShape, Levels
from analysis.events.impact_detection import Impacts

Floats = npt.NDArray[np.float64]

FAR = 1 << 30
LEAD = 4  # samples before a crossing that are looked at
STARTS = 25  # grid points a parameter in the search for a start
LONGEST = 3.0  # samples
MOST_MISFIT = 12.0  # times the noise beyond which the samples show no single dent
UNLIKE = 0.03  # of the swing: most by which samples are doubted where closings do not look alike
ALIKE = 0.02  # of the swing: dents nearer than this may be taken for each other in the search for a ridge
FAR_APART = 0.05  # samples: a spread beyond this is a ridge
BRIEF = 2  # samples between closing and opening up to which a contact is fitted as one dent
SHARPEST = 0.02  # samples: a time constant below this cannot be told from none


def brief_contact(
    fraction: Floats,
    noise: float,
    tau_samples: tuple[float, float],
    begin: tuple[float, float],
    prior: tuple[float, float] | None = None,
) -> tuple[float, float, float, float] | None:
    """Closing and opening of one brief contact, in samples from the window's first, each with its uncertainty.

    Parameters
    ----------
    fraction : array, shape (n,)
        Fraction of the swing, 1 open, around the dent.
    noise : float
        Its standard deviation.
    tau_samples : tuple of float
        Time constants of closing and opening, in samples.
    begin : tuple of float
        Between which places the closing is looked for.
    prior : tuple of float, optional
        The impact's time according to the accelerometer, and its uncertainty, in samples.

    Returns
    -------
    close, close_sigma, open, open_sigma : float
        None where no single dent looks like this (a contact that bounces).
    """
    tau = (max(tau_samples[0], SHARPEST), max(tau_samples[1], SHARPEST))

    def misfit(p: Floats) -> Floats:
        own = (fraction - rc_pulse(fraction.size, p[0], p[1], tau)) / noise
        return own if prior is None else np.append(own, (p[0] - prior[0]) / prior[1])

    close, length = np.meshgrid(np.linspace(*begin, STARTS), np.linspace(0.02, LONGEST, STARTS))
    grid = np.column_stack([close.ravel(), length.ravel()])
    if prior is not None:
        fine = np.linspace(0.01, LONGEST, 8 * STARTS)
        grid = np.concatenate([grid, np.column_stack([np.full(fine.size, prior[0]), fine])])
    costs = ((fraction - rc_pulse(fraction.size, grid[:, :1], grid[:, 1:], tau)) ** 2).sum(axis=1) / noise**2
    if prior is not None:
        costs += ((grid[:, 0] - prior[0]) / prior[1]) ** 2
    bounds = ([begin[0] - 0.5, 1e-4], [begin[1] + 0.5, LONGEST + 1.0])
    chosen = np.clip(grid[np.argsort(costs)[:3]], *bounds)
    tries = [least_squares(misfit, start, bounds=bounds, x_scale=0.1) for start in chosen]
    best = min(tries, key=lambda t: float(t.cost))
    if 2.0 * best.cost / (fraction.size - 2) > MOST_MISFIT**2:
        return None
    # where the samples cannot tell (both edges between the same two), the edges lie within their sample all the same
    slopes = np.asarray(best.jac)
    information = slopes.T @ slopes / max(1.0, 2.0 * best.cost / (fraction.size - 2)) + 12.0 * np.eye(2)
    covariance = np.linalg.inv(information)
    open_variance = covariance[0, 0] + 2 * covariance[0, 1] + covariance[1, 1]
    fit = float(best.x[0]), float(np.sqrt(covariance[0, 0])), float(best.x.sum()), float(np.sqrt(open_variance))
    return fit if prior is not None else _ridge(fraction, tau, begin, fit)


def _ridge(
    fraction: Floats, tau: tuple[float, float], begin: tuple[float, float], fit: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """The fit, or the spread of all pairs that match the samples to `ALIKE`, where these reach far beyond it."""
    close, length = np.meshgrid(np.linspace(*begin, 4 * STARTS), np.linspace(0.01, LONGEST, 8 * STARTS))
    pairs = np.column_stack([close.ravel(), length.ravel()])
    model = rc_pulse(fraction.size, pairs[:, :1], pairs[:, 1:], tau)
    weight = np.exp(-0.5 * (((fraction - model) / ALIKE) ** 2).sum(axis=1))
    if weight.sum() < 1e-12:
        return fit
    weight /= weight.sum()
    opening = pairs.sum(axis=1)
    c, o = float(weight @ pairs[:, 0]), float(weight @ opening)
    c_sigma = float(np.sqrt(weight @ (pairs[:, 0] - c) ** 2))
    o_sigma = float(np.sqrt(weight @ (opening - o) ** 2))
    close_out = (c, c_sigma) if c_sigma > FAR_APART else fit[:2]
    open_out = (o, o_sigma) if o_sigma > FAR_APART else fit[2:]
    return close_out[0], close_out[1], open_out[0], open_out[1]


def rc_pulse(n: int, close: npt.ArrayLike, length: npt.ArrayLike, tau: tuple[float, float]) -> Floats:
    """Fraction of the swing at samples ``0 ... n - 1`` around a contact of ``length`` from ``close`` (samples)."""
    since = np.arange(n) - np.asarray(close)
    closed = np.clip(since, 0.0, length)
    depth = -np.expm1(-closed / tau[0])
    return np.asarray(1.0 - depth * np.exp(-np.maximum(since - length, 0.0) / tau[1]))


def refine_brief(
    edges: Edges,
    crossings: Crossings,
    levels: Levels,
    shapes: tuple[EdgeShape, EdgeShape],
    impacts: Impacts,
    rate_hz: float,
) -> Edges:
    """Edges with every brief contact fitted as one dent; a dip becomes a closing and an opening.

    Parameters
    ----------
    edges, crossings
        Of the whole recording, equal in length.
    levels
        Of the circuit.
    shapes : tuple of EdgeShape
        Of opening and closing edges.
    impacts
        The accelerometer's, on the axis of the edges.
    rate_hz
        Sampling rate.
    """
    kind, sample = edges.kind, crossings.sample
    pair = np.flatnonzero((kind[:-1] == CLOSES) & (kind[1:] == OPENS) & (np.diff(sample) <= BRIEF))
    noise = levels.noise_v / abs(levels.swing_v)
    unlike = max(noise, min(noise * shapes[1].chi, UNLIKE))  # a contact that bounces leaves no clean dent
    tau = (shapes[1].tau_s * rate_hz, shapes[0].tau_s * rate_hz)
    if max(tau) < 5.0 * SHARPEST:  # sharp edges leave no dent to fit
        return edges
    time_s, sigma = edges.time_s.copy(), edges.uncertainty_s.copy()
    added = []
    for k in np.sort(np.concatenate([pair, np.flatnonzero(kind == DIP)])):
        start = int(sample[k]) - LEAD
        after = sample[k + 1 : k + 3][kind[k + 1 : k + 3] == CLOSES]  # the next contact is none of this one's
        n = int(min(LEAD + AFTER, (after[0] - start - 1) if after.size else FAR))
        own = crossings.window[k, BEFORE - LEAD :][: max(n, LEAD + 2)].astype(np.float64)
        prior = _prior(impacts, start, float(sample[k]), rate_hz)
        fit = brief_contact(own, noise if prior is None else unlike, tau, (LEAD - 2.5, float(LEAD)), prior)
        if fit is None:
            continue
        closing, opening = (start + fit[0]) / rate_hz, (start + fit[2]) / rate_hz
        if kind[k] == DIP:
            added.append((closing, fit[1] / rate_hz, CLOSES))
            added.append((opening, fit[3] / rate_hz, OPENS))
        else:
            time_s[k], sigma[k], time_s[k + 1], sigma[k + 1] = closing, fit[1] / rate_hz, opening, fit[3] / rate_hz
    left = kind != DIP
    more = np.array(added).reshape(-1, 3)
    merged = np.concatenate([time_s[left], more[:, 0]])
    order = np.argsort(merged, kind="stable")
    return Edges(
        merged[order],
        np.concatenate([sigma[left], more[:, 1]])[order],
        np.concatenate([kind[left], more[:, 2].astype(np.int8)])[order],
    )


def _prior(impacts: Impacts, start: int, sample: float, rate_hz: float) -> tuple[float, float] | None:
    """The accelerometer's impact at this dent, in samples of the window; None where it saw none."""
    if not impacts.time_s.size:
        return None
    k = int(np.argmin(np.abs(impacts.time_s * rate_hz - sample + 0.5)))
    place = float(impacts.time_s[k] * rate_hz)
    if abs(place - sample + 0.5) > BRIEF + 1:
        return None
    return place - start, max(float(impacts.uncertainty_s[k]) * rate_hz, 1e-3)
