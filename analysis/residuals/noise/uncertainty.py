"""Uncertainty of predicted events: that of edges and of the plate's tones, carried through the prediction.

Each number on which events depend is moved by one standard deviation, either way, and the events are predicted anew:
what is odd in that is the change, what is even its second order, large near grazes and tangent take-offs. Decision 534.

A contact circuit that is read once a sample rounds the time of an edge. The error depends on the edge's place between
two samples only, so that edges at the same place err alike: in every cycle, where the drive's period is a whole number
of samples. Edges that are known to less than the rounding were not rounded.

References
----------
B. Widrow, I. Kollar, Quantization Noise (Cambridge, 2008), ch. 5 and 19: the error as a sawtooth, and its dither.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.events.edge_jitter import rounded
from analysis.linear_algebra import eigh
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.changes import Changes, Kicks, Moves, finite
from analysis.residuals.values import Values
from kernels.arrays import Complexes, Floats, Integers
from model.effects.registry import offsets
from model.integrator.one_step import Predicted
from model.integrator.problem import active, columns_of, plate_mode

REBOUND_STEP = 1e-4  # finite difference of a restitution
STEEPEST_BY_REBOUND_S = 1.0  # a flight at 5 m/s lasts so long; a larger slope means another event
HARMONICS = 4  # of the sawtooth of rounding; the rest, a tenth of its variance, counts as each edge's own


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of opening and landing residuals at one point; arrays (n,), tones (n, q).

    ``*_sigma_s`` is that of the edges, propagated, and of rebounds that scatter; ``*_by_tone`` the change for one sigma
    of each quadrature of each plate tone of the event's step, of the state of a plate mode in the step, and of
    each part of the rounding to samples that edges of a step share, its own and that of the landings it is predicted
    from. ``*_edge_s`` is what no other measured edge shares, ``landing_scatter_s`` what rebounds that scatter add to
    their next landings.
    """

    opening_sigma_s: Floats
    landing_sigma_s: Floats
    opening_by_tone: Floats
    landing_by_tone: Floats
    opening_edge_s: Floats
    landing_edge_s: Floats
    landing_scatter_s: Floats
    changes: Changes  # what it is made of

    @property
    def landing_total_s(self) -> Floats:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.landing_sigma_s**2 + np.sum(self.landing_by_tone**2, axis=1)))

    @property
    def opening_total_s(self) -> Floats:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.opening_sigma_s**2 + np.sum(self.opening_by_tone**2, axis=1)))


def uncertainty_at(model: ForwardModel, values: Values, near: Changes | None = None) -> Uncertainty:
    """Uncertainty of the residuals of ``model`` at ``values``, from its memory where it was asked for before.

    With the changes of events at values ``near``, those events that have hardly moved keep theirs.
    """
    point = model.start(values)
    if near is not None:
        return _propagated(model, point, near)
    return model.memory.recall(("uncertainty", point.flying), lambda: _propagated(model, point))


def _propagated(model: ForwardModel, values: Values, near: Changes | None = None) -> Uncertainty:
    """Uncertainty of edges and plate, carried through the prediction."""
    ev, base = model.observations, model.predicted(values)
    tones, own = _tone_changes(model, values), np.stack([ev.opening_sigma_s, ev.landing_sigma_s], axis=1)
    found = _changes(model, values, tones, near)
    edges, changes, var = found.edges, found.changes, found.bent.copy()
    if (mode := model.measured_mode(model.inputs(values).rows)) is not None:
        lasting, own_part = forgotten(changes[len(tones) :], ev.measured.step, ev.measured.landing_s, mode.forgets)
        changes, var = np.concatenate([changes[: len(tones)], lasting]), var + own_part
    times = _from_exact_landings(model, base, edges)
    opening, landing = (
        rounding_errors(times[:, i], own[:, i], seen.sampling_s, seen.jitter_s)
        for i, seen in enumerate(ev.circuit.scatters)
    )
    # rounding errors are common to edges of a step and are carried separately: this is the rest
    independent = np.sqrt(own**2 - np.stack([np.sum(opening**2, axis=1), np.sum(landing**2, axis=1)], axis=1))
    var += independent**2
    scatter = model.per_step(values, "rebound_scatter")[ev.measured.step]
    if scatter.any():
        scatter = scatter * np.abs(slope_by_rebound(model, values))
    var[:, 1] += finite(base.ambiguity_s) ** 2 + scatter**2
    none = np.zeros_like(opening)
    shared = np.stack([np.hstack([opening, none]), np.hstack([none, landing])])
    for back, slope in enumerate(edges, start=1):  # what is predicted from an earlier landing errs with it
        var += (slope * _earlier(independent[:, 1], back)[:, None]) ** 2
        shared -= slope.T[:, :, None] * _earlier(np.hstack([none, landing]), back)
    sigma = np.sqrt(var)
    return Uncertainty(
        sigma[:, 0],
        sigma[:, 1],
        np.hstack([changes[..., 0].T, shared[0]]),
        np.hstack([changes[..., 1].T, shared[1]]),
        independent[:, 0],
        independent[:, 1],
        scatter,
        found,
    )


def _changes(model: ForwardModel, values: Values, tones: list[Complexes], near: Changes | None) -> Changes:
    """By how much events change with each number that they depend on; of some known already from ``near``."""
    ev, base, x, kicks = model.observations, model.predicted(values), model.inputs(values), kicks_of(model, values)
    again, plate, z = ev.measured.wanted & (base.kind >= 0), x.plate.acceleration_mps2, ev.steps.plate.acceleration_mps2
    width = plate.shape[1]  # a modulated plate has more tones than were measured
    moves = np.zeros((len(z), len(tones) + len(kicks), max(width, 2)), dtype=np.complex128)
    for i, by in enumerate(tones):  # an effect of the drive may change what is added to a tone
        moves[:, i, :width] = model.inputs(values, z + by).plate.acceleration_mps2 - plate
    for i, kick in enumerate(kicks, start=len(tones)):
        moves[:, i, :2] = kick
    at = np.stack([base.opening_s, base.landing_s, base.kind, base.hidden], axis=1)
    found = Changes.none(at, moves)
    # a plate mode that is not known as it moved rings on from flight to flight, what fades tell with it
    chained = active(x.rows, "plate_mode") and model.measured_mode(x.rows) is None
    if near is not None and not chained:
        again &= ~found.hold(near, again, at, ev.measured.step, ev.steps.plate.period_s[ev.measured.step])
    if again.any() and chained:
        found.fill(again, at, *Moves(model, values, again).one_by_one(tones, kicks))
    elif again.any():
        moved = [plate + moves[:, i, :width] for i in range(len(tones))]
        found.fill(again, at, *Moves(model, values, again).together(moved, kicks))
    return found


def slope_by_rebound(model: ForwardModel, values: Values) -> Floats:
    """Derivative of each predicted landing by the restitution of the impact before it, (n,), s; 0 without a rebound."""
    rows, base = model.rows(model.start(values)), model.predicted(values)
    if not np.any(rows[..., columns_of("rebound")] > 0.0):
        return np.zeros(len(model.observations))
    moved = rows.copy()
    moved[..., offsets()["restitution", "e0"]] += REBOUND_STEP
    slope = (model.predict(values, rows=moved, near=base).landing_s - base.landing_s) / REBOUND_STEP
    return np.where(np.abs(slope) < STEEPEST_BY_REBOUND_S, np.nan_to_num(slope), 0.0)


def kicks_of(model: ForwardModel, values: Values) -> Kicks:
    """One sigma of a plate mode's displacement and speed in a step: as recorded, or at its start half an impact's."""
    rows, place = model.inputs(values).rows, columns_of("plate_mode")
    if (mode := model.measured_mode(rows)) is not None:
        return (mode.error_mps / mode.omega_radps, 0.0), (0.0, mode.error_mps)
    rows = rows.reshape(-1, rows.shape[-1])
    if not rows[:, place].any():
        return ()
    row = rows[int(np.argmax(np.abs(rows[:, place[0]])))]  # where it is struck most: it may drift
    omega, _, ratio = plate_mode(row)
    # half a typical impact, in units of gravity times the period
    speed = 0.25 * ratio * model.gravity * float(np.median(model.observations.steps.plate.period_s))
    return (speed / omega, 0.0), (0.0, speed)


def _tone_changes(model: ForwardModel, values: Values) -> list[Complexes]:
    """One sigma of each number that the plate's measured tones depend on, as changes of the tones (m, k)."""
    steps, base = model.observations.steps, model.predicted(values)
    sigma = steps.sigma_mps2
    inexact = model.inexact(values) * np.abs(base.mode_amplitudes[:, : sigma.shape[1]])
    if (swings := model.modulation_at(values)) is not None:
        inexact = np.hypot(inexact, swings[0].leaking(steps.plate, *swings[1:]))
    wider = np.hypot(sigma, inexact) / np.where(sigma > 0.0, sigma, 1.0)
    spread, mode = steps.spread_mps2, model.measured_mode(model.inputs(values).rows)
    if mode is not None:  # what a tone was measured as does not matter where all of it is the mode's
        spread = np.where(mode.undriven[:, None, :], 0.0, spread)
    columns = np.flatnonzero(np.any(spread, axis=(0, 2)))
    return [wider[:, j // 2, None] * spread[:, j] for j in columns]


def _from_exact_landings(model: ForwardModel, base: Predicted, edges: Floats) -> Floats:
    """Openings and landings (n, 2) as predicted had no landing been rounded that a prediction leans on.

    A ball that leaves as it lands is predicted from the measured landing. Its rounding shifts what follows by the
    slopes ``edges`` (2, n, 2), and with it an edge's place between two samples.
    """
    ev, predicted = model.observations, np.stack([base.opening_s, base.landing_s], axis=1)
    out, sampling_s = predicted, ev.circuit.scatters[1].sampling_s
    # a rounded landing is carried on through so many flights that begin as the last one ends
    for _ in range(3):
        error = np.clip(np.nan_to_num(ev.measured.landing_s - out[:, 1]), -sampling_s, sampling_s)
        out = predicted - sum(slope * _earlier(error, back)[:, None] for back, slope in enumerate(edges, start=1))
    return np.asarray(out)


def forgotten(changes: Floats, step: Integers, time_s: Floats, rate: float) -> tuple[Floats, Floats]:
    """Changes by errors that are forgotten within a step, as changes by several that last, and what these leave.

    Two errors go together by ``exp(-rate time)`` of the time between them. Of that the four largest eigenvectors in
    each step carry the common part; the rest, a variance (n, 2), counts as each event's own.

    Parameters
    ----------
    changes
        Of openings and landings by one sigma of each error, (q, n, 2).
    step, time_s
        Of the flights, (n,).
    rate
        At which errors are forgotten, 1/s.
    """
    count = 4  # eight change the loss by 4 nats of 7,000
    out, common = np.zeros((count, *changes.shape)), np.zeros(len(step))
    for rows in (np.flatnonzero(step == s) for s in np.unique(step)):
        sizes, vectors = eigh(np.exp(-rate * np.abs(time_s[rows, None] - time_s[rows])))
        parts = (vectors * np.sqrt(np.maximum(sizes, 0.0)))[:, -count:]
        out[: parts.shape[1], :, rows] = parts.T[:, None, :, None] * changes[:, rows]
        common[rows] = np.sum(parts**2, axis=1)
    own = np.maximum(1.0 - common, 0.0)[:, None] * np.sum(changes**2, axis=0)
    return out.reshape(-1, *changes.shape[1:]), own


def _earlier(x: Floats, back: int) -> Floats:
    """The values of the event so many before, (n, ...); zero where there is none."""
    out = np.zeros_like(x)
    out[back:] = x[:-back]
    return out


def rounding_errors(time_s: Floats, sigma_s: Floats, sampling_s: float, jitter_s: float) -> Floats:
    """Errors of edges that edges at the same place between two samples share, of one sigma each.

    The place of the samples is unknown, so that the covariance of two errors is that of a sawtooth of random phase,
    ``T^2 cos(2 pi m d) / (2 pi^2 m^2)`` summed over its harmonics ``m``, for places that differ by ``d`` samples.
    Jitter of standard deviation ``J`` before the rounding makes it smaller by ``exp(-(2 pi m J / T)^2)``. Shape (n, 2 *
    HARMONICS), zero for edges that were not rounded.

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
    """
    if sampling_s == 0.0 or math.isinf(jitter_s):
        return np.zeros((len(time_s), 2 * HARMONICS))
    m = np.arange(1, HARMONICS + 1)
    own = np.isfinite(time_s) & rounded(sigma_s, sampling_s)
    turn = 2.0 * np.pi * m * np.where(own, np.mod(time_s / sampling_s, 1.0), 0.0)[:, None]
    damping = np.exp(-0.5 * (2.0 * np.pi * m * jitter_s / sampling_s) ** 2)
    size = sampling_s / (math.sqrt(2.0) * np.pi * m) * damping
    return np.asarray(np.where(own[:, None], np.hstack([size * np.cos(turn), size * np.sin(turn)]), 0.0))
