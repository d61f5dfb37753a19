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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.events.edge_jitter import rounded
from analysis.linear_algebra import eigh
from analysis.residuals.forward_model import ForwardModel, Inputs
from analysis.residuals.plate_data.measured_mode import MeasuredMode
from analysis.residuals.values import Values
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.effects.registry import offsets
from model.integrator.one_step import Predicted, driven, one_ahead
from model.integrator.problem import Measured, PlateSteps, active, columns_of, plate_mode

Kicks = tuple[tuple[float, float], ...]

EDGE_STEP_S = 2e-6  # finite difference of an edge
STEEPEST = 30.0  # clip of the derivative of an event by an earlier landing
REBOUND_STEP = 1e-4  # finite difference of a restitution
STEEPEST_BY_REBOUND_S = 1.0  # a flight at 5 m/s lasts so long; a larger slope means another event
LARGEST_CHANGE_S = 5e-3  # a larger change means another event; it counts as none
HARMONICS = 4  # of the sawtooth of rounding; the rest, a tenth of its variance, counts as each edge's own
BEFORE = 3  # events before one on which an elastic ball's prediction depends


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

    @property
    def landing_total_s(self) -> Floats:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.landing_sigma_s**2 + np.sum(self.landing_by_tone**2, axis=1)))

    @property
    def opening_total_s(self) -> Floats:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.opening_sigma_s**2 + np.sum(self.opening_by_tone**2, axis=1)))


def uncertainty_at(model: ForwardModel, values: Values) -> Uncertainty:
    """Uncertainty of the residuals of ``model`` at ``values``, from its memory where it was asked for before."""
    point = model.start(values)
    return model.memory.recall(("uncertainty", point.flying), lambda: _propagated(model, point))


def _propagated(model: ForwardModel, values: Values) -> Uncertainty:
    """Uncertainty of edges and plate, carried through the prediction."""
    ev, base = model.observations, model.predicted(values)
    tones, kicks = _tone_changes(model, values), kicks_of(model, values)
    own = np.stack([ev.opening_sigma_s, ev.landing_sigma_s], axis=1)
    again = ev.measured.wanted & (base.kind >= 0)
    shape = (len(tones) + len(kicks), len(ev), 2)
    edges, changes, bent = np.zeros((2, len(ev), 2)), np.zeros(shape), np.zeros(shape)
    if again.any():
        moves = _Moves(model, values, again)
        rows = model.inputs(values).rows
        # a plate mode that is not known as it moved rings on from flight to flight, what fades tell with it
        chained = active(rows, "plate_mode") and model.measured_mode(rows) is None
        found = moves.one_by_one(tones, kicks) if chained else moves.together(tones, kicks)
        edges[:, again], changes[:, again], bent[:, again] = found
    var = np.sum(bent**2, axis=0)
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
    var[:, 1] += _finite(base.ambiguity_s) ** 2 + scatter**2
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
    )


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


@dataclass(frozen=True)
class _Moves:
    """Events ``again`` (n,) predicted with each number moved by one sigma, and each landing by `EDGE_STEP_S`.

    Derivatives by the landing before and the one before that, (2, r, 2), changes by each number, (q, r, 2), and their
    second orders; r events, openings and landings.
    """

    model: ForwardModel
    values: Values
    again: Bools

    def one_by_one(self, tones: list[Complexes], kicks: Kicks) -> tuple[Floats, Floats, Floats]:
        """Each move a prediction of its own: a plate mode rings on from flight to flight."""
        model, z = self.model, self.model.observations.steps.plate.acceleration_mps2
        base = model.predicted(self.values)
        edges = np.zeros((2, int(self.again.sum()), 2))
        for moved, rows in model.moved_landings(self.values, np.full(len(self.again), EDGE_STEP_S), self.again):
            for back in (1, 2):
                own = rows[back][self.again]
                edges[back - 1, own] = edge_slope(self._events(moved) - self._events(base))[own]
        moves: list[tuple[dict[str, Any], dict[str, Any]]] = [({"tones": z + by}, {"tones": z - by}) for by in tones]
        moves += [({"kick": kick}, {"kick": (-kick[0], -kick[1])}) for kick in kicks]
        sides = [
            [self._events(model.predict(self.values, **x, near=base, wanted=self.again)) for x in pair]
            for pair in moves
        ]
        ahead, behind = np.moveaxis(np.array(sides).reshape(len(moves), 2, -1, 2), 1, 0)
        return edges, *_halves(ahead, behind, self._events(base))

    def _events(self, p: Predicted) -> Floats:
        return np.stack([p.opening_s[self.again], p.landing_s[self.again]], axis=1)

    def together(self, changes: list[Complexes], kicks: Kicks) -> tuple[Floats, Floats, Floats]:
        """All moves in one prediction, of copies of the flights that the events depend on."""
        n, measured, x = len(self.again), self.model.observations.steps.plate, self.model.inputs(self.values)
        # an effect of the drive may change what is added to a tone
        moved = [
            self.model.inputs(self.values, measured.acceleration_mps2 + by).plate.acceleration_mps2 for by in changes
        ]
        few = self.again.copy()
        for back in range(1, BEFORE + 1):
            few[:-back] |= self.again[back:]
        index = np.flatnonzero(few)
        z = x.plate.acceleration_mps2
        first, q = 1 + 2 * len(moved), len(moved) + len(kicks)
        plates = [z, *moved, *(2.0 * z - y for y in moved), *[z] * (2 * len(kicks) + 3)]
        shifts = np.zeros((len(plates), n))
        for colour in range(3):
            shifts[len(plates) - 3 + colour, colour::3] = EDGE_STEP_S
        if (mode := self.model.measured_mode(x.rows)) is not None:
            seen = mode.read(self.model.reading(self.values, without="accelerometer_high_pass"))
            plates = [driven(replace(x.plate, acceleration_mps2=y), seen.mode_amplitudes) for y in plates]
            state = np.tile(mode.state, (len(plates), 1, 1))
            for i, kick in enumerate(kicks):
                state[first + i], state[first + len(kicks) + i] = mode.kicked(kick), mode.kicked((-kick[0], -kick[1]))
            # its part has been taken out of the tones
            nothing = np.zeros((len(plates) * len(z), seen.mode_amplitudes.shape[1]), dtype=np.complex128)
            mode = replace(mode, state=state, mode_amplitudes=nothing)
        found = _copies(self.model, x, plates, shifts, index, self.again, mode)[:, self.again[index]]
        base, at = found[0], np.flatnonzero(self.again)
        edges = np.stack([found[1 + 2 * q + (at - back) % 3, np.arange(len(at))] - base for back in (1, 2)])
        ahead, behind = (
            np.concatenate([found[1 + i * len(moved) :][: len(moved)], found[first + i * len(kicks) :][: len(kicks)]])
            for i in (0, 1)
        )
        return edge_slope(edges), *_halves(ahead, behind, base)


def _copies(
    model: ForwardModel, x: Inputs, tones: Sequence[Complexes], shift_s: Floats, events: Integers, wanted: Bools,
    mode: MeasuredMode | None,
) -> Floats:  # fmt: skip
    """Openings and landings (q, e, 2) of ``events`` (e,) in q copies with other tones (m, k) and landings.

    ``shift_s`` (q, n) is added to landings; only events ``wanted`` (n,) are predicted. A plate ``mode`` is known as it
    moved, with states (q, n, 4 or 8) and no part in ``tones``: what rings on from flights that are left out is in them.
    """
    q, e, seen, d = len(tones), len(events), model.measured_at(x, wanted), model.detection_at(x)
    m = len(x.plate.period_s)
    copy = np.repeat(np.arange(q), e)
    follows = np.diff(events, prepend=-2) == 1

    def each(values: Any) -> Any:
        return np.tile(np.asarray(values)[events], q)

    def perhaps(values: Floats | None) -> Floats | None:
        return None if values is None else np.asarray(each(values))

    measured = Measured(
        each(seen.opening_s), (seen.landing_s + shift_s)[:, events].ravel(), each(seen.relaunched),
        each(seen.linked) & np.tile(follows, q), each(seen.step) + m * copy, each(seen.wanted),
        None if seen.other_step is None else np.where(each(seen.other_step) >= 0, each(seen.other_step) + m * copy, -1),
        perhaps(seen.share), perhaps(seen.gained_mps), perhaps(seen.pressed_mps), perhaps(seen.pressed_at),
        perhaps(seen.part), perhaps(seen.ahead_s), None if mode is None else mode.state[:, events].reshape(q * e, -1),
    )  # fmt: skip
    plate = PlateSteps(
        np.tile(x.plate.omega_radps, (q, 1)), np.concatenate(tones), np.tile(x.plate.period_s, q), x.plate.derived
    )
    rows = x.rows if x.rows.ndim == 1 else np.tile(x.rows[events], (q, 1))
    circuit = replace(d, gap_m=each(d.gap_m), weak_mps=each(d.weak_mps))
    p = one_ahead(measured, plate, rows, circuit, mode=mode)
    return np.stack([p.opening_s, p.landing_s], axis=1).reshape(q, e, 2)


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


def _halves(ahead: Floats, behind: Floats, base: Floats) -> tuple[Floats, Floats]:
    """First and second order of changes from predictions either way; the second counts as noise of each event."""
    return _finite(0.5 * (ahead - behind)), _finite(0.5 * (ahead + behind) - base)


def _earlier(x: Floats, back: int) -> Floats:
    """The values of the event so many before, (n, ...); zero where there is none."""
    out = np.zeros_like(x)
    out[back:] = x[:-back]
    return out


def _finite(x: Floats) -> Floats:
    return np.where(np.abs(x) < LARGEST_CHANGE_S, np.nan_to_num(x), 0.0)


def edge_slope(difference: Floats) -> Floats:
    """Derivative from the change of an event with a landing moved by `EDGE_STEP_S`."""
    return np.clip(np.nan_to_num(difference) / EDGE_STEP_S, -STEEPEST, STEEPEST)


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
