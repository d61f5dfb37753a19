"""Contacts so short that the voltage never settles: closing and opening from one RC pulse.

Both edges are fitted together to the samples, and to the impact in the accelerometer where there is one. Where many
pairs of edges fit equally well, their spread is the uncertainty.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from analysis.events.edges import Edges, EdgeShape
from analysis.events.impact_detection import Impacts
from analysis.events.levels import CLOSES, DIP, OPENS, Crossings, Levels
from kernels.arrays import Floats

GRID_POINTS = 25  # grid points a parameter in the search for a start
MAX_LENGTH = 3.0  # longest contact, samples; stretched
MAX_SHAPE_ERROR = 0.03  # largest error of the pulse's shape, fraction of the swing, where closings differ in shape
PULSE_TOLERANCE = 0.02  # difference of two pulses, fraction of the swing, within which both are possible
DEGENERATE_SAMPLES = 0.05  # spread of the possible edges above which it replaces the fit's uncertainty
SHORT_SAMPLES = 2  # samples between closing and opening up to which a contact is one pulse; stretched
MIN_TAU_SAMPLES = 0.02  # time constant below which an edge is sharp


def short_contact(
    fraction: Floats,
    noise: float,
    tau_samples: tuple[float, float],
    begin: tuple[float, float],
    prior: tuple[float, float] | None = None,
    longest: float = MAX_LENGTH,
) -> tuple[float, float, float, float] | None:
    """Closing and opening of one short contact, in samples from the window's first, each with its uncertainty.

    Returns close, close_sigma, open, open_sigma; None where no single pulse fits (a contact that bounces).

    Parameters
    ----------
    fraction : array, shape (n,)
        Fraction of the swing, 1 open, around the pulse.
    noise : float
        Standard deviation of ``fraction``.
    tau_samples : tuple of float
        Time constants of closing and opening, in samples.
    begin : tuple of float
        Bounds of the closing's place.
    prior : tuple of float, optional
        Impact in the accelerometer, and its uncertainty, in samples.
    longest : float
        Length of the longest contact, in samples.
    """
    tau = (max(tau_samples[0], MIN_TAU_SAMPLES), max(tau_samples[1], MIN_TAU_SAMPLES))

    def misfit(p: Floats) -> Floats:
        own = (fraction - rc_pulse(fraction.size, p[0], p[1], tau)) / noise
        return own if prior is None else np.append(own, (p[0] - prior[0]) / prior[1])

    close, length = np.meshgrid(np.linspace(*begin, GRID_POINTS), np.linspace(0.02, longest, GRID_POINTS))
    grid = np.column_stack([close.ravel(), length.ravel()])
    if prior is not None:
        fine = np.linspace(0.01, longest, 8 * GRID_POINTS)
        grid = np.concatenate([grid, np.column_stack([np.full(fine.size, prior[0]), fine])])
    costs = ((fraction - rc_pulse(fraction.size, grid[:, :1], grid[:, 1:], tau)) ** 2).sum(axis=1) / noise**2
    if prior is not None:
        costs += ((grid[:, 0] - prior[0]) / prior[1]) ** 2
    bounds = ([begin[0] - 0.5, 1e-4], [begin[1] + 0.5, longest + 1.0])
    # the misfit has several valleys: the three best points of the grid are followed
    chosen = np.clip(grid[np.argsort(costs)[:3]], *bounds)
    tries = [least_squares(misfit, start, bounds=bounds, x_scale=0.1) for start in chosen]
    best = min(tries, key=lambda t: float(t.cost))
    # a misfit of twelve times the noise shows no single pulse
    if 2.0 * best.cost / (fraction.size - 2) > 12.0**2:
        return None
    # prior: edges uniform within their sample, for samples that do not determine both
    slopes = np.asarray(best.jac)
    information = slopes.T @ slopes / max(1.0, 2.0 * best.cost / (fraction.size - 2)) + 12.0 * np.eye(2)
    covariance = np.linalg.inv(information)
    open_variance = covariance[0, 0] + 2 * covariance[0, 1] + covariance[1, 1]
    fit = float(best.x[0]), float(np.sqrt(covariance[0, 0])), float(best.x.sum()), float(np.sqrt(open_variance))
    return fit if prior is not None else _degenerate(fraction, tau, begin, longest, fit)


def _degenerate(
    fraction: Floats,
    tau: tuple[float, float],
    begin: tuple[float, float],
    longest: float,
    fit: tuple[float, float, float, float],
) -> tuple[float, float, float, float]:
    """The fit, or mean and spread of all pairs that match to `PULSE_TOLERANCE`, where these spread far."""
    close, length = np.meshgrid(np.linspace(*begin, 4 * GRID_POINTS), np.linspace(0.01, longest, 8 * GRID_POINTS))
    pairs = np.column_stack([close.ravel(), length.ravel()])
    model = rc_pulse(fraction.size, pairs[:, :1], pairs[:, 1:], tau)
    weight = np.exp(-0.5 * (((fraction - model) / PULSE_TOLERANCE) ** 2).sum(axis=1))
    if weight.sum() < 1e-12:
        return fit
    weight /= weight.sum()
    opening = pairs.sum(axis=1)
    c, o = float(weight @ pairs[:, 0]), float(weight @ opening)
    c_sigma = float(np.sqrt(weight @ (pairs[:, 0] - c) ** 2))
    o_sigma = float(np.sqrt(weight @ (opening - o) ** 2))
    close_out = (c, c_sigma) if c_sigma > DEGENERATE_SAMPLES else fit[:2]
    open_out = (o, o_sigma) if o_sigma > DEGENERATE_SAMPLES else fit[2:]
    return close_out[0], close_out[1], open_out[0], open_out[1]


def rc_pulse(n: int, close: npt.ArrayLike, length: npt.ArrayLike, tau: tuple[float, float]) -> Floats:
    """Fraction of the swing at samples ``0 ... n - 1`` for a contact of ``length`` from ``close``, in samples."""
    since = np.arange(n) - np.asarray(close)
    closed = np.clip(since, 0.0, length)
    depth = -np.expm1(-closed / tau[0])
    return np.asarray(1.0 - depth * np.exp(-np.maximum(since - length, 0.0) / tau[1]))


def refine_short_contacts(
    edges: Edges,
    crossings: Crossings,
    levels: Levels,
    shapes: tuple[EdgeShape, EdgeShape],
    impacts: Impacts,
    rate_hz: float,
) -> Edges:
    """Edges with every short contact fitted as one pulse; a dip becomes a closing and an opening.

    Parameters
    ----------
    edges, crossings
        All of the recording, equal in length.
    levels
        Levels of the circuit.
    shapes : tuple of EdgeShape
        Opening and closing edges.
    impacts
        Impacts in the accelerometer, on the edges' time axis.
    rate_hz
        Sampling rate.
    """
    kind, sample, around = edges.kind, crossings.sample, crossings.around
    stretch, lead = around.stretch, around.lead
    near = np.diff(sample) <= SHORT_SAMPLES * stretch
    pair = np.flatnonzero((kind[:-1] == CLOSES) & (kind[1:] == OPENS) & near)
    noise = levels.noise_v / abs(levels.swing_v)
    shape_error = max(noise, min(noise * shapes[1].chi, MAX_SHAPE_ERROR))  # a bouncing contact leaves no clean pulse
    tau = (shapes[1].tau_s * rate_hz, shapes[0].tau_s * rate_hz)
    if max(tau) < 5.0 * MIN_TAU_SAMPLES:  # sharp edges leave no pulse to fit
        return edges
    time_s, sigma = edges.time_s.copy(), edges.uncertainty_s.copy()
    added: list[tuple[Floats, Floats, int]] = []
    for k in np.sort(np.concatenate([pair, np.flatnonzero(kind == DIP)])):
        start = int(sample[k]) - lead
        after = sample[k + 1 : k + 3][kind[k + 1 : k + 3] == CLOSES]  # the window ends before the next contact
        n = min(lead + around.after, int(after[0]) - start - stretch) if after.size else lead + around.after
        own = crossings.window[k, around.before - lead :][: max(n, lead + 2 * stretch)].astype(np.float64)
        prior = _prior(impacts, start, float(sample[k]), shapes[1], rate_hz, (SHORT_SAMPLES + 1) * stretch)
        # a pulse closes at most 2.5 samples (times the stretch) before its crossing or lowest sample
        begin = lead - 2.5 * stretch, float(lead)
        fit = short_contact(own, noise if prior is None else shape_error, tau, begin, prior, MAX_LENGTH * stretch)
        if fit is None:
            continue
        rises, doubts = (start + np.array(fit[::2])) / rate_hz, np.array(fit[1::2]) / rate_hz
        closing, opening = (s.circuit(rises[i], doubts[i]) for s, i in ((shapes[1], 0), (shapes[0], 1)))
        if kind[k] == DIP:
            if added and closing[0] <= added[-1][0]:
                continue
            added.append((*closing, CLOSES))
            added.append((*opening, OPENS))
        else:
            (time_s[k], sigma[k]), (time_s[k + 1], sigma[k + 1]) = closing, opening
    left = kind != DIP
    return _with_dips(Edges(np.maximum.accumulate(time_s[left]), sigma[left], kind[left]), added)


def _with_dips(edges: Edges, added: list[tuple[Floats, Floats, int]]) -> Edges:
    """Edges, with pairs of a closing and an opening that lie within a single interval in the air put in their places.

    Ringing of the voltage after an edge is no contact.
    """
    pairs = np.array(added).reshape(-1, 2, 3)
    before = np.searchsorted(edges.time_s, pairs[:, :, 0])
    in_air = np.append(CLOSES if edges.kind[:1] == OPENS else OPENS, edges.kind)[before] == OPENS
    more = pairs[in_air.all(axis=1) & (before[:, 0] == before[:, 1])].reshape(-1, 3)
    order = np.argsort(merged := np.concatenate([edges.time_s, more[:, 0]]), kind="stable")
    return Edges(
        merged[order],
        np.concatenate([edges.uncertainty_s, more[:, 1]])[order],
        np.concatenate([edges.kind, more[:, 2].astype(np.int8)])[order],
    )


def _prior(
    impacts: Impacts, start: int, sample: float, shape: EdgeShape, rate_hz: float, reach: int
) -> tuple[float, float] | None:
    """RC's fall by the accelerometer's impact within ``reach`` samples, in those of the window; None without one."""
    if not impacts.time_s.size:
        return None
    k = int(np.argmin(np.abs(impacts.time_s * rate_hz - sample + 0.5)))
    place = float(impacts.time_s[k] * rate_hz)
    if abs(place - sample + 0.5) > reach:
        return None
    doubt_s = float(np.hypot(impacts.uncertainty_s[k], shape.clock_s / np.sqrt(12.0)))
    return place - start - shape.lag_s * rate_hz, max(doubt_s * rate_hz, 1e-3)
