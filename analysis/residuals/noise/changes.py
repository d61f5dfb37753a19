"""Changes of events by one sigma of each number that they depend on, and which of them hold at other values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.residuals.forward_model import ForwardModel, Inputs
from analysis.residuals.plate_data.measured_mode import MeasuredMode
from analysis.residuals.values import Values
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.integrator.one_step import Predicted, driven, one_ahead
from model.integrator.problem import Measured, PlateSteps

Kicks = tuple[tuple[float, float], ...]

EDGE_STEP_S = 2e-6  # finite difference of an edge
STEEPEST = 30.0  # clip of the derivative of an event by an earlier landing
LARGEST_CHANGE_S = 5e-3  # a larger change means another event; it counts as none
BEFORE = 3  # events before one on which an elastic ball's prediction depends


@dataclass(frozen=True)
class Changes:
    """Changes of n events by each of q numbers, and where they were found; decision 754."""

    at: Floats  # predicted opening and landing there, s, kind and hidden flights, (n, 4); NaN: they hold nowhere else
    moves: Complexes  # one sigma of each number in each step, (m, q, k)
    edges: Floats  # derivatives of openings and landings by the landing before, and the one before that, (2, n, 2)
    changes: Floats  # (q, n, 2)
    bent: Floats  # sum of the squares of the second orders, (n, 2)
    bend: Floats  # relative change of the changes where an event is a second earlier or later, (n, 2)

    @classmethod
    def none(cls, at: Floats, moves: Complexes) -> Changes:
        """No event has changed yet."""
        n, q = len(at), moves.shape[1]
        return cls(np.full_like(at, np.nan), moves, np.zeros((2, n, 2)), np.zeros((q, n, 2)), *np.zeros((2, n, 2)))

    def fill(self, rows: Bools, at: Floats, found: tuple[Floats, Floats, Floats], sound: Bools) -> None:
        """Take derivatives, changes and second orders that were found of the events in ``rows``; those hold elsewhere
        that are ``sound``, of the same flight whichever number moves."""
        self.edges[:, rows], self.changes[:, rows], second = found
        self.bent[rows] = np.sum(second**2, axis=0)
        squares = np.sqrt(np.sum(self.changes[:, rows] ** 4, axis=0))
        # near a graze, second orders are as the squares of the first
        np.divide(2.0 * np.sqrt(self.bent[rows]), squares, out=squares, where=squares > 0.0)
        self.bend[rows] = squares
        self.at[rows] = np.where(sound[:, None], at[rows], np.nan)

    def hold(self, near: Changes, rows: Bools, at: Floats, step: Integers, period_s: Floats) -> Bools:
        """Take those of ``rows`` that hold here from elsewhere; which ones these are, (n,)."""
        holds = 0.002  # change of a change, relative, that does not count
        if near.moves.shape != self.moves.shape:
            return np.zeros(len(at), dtype=np.bool_)
        alike = np.linalg.norm(self.moves - near.moves, axis=2) <= holds * np.linalg.norm(near.moves, axis=2)
        still = alike.all(axis=1)
        self.moves[still] = near.moves[still]  # what is held again and again is compared with where it was found
        shift = np.abs(at - near.at)
        # farther off, changes may have changed by more than their bend foretells
        same = (shift[:, :2] <= 2e-4 * period_s[:, None]) & (near.bend * shift[:, :2] <= holds)
        held: Bools = rows & still[step] & same.all(axis=1) & (shift[:, 2:] == 0.0).all(axis=1)
        for mine, other in ((self.at, near.at), (self.bent, near.bent), (self.bend, near.bend)):
            mine[held] = other[held]
        self.edges[:, held], self.changes[:, held] = near.edges[:, held], near.changes[:, held]
        return held


@dataclass(frozen=True)
class Moves:
    """Events ``again`` (n,) predicted with each number moved by one sigma, and each landing by `EDGE_STEP_S`.

    Derivatives by the landing before and the one before that, (2, r, 2), changes by each number, (q, r, 2), and their
    second orders; r events, openings and landings.
    """

    model: ForwardModel
    values: Values
    again: Bools

    def one_by_one(self, tones: list[Complexes], kicks: Kicks) -> tuple[tuple[Floats, Floats, Floats], Bools]:
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
        return (edges, *_halves(ahead, behind, self._events(base))), np.zeros(len(edges[0]), dtype=np.bool_)

    def _events(self, p: Predicted) -> Floats:
        return np.stack([p.opening_s[self.again], p.landing_s[self.again]], axis=1)

    def together(self, moved: list[Complexes], kicks: Kicks) -> tuple[tuple[Floats, Floats, Floats], Bools]:
        """All moves in one prediction, of copies of the flights that the events depend on; over ``moved`` tones.

        Most events are nearly linear in what moves: tones are moved one way, and the other way where that tells most.
        An event's second orders are as the squares of its first ones; events that bend more are moved either way.
        """
        q, k, still = len(moved), len(kicks), (0.0, 0.0)
        z = self.model.inputs(self.values).plate.acceleration_mps2
        back = [(-kick[0], -kick[1]) for kick in kicks]
        found = self._flown([z, *moved, *[z] * (2 * k + 3)], [*[still] * (1 + q), *kicks, *back, *[still] * 3], 3)
        base, at = found[0], np.flatnonzero(self.again)
        edges = np.stack([found[len(found) - 3 + (at - i) % 3, np.arange(len(at))] - base for i in (1, 2)])
        ahead, behind = found[1 : 1 + q + k], np.concatenate([found[1 : 1 + q], found[1 + q + k : 1 + q + 2 * k]])
        bent = np.ones(len(at), dtype=np.bool_)
        if q > 6:
            bend, bent = self._bends(moved, one_way := ahead[:q] - base, base)
            slopes = 2.0 * one_way / (1.0 + np.sqrt(np.maximum(1.0 + 4.0 * bend * one_way, 0.0)))
            behind[:q] = base + bend * slopes**2 - slopes
        if bent.any():
            again = np.zeros_like(self.again)
            again[at[bent]] = True
            behind[:q, bent] = replace(self, again=again)._flown([2.0 * z - y for y in moved], [still] * q)
        sound = (np.abs(np.concatenate([ahead, behind]) - base) < LARGEST_CHANGE_S).all(axis=(0, 2))
        sound &= (np.abs(edges) < STEEPEST * EDGE_STEP_S).all(axis=(0, 2))
        return (edge_slope(edges), *_halves(ahead, behind, base)), sound

    def _bends(self, moved: list[Complexes], one_way: Floats, base: Floats) -> tuple[Floats, Bools]:
        """Second orders over the squares of the first, (r, 2), of changes ``one_way`` (q, r, 2), and events that these
        two numbers do not tell it of which move most in a step: moved either way, they bend by .03 or hardly move."""
        z, least = self.model.inputs(self.values).plate.acceleration_mps2, 0.03
        step, places = self.model.observations.measured.step[self.again], np.arange(one_way.shape[1])
        sizes = np.where(np.abs(one_way) < LARGEST_CHANGE_S, one_way, 0.0) ** 2
        most = np.argsort([-np.bincount(step, x, len(z)) for x in sizes.sum(axis=2)], axis=0)[:2]  # (2, m)
        back = [2.0 * z - np.array(moved)[j, np.arange(len(z))] for j in most]
        mine, other_way = one_way[most[:, step], places], self._flown(back, [(0.0, 0.0)] * 2) - base
        first, second = 0.5 * (mine - other_way), 0.5 * (mine + other_way)
        bend = np.sum(second * first**2, axis=0) / np.maximum(np.sum(first**4, axis=0), 1e-99)
        largest = np.max(np.abs(one_way), axis=0)
        shown = (np.sum(first**2, axis=0) > 0.05 * largest**2) | (largest < 1e-12)
        straight = shown & (np.abs(np.sqrt(np.maximum(1.0 + 4.0 * bend * one_way, 0.0)) - 1.0) < least).all(axis=0)
        straight &= (np.abs(second) <= least * np.max(np.abs(first), axis=0)).all(axis=0)
        return bend, ~straight.all(axis=1)

    def _flown(self, plates: list[Complexes], kicks: Sequence[tuple[float, float]], shifted: int = 0) -> Floats:
        """Openings and landings of the events, (p, r, 2), over each of ``plates`` (m, k) with a kick to the mode.

        In the last ``shifted`` every third landing, another one each time, comes `EDGE_STEP_S` later.
        """
        x, few = self.model.inputs(self.values), self.again.copy()
        for back in range(1, BEFORE + 1):
            few[:-back] |= self.again[back:]
        index = np.flatnonzero(few)
        shifts = np.zeros((len(plates), len(self.again)))
        for colour in range(shifted):
            shifts[len(plates) - shifted + colour, colour::3] = EDGE_STEP_S
        if (mode := self.model.measured_mode(x.rows)) is not None:
            seen = mode.read(self.model.reading(self.values, without="accelerometer_high_pass"))
            # its part has been taken out of the tones
            nothing = np.zeros((sum(map(len, plates)), seen.mode_amplitudes.shape[1]), dtype=np.complex128)
            plates = [driven(replace(x.plate, acceleration_mps2=y), seen.mode_amplitudes) for y in plates]
            state = np.stack([mode.kicked(kick) if any(kick) else mode.state for kick in kicks])
            mode = replace(mode, state=state, mode_amplitudes=nothing)
        return _copies(self.model, x, plates, shifts, index, self.again, mode)[:, self.again[index]]


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


def _halves(ahead: Floats, behind: Floats, base: Floats) -> tuple[Floats, Floats]:
    """First and second order of changes from predictions either way; the second counts as noise of each event."""
    return finite(0.5 * (ahead - behind)), finite(0.5 * (ahead + behind) - base)


def finite(x: Floats) -> Floats:
    """Changes of events, none where it became another one."""
    return np.where(np.abs(x) < LARGEST_CHANGE_S, np.nan_to_num(x), 0.0)


def edge_slope(difference: Floats) -> Floats:
    """Derivative from the change of an event with a landing moved by `EDGE_STEP_S`."""
    return np.clip(np.nan_to_num(difference) / EDGE_STEP_S, -STEEPEST, STEEPEST)
