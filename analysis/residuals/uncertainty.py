"""Uncertainty of predicted events: that of edges and of the plate's tones, carried through the prediction.

Derivatives of the prediction carry it, without another flight. Events whose second order is not small (near grazes,
tangent take-offs), or that have no derivative, are flown anew with each number moved by one standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.residuals.plate_mode import INEXACT
from model.integrator.one_step import Slopes

if TYPE_CHECKING:
    from analysis.residuals.forward_model import ForwardModel, Values

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE_STEP_S = 2e-6  # finite difference of an edge
STEEPEST = 30.0  # clip of the derivative of an event by an earlier landing
LARGEST_CHANGE_S = 5e-3  # a larger change means another event; it counts as none
BENT = 0.2  # second order over an event's own uncertainty, beyond which it is flown anew
NEAR_SWITCH = 4.0  # changes within which a ball that leaves at once might rest before, or the reverse
SHORT_S = 2e-3  # flights that a small change may hide from the contact circuit
BEFORE = 3  # events before one that is flown anew, on which an elastic ball's prediction leans


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of opening and landing residuals at one point; arrays (n,), tones (n, q).

    ``*_sigma_s`` is that of the edges, propagated; ``*_by_tone`` the change for one sigma of each quadrature of each
    plate tone of the event's step, and of the initial state of a plate mode in the step.
    """

    opening_sigma_s: Array
    landing_sigma_s: Array
    opening_by_tone: Array
    landing_by_tone: Array

    @property
    def landing_total_s(self) -> Array:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.landing_sigma_s**2 + np.sum(self.landing_by_tone**2, axis=1)))

    @property
    def opening_total_s(self) -> Array:
        """With the plate's share, (n,)."""
        return np.asarray(np.sqrt(self.opening_sigma_s**2 + np.sum(self.opening_by_tone**2, axis=1)))


def uncertainty_at(model: ForwardModel, values: Values) -> Uncertainty:
    """Uncertainty of the residuals of ``model`` at ``values``."""
    ev, base = model.evidence, model.predicted(values)
    moves = _moves(model, values)
    nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
    x, slopes = model.slopes(values, *nothing)
    step, before = ev.measured.step, np.stack([_earlier(ev.landing_sigma_s, back) for back in (1, 2)])
    kicks = [np.zeros(2)] * (len(moves) - len(model.kicks(values))) + [np.array(k) for k in model.kicks(values)]
    linear = []
    for (there, _), kick in zip(moves, kicks, strict=True):
        moved = model.inputs(values, there["tones"]).plate if "tones" in there else x.plate
        linear.append(by_tones(slopes, moved.acceleration_mps2 - x.plate.acceleration_mps2, step) + slopes.kick @ kick)
    changes = np.array(linear).reshape(len(moves), len(ev), 2)
    edges = np.stack([np.clip(s, -STEEPEST, STEEPEST) for s in (slopes.landing, slopes.landing_before)])
    bent = second_order(slopes, changes)
    own = np.stack([ev.opening_sigma_s, ev.landing_sigma_s], axis=1)
    again = (
        ev.measured.wanted & (base.kind >= 0) & _doubtful(slopes, changes, bent, own, base.landing_s - base.takeoff_s)
    )
    if ev.measured.share is not None:
        again |= ev.measured.wanted & (ev.measured.share > 0.0)
    if again.any():
        _fly_again(model, values, moves, again, edges, changes, bent)
    var = own**2 + np.sum(bent**2, axis=0) + np.sum((edges * before[..., None]) ** 2, axis=0)
    var[:, 1] += _finite(base.ambiguity_s) ** 2
    return Uncertainty(np.sqrt(var[:, 0]), np.sqrt(var[:, 1]), changes[..., 0].T, changes[..., 1].T)


def by_tones(slopes: Slopes, change_mps2: NDArray[np.complex128], step: NDArray[np.int64]) -> Array:
    """Changes of openings and landings, (n, 2), for changes (m, k) of the plate's tones."""
    parts = np.stack([change_mps2.real, change_mps2.imag], axis=-1)[step]
    return np.asarray(np.einsum("nckp,nkp->nc", slopes.tones, parts))


def second_order(slopes: Slopes, changes: Array) -> Array:
    """Size of the second order of changes (q, n, 2) of openings and landings.

    A landing's is that of a fall at the relative acceleration and velocity of the impact; a take-off's that of what
    throws the ball, which the flight carries on.
    """
    _, rate, bend, lasts, acceleration, velocity, _ = slopes.info.T
    speed = np.where(velocity < 0.0, -velocity, np.inf)
    opening, landing = changes[..., 0] ** 2, changes[..., 1] ** 2
    late = np.abs(bend) * opening
    return np.stack([late, (0.5 * np.abs(acceleration) * landing + 0.5 * rate * lasts * opening) / speed], axis=-1)


def _doubtful(slopes: Slopes, changes: Array, bent: Array, own: Array, lasts_s: Array) -> Mask:
    """Events whose derivatives do not tell what a change of one sigma does, (n,)."""
    most = np.max(np.abs(changes), axis=0, initial=0.0)
    out = (slopes.info[:, 0] == 0.0) | np.any(np.max(bent, axis=0, initial=0.0) > BENT * own, axis=1)
    out |= np.max(most, axis=1) > LARGEST_CHANGE_S / NEAR_SWITCH
    out |= slopes.info[:, 6] < NEAR_SWITCH * np.maximum(most[:, 0], own[:, 0])
    return np.asarray(out | ~(lasts_s > SHORT_S))


def _moves(model: ForwardModel, values: Values) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """One sigma of each number of the plate, either way, as `ForwardModel.predict` takes it."""
    steps, base = model.evidence.steps, model.predicted(values)
    sigma = steps.sigma_mps2
    inexact = INEXACT * np.abs(base.mode_amplitudes[:, : sigma.shape[1]])
    if (swings := model.modulation_at(values)) is not None:
        inexact = np.hypot(inexact, swings[0].leaking(steps.plate, *swings[1:]))
    wider = np.hypot(sigma, inexact) / np.where(sigma > 0.0, sigma, 1.0)
    moves: list[tuple[dict[str, Any], dict[str, Any]]] = []
    for j in np.flatnonzero(np.any(steps.spread_mps2, axis=(0, 2))):
        by = wider[:, j // 2, None] * steps.spread_mps2[:, j]
        z = steps.plate.acceleration_mps2
        moves.append(({"tones": z + by}, {"tones": z - by}))
    moves += [({"kick": kick}, {"kick": (-kick[0], -kick[1])}) for kick in model.kicks(values)]
    return moves


def _fly_again(
    model: ForwardModel,
    values: Values,
    moves: list[tuple[dict[str, Any], dict[str, Any]]],
    again: Mask,
    edges: Array,
    changes: Array,
    bent: Array,
) -> None:
    """Overwrite derivatives by edges and changes of the events ``again`` with differences of predictions."""
    base = model.predicted(values)
    wanted = again.copy()
    for back in range(1, BEFORE + 1):
        wanted[:-back] |= again[back:]
    for moved, rows in model.moved_landings(values, np.full(len(again), EDGE_STEP_S), wanted):
        for back in (1, 2):
            own = again & rows[back]
            both = np.stack([moved.opening_s - base.opening_s, moved.landing_s - base.landing_s], axis=1)
            edges[back - 1, own] = edge_slope(both[own])
    for q, (there, back_again) in enumerate(moves):
        ahead, behind = (model.predict(values, **x, near=base, wanted=wanted) for x in (there, back_again))
        for c, name in enumerate(("opening_s", "landing_s")):
            a, b, here = (getattr(p, name)[again] for p in (ahead, behind, base))
            changes[q, again, c] = _finite(0.5 * (a - b))
            bent[q, again, c] = _finite(0.5 * (a + b) - here)  # the second order counts as noise of each event


def _earlier(x: Array, back: int) -> Array:
    """The value of the event so many before, (n,)."""
    return np.asarray(np.where(np.arange(len(x)) >= back, x[np.maximum(np.arange(len(x)) - back, 0)], 0.0))


def _finite(x: Array) -> Array:
    return np.where(np.abs(x) < LARGEST_CHANGE_S, np.nan_to_num(x), 0.0)


def edge_slope(difference: Array) -> Array:
    """Derivative from the change of an event with a landing moved by `EDGE_STEP_S`."""
    return np.clip(np.nan_to_num(difference) / EDGE_STEP_S, -STEEPEST, STEEPEST)
