"""Penalised splines of missing terms, fitted to residuals one event ahead: first looks, cheap and without local minima.

The rule kept here: predictions are made once, on a grid of constant values of a term; every covariate is then tried on
that table, since a flight's residual depends on its own value alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from analysis.discovery.spline_basis import basis_of, hats_of
from analysis.discovery.terms import EVENT_GRIDS, FIRST_KNOTS, AugmentedModel, Curve, Term, event_term
from analysis.residuals.forward_model import ForwardModel, Values
from analysis.residuals.noise_model import excess_noise, log_odds, robust_loss, robust_weight
from analysis.thresholds import FARTHEST_PERIODS, LEAST_EXCESS_S

Array = NDArray[np.float64]

TAILS = (0.9, 0.8, 0.65)  # share of residuals that sets the width, pass by pass: from all of them
SHARP = (0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)  # to the middle
HALVINGS = 4
FAR_NATS, ENOUGH_NATS = 5.0, 0.2  # a step that gains more has led far; one that gains less is the last
START_SIZES: dict[str, Array] = {
    "force": np.concatenate([np.geomspace(0.05, 80.0, 7), -np.geomspace(0.05, 80.0, 7)]),
    "friction": np.geomspace(0.005, 2.0, 6),
    "restitution": np.geomspace(0.03, 0.9, 6),
}


@dataclass(frozen=True)
class StackedResiduals:
    """Openings, then landings, of the judged flights: arrays (k,).

    Attributes
    ----------
    event
        The flight.
    first
        True for openings.
    sigma_s, period_s
        Uncertainty without excess, and the forcing's period.
    train
        True where a fit may look.
    """

    event: NDArray[np.int64]
    first: NDArray[np.bool_]
    sigma_s: Array
    period_s: Array
    train: NDArray[np.bool_]

    @classmethod
    def of(cls, world: ForwardModel, values: Values, train: NDArray[np.bool_]) -> StackedResiduals:
        """Of a world; ``train`` by step."""
        ev, u = world.evidence, world.uncertainty(values)
        opening, landing = np.flatnonzero(world.from_rest), np.flatnonzero(ev.scored)
        event = np.concatenate([opening, landing])
        step = ev.measured.step[event]
        sigma = np.concatenate([u.opening_total_s[opening], u.landing_total_s[landing]])
        return cls(event, np.arange(len(event)) < len(opening), sigma, ev.steps.plate.period_s[step], train[step])

    def landings(self) -> StackedResiduals:
        """The landings alone: they know nothing of a contact's gap, which a wrong model bends to late openings."""
        rows = ~self.first
        return StackedResiduals(
            self.event[rows], self.first[rows], self.sigma_s[rows], self.period_s[rows], self.train[rows]
        )

    def without(self, rows: NDArray[np.bool_]) -> StackedResiduals:
        """The same with a fit that may not look at ``rows`` (k,)."""
        return replace(self, train=self.train & ~rows)

    def residuals(self, world: ForwardModel, values: Values) -> Array:
        """Of this stack, cut at the farthest."""
        p, measured = world.predict(values), world.evidence.measured
        return self.cut(measured.opening_s - p.opening_s, measured.landing_s - p.landing_s)

    def widths(self, r: Array, tail: float = 0.5) -> Array:
        """Uncertainty with an excess of each channel that fits the residual at the quantile ``tail``."""
        out = np.empty_like(r)
        for rows in (self.first, ~self.first):
            look = rows & self.train
            size = float(np.quantile(np.abs(r[look]), tail) / ndtri(0.5 + 0.5 * tail)) if look.any() else 0.0
            usual = float(np.median(self.sigma_s[look])) if look.any() else 0.0
            out[rows] = np.hypot(self.sigma_s[rows], max(np.sqrt(max(size**2 - usual**2, 0.0)), LEAST_EXCESS_S))
        return out

    def by_step(self, r: Array, step: NDArray[np.int64], m: int) -> Array:
        """Loss of each of ``m`` steps, each excess at its best on the steps of the fit; ``step`` by flight."""
        out = np.zeros(m)
        for rows in (self.first, ~self.first):
            look = rows & self.train
            if look.any():
                excess = excess_noise(r[look], self.sigma_s[look], self.period_s[look])[0]
                total = np.hypot(self.sigma_s[rows], excess)
                loss = robust_loss(r[rows] / total, log_odds(total, self.period_s[rows])) + np.log(total)
                out += np.bincount(step[self.event[rows]], loss, minlength=m)
        return out

    def cut(self, opening_s: Array, landing_s: Array) -> Array:
        """Residuals of this stack, from those of all flights (n,), cut at the farthest."""
        both = np.where(self.first, opening_s[self.event], landing_s[self.event])
        cap = FARTHEST_PERIODS * self.period_s
        return np.asarray(np.clip(np.where(np.isfinite(both), both, cap), -cap, cap))

    def loss(self, r: Array) -> float:
        """Loss of what is trained on, each channel's excess at its best."""
        total = 0.0
        for rows in (self.first & self.train, ~self.first & self.train):
            total += excess_noise(r[rows], self.sigma_s[rows], self.period_s[rows])[1]
        return total


@dataclass(frozen=True)
class ScreenedTerm:
    """A curve and its loss on the steps of the fit."""

    curve: Curve
    loss: float


def table_of(world: ForwardModel, values: Values, stack: StackedResiduals, name: str) -> Array:
    """Residuals (g, k) at each constant value of ``EVENT_GRIDS[name]``."""
    n = len(world.evidence)
    one, term = np.ones((n, 1)), event_term(name, "")
    still = np.zeros(n)
    rows = [
        stack.residuals(AugmentedModel(world, [Curve(term, np.zeros(1), np.array([x]), one)], still), values)
        for x in EVENT_GRIDS[name]
    ]
    return np.array(rows)


def constant_of(table: Array, stack: StackedResiduals, name: str) -> tuple[float, float]:
    """Best constant value and its loss."""
    losses = [stack.loss(r) for r in table]
    best = int(np.argmin(losses))
    return float(EVENT_GRIDS[name][best]), losses[best]


def try_covariate(table: Array, stack: StackedResiduals, term: Term, x: Array, knots: Array) -> ScreenedTerm:
    """Spline of one covariate on the table: the best value near each knot, then Gauss-Newton.

    Parameters
    ----------
    table, stack
        Of `table_of`.
    term, x, knots
        With the covariate's values (n,), and where the spline bends.
    """
    grid = EVENT_GRIDS[term.name]
    basis = basis_of(x, knots)
    near = hats_of(x, knots)[stack.event]
    values = np.full(len(knots), constant_of(table, stack, term.name)[0])
    weights = near * stack.train[:, None]
    for tail in TAILS:
        r, _ = _looked_up(table, grid, near @ values)
        width = stack.widths(r, tail)
        by_value = robust_loss(table / width, log_odds(width, stack.period_s)) @ weights
        values = grid[np.argmin(by_value, axis=0)]
    curve = Curve(term, knots, values, basis)
    return _descend(curve, stack, lambda c: _looked_up(table, grid, c.table[stack.event]), basis[stack.event])


def _looked_up(table: Array, grid: Array, value: Array) -> tuple[Array, Array]:
    """Residuals at each event's own value, and their slope."""
    i = np.clip(np.searchsorted(grid, value) - 1, 0, len(grid) - 2)
    k = np.arange(table.shape[1])
    slope = (table[i + 1, k] - table[i, k]) / (grid[i + 1] - grid[i])
    return table[i, k] + slope * (value - grid[i]), slope


def _descend(
    curve: Curve, stack: StackedResiduals, look: Callable[[Curve], tuple[Array, Array]], near: Array
) -> ScreenedTerm:
    """Gauss-Newton on the penalised robust loss; ``look`` gives residuals and their slope along each event's value."""
    r, slope = look(curve)
    for tail in (*TAILS[1:], *SHARP):
        step = newton_step(curve, stack, r, slope[:, None] * near, tail)
        width = stack.widths(r, tail)
        now, gained = _penalised(curve, stack, r, width), 0.0
        for half in range(HALVINGS):
            moved = curve.moved(curve.values + 0.5**half * step)
            r_moved, slope_moved = look(moved)
            gained = now - _penalised(moved, stack, r_moved, width)
            if gained > 0.0:
                curve, r, slope = moved, r_moved, slope_moved
                break
        if gained < ENOUGH_NATS and tail == SHARP[0]:
            break
    return ScreenedTerm(curve, stack.loss(r))


def penalty_weight(curve: Curve) -> float:
    """Weight of the penalty for a curve of this spread; with more knots than usual each may bend less."""
    values, least = curve.values, 10.0 * curve.term.nudge
    rough = curve.roughness * min(1.0, (FIRST_KNOTS - 1) / max(len(values) - 1, 1))
    return 1.0 / (rough * max(float(np.ptp(values)), 0.3 * float(np.max(np.abs(values), initial=0.0)), least)) ** 2


def newton_step(curve: Curve, stack: StackedResiduals, r: Array, jacobian: Array, tail: float = 0.5) -> Array:
    """Step of the curve's values that lowers the penalised robust loss, to second order."""
    width = stack.widths(r, tail)
    z, j = r / width, jacobian / width[:, None]
    weight = np.where(stack.train, robust_weight(z, log_odds(width, stack.period_s)), 0.0)
    pull = penalty_weight(curve) * curve.penalty
    normal = (j * weight[:, None]).T @ j + pull
    normal += 1e-6 * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(normal))
    return np.asarray(np.linalg.lstsq(normal, -(j.T @ (weight * z)) - pull @ curve.values, rcond=1e-10)[0])


def _penalised(curve: Curve, stack: StackedResiduals, r: Array, width: Array) -> float:
    z, odds = r / width, log_odds(width, stack.period_s)
    bend = curve.values @ curve.penalty @ curve.values
    data = float(np.sum(robust_loss(z, odds)[stack.train]))
    return data + 0.5 * penalty_weight(curve) * float(bend)


def best_start(world: ForwardModel, values: Values, stack: StackedResiduals, curve: Curve, dwell_s: Array) -> Curve:
    """``curve`` or a plain shape of some size in its place, whichever predicts best.

    A strong term sends flights to other landings than a weak one: a descent from nothing ends in between. The shapes
    are even, proportional to the covariate, to its square, and falling to nothing.
    """
    x = curve.knots / float(np.max(np.abs(curve.knots)))
    falls = (curve.knots[-1] - curve.knots) / (curve.knots[-1] - curve.knots[0])
    unit = world.gravity if curve.term.against_motion else 1.0
    sizes = unit * START_SIZES[curve.term.name]
    shapes = (np.ones_like(x), x, x * np.abs(x), falls)
    starts = [curve, *(curve.moved(size * shape) for shape in shapes for size in sizes)]
    losses = [stack.loss(stack.residuals(AugmentedModel(world, [c], dwell_s), values)) for c in starts]
    return starts[int(np.argmin(losses))]


def try_in_flight(
    world: ForwardModel, values: Values, stack: StackedResiduals, start: Curve, dwell_s: Array, tails: Sequence[float]
) -> ScreenedTerm:
    """Gauss-Newton by predictions, a pass for each of ``tails``; slopes are taken anew where a step has led far.

    It ends early where a step gains nothing and the tail stays as it is.
    """
    curve, jacobian, gained = start, np.zeros((0, 0)), np.inf
    r = stack.residuals(AugmentedModel(world, [curve], dwell_s), values)
    for i, tail in enumerate(tails):
        fresh = gained > FAR_NATS
        if fresh:
            jacobian = slopes_of(world, values, stack, curve, dwell_s, r)
        step, width = newton_step(curve, stack, r, jacobian, tail), stack.widths(r, tail)
        now, gained = _penalised(curve, stack, r, width), 0.0
        for half in range(HALVINGS):
            moved = curve.moved(curve.values + 0.5**half * step)
            r_moved = stack.residuals(AugmentedModel(world, [moved], dwell_s), values)
            gained = now - _penalised(moved, stack, r_moved, width)
            if gained > 0.0:
                curve, r = moved, r_moved
                break
        if gained < ENOUGH_NATS:
            if fresh and set(tails[i:]) == {tail}:
                break
            gained = np.inf
    return ScreenedTerm(curve, stack.loss(r))


def slopes_of(
    world: ForwardModel, values: Values, stack: StackedResiduals, curve: Curve, dwell_s: Array, r: Array
) -> Array:
    """Derivatives of the stacked residuals by the curve's values, (k, knots): one prediction if each flight has one."""
    nudge = curve.term.nudge
    if curve.term.columns:
        moved = replace(curve, values=curve.values + nudge)
        along = (stack.residuals(AugmentedModel(world, [moved], dwell_s), values) - r) / nudge
        return np.asarray(along[:, None] * curve.basis[stack.event])
    out = np.empty((len(r), len(curve.values)))
    for i in range(len(curve.values)):
        values_moved = curve.values.copy()
        values_moved[i] += nudge
        moved = replace(curve, values=values_moved)
        out[:, i] = (stack.residuals(AugmentedModel(world, [moved], dwell_s), values) - r) / nudge
    return out


def covariance_of(curve: Curve, stack: StackedResiduals, r: Array, jacobian: Array) -> Array:
    """Covariance of the curve's values at its knots, (k, k)."""
    width = stack.widths(r)
    weight = np.where(stack.train, robust_weight(r / width, log_odds(width, stack.period_s)), 0.0) / width**2
    normal = (jacobian * weight[:, None]).T @ jacobian + penalty_weight(curve) * curve.penalty
    return np.asarray(np.linalg.pinv(normal, rcond=1e-14))
