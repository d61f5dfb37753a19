"""Penalised splines of missing terms, fitted to one-step-ahead residuals by Gauss-Newton.

A term with one value for each flight is screened on a table of predictions at constant values: a flight's residual
depends only on its own value, so that every covariate can use the same table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.discovery.descent import Penalty, Problem, StackedResiduals, descend, normal_equations
from analysis.discovery.terms import (
    EVENT_GRIDS,
    FIRST_KNOTS,
    AugmentedModel,
    Curve,
    Term,
    basis_of,
    event_term,
    hat_functions,
)
from analysis.linear_algebra import pinv
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import log_odds, robust_loss
from analysis.residuals.values import Values
from kernels.arrays import Floats

TAILS = (0.9, 0.8, 0.65)  # quantiles of the residuals that set the robust width in the first passes
SHARP = (0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)  # the same in the last passes: the median
START_SIZES: dict[str, Floats] = {
    "force": np.concatenate([np.geomspace(0.05, 80.0, 7), -np.geomspace(0.05, 80.0, 7)]),
    "friction": np.geomspace(0.005, 2.0, 6),
    "restitution": np.geomspace(0.03, 0.9, 6),
}


@dataclass(frozen=True)
class ScreenedTerm:
    """A curve and its loss on the steps of the fit."""

    curve: Curve
    loss: float


def residual_table(model: ForwardModel, values: Values, stack: StackedResiduals, name: str) -> Floats:
    """Residuals (g, k) at each constant value of ``EVENT_GRIDS[name]``."""
    n = len(model.observations)
    one, term = np.ones((n, 1)), event_term(name, "")
    still = np.zeros(n)
    rows = [
        stack.residuals(AugmentedModel(model, [Curve(term, np.zeros(1), np.array([x]), one)], still), values)
        for x in EVENT_GRIDS[name]
    ]
    return np.array(rows)


def best_constant(table: Floats, stack: StackedResiduals, name: str) -> tuple[float, float]:
    """Best constant value and its loss."""
    losses = [stack.loss(r) for r in table]
    best = int(np.argmin(losses))
    return float(EVENT_GRIDS[name][best]), losses[best]


def screen_covariate(table: Floats, stack: StackedResiduals, term: Term, x: Floats, knots: Floats) -> ScreenedTerm:
    """Spline of one covariate on the table: the best value near each knot, then Gauss-Newton.

    ``table`` and ``stack`` are of `residual_table`; ``x`` are the covariate's values (n,), and at ``knots`` the spline
    bends.
    """
    grid = EVENT_GRIDS[term.name]
    basis = basis_of(x, knots)
    near = hat_functions(x, knots)[stack.event]
    values = np.full(len(knots), best_constant(table, stack, term.name)[0])
    weights = near * stack.train[:, None]
    for tail in TAILS:
        r, _ = _interpolated(table, grid, near @ values)
        width = stack.widths(r, tail)
        # near each knot the constant value that fits the events there best: a start for every value, without a slope
        by_value = robust_loss(table / width, log_odds(width, stack.period_s)) @ weights
        values = grid[np.argmin(by_value, axis=0)]
    rows = basis[stack.event]
    problem = Problem[Curve](
        lambda c: _interpolated(table, grid, c.table[stack.event])[0],
        lambda c, _: _interpolated(table, grid, c.table[stack.event])[1][:, None] * rows,
        _moved,
        penalty_of_curve,
    )
    curve, r = descend(problem, Curve(term, knots, values, basis), stack, (*TAILS[1:], *SHARP))
    return ScreenedTerm(curve, stack.loss(r))


def _interpolated(table: Floats, grid: Floats, value: Floats) -> tuple[Floats, Floats]:
    """Residuals at each event's own value, linearly interpolated, and their slope."""
    i = np.clip(np.searchsorted(grid, value) - 1, 0, len(grid) - 2)
    k = np.arange(table.shape[1])
    slope = (table[i + 1, k] - table[i, k]) / (grid[i + 1] - grid[i])
    return table[i, k] + slope * (value - grid[i]), slope


def _moved(curve: Curve, step: Floats) -> Curve:
    return curve.moved(curve.values + step)


def penalty_of_curve(curve: Curve) -> Penalty:
    """Penalty of bending, weighted for a curve of this spread; with more knots than usual each may bend less."""
    values, least = curve.values, 10.0 * curve.term.nudge
    rough = curve.roughness * min(1.0, (FIRST_KNOTS - 1) / max(len(values) - 1, 1))
    size = max(float(np.ptp(values)), 0.3 * float(np.max(np.abs(values), initial=0.0)), least)
    return curve.penalty / (rough * size) ** 2, values


def best_start(model: ForwardModel, values: Values, stack: StackedResiduals, curve: Curve, dwell_s: Floats) -> Curve:
    """``curve`` or a plain shape of some size in its place, whichever predicts best.

    A strong term sends flights to other landings than a weak one, so that a descent from zero ends in a local minimum.
    The shapes are constant, proportional to the covariate, to its square, and falling linearly to zero.
    """
    x = curve.knots / float(np.max(np.abs(curve.knots)))
    falls = (curve.knots[-1] - curve.knots) / (curve.knots[-1] - curve.knots[0])
    unit = model.gravity if curve.term.against_motion else 1.0
    sizes = unit * START_SIZES[curve.term.name]
    shapes = (np.ones_like(x), x, x * np.abs(x), falls)
    starts = [curve, *(curve.moved(size * shape) for shape in shapes for size in sizes)]
    losses = [stack.loss(stack.residuals(AugmentedModel(model, [c], dwell_s), values)) for c in starts]
    return starts[int(np.argmin(losses))]


def fit_in_flight(
    model: ForwardModel, values: Values, stack: StackedResiduals, start: Curve, dwell_s: Floats, tails: Sequence[float]
) -> ScreenedTerm:
    """Gauss-Newton by predictions, a pass for each of ``tails``; slopes are taken anew after a step of large gain."""
    problem = Problem[Curve](
        lambda c: stack.residuals(AugmentedModel(model, [c], dwell_s), values),
        lambda c, r: jacobian_of(model, values, stack, c, dwell_s, r),
        _moved,
        penalty_of_curve,
    )
    # after a gain of five nats the slopes of the start no longer hold
    curve, r = descend(problem, start, stack, tails, 5.0)
    return ScreenedTerm(curve, stack.loss(r))


def jacobian_of(
    model: ForwardModel, values: Values, stack: StackedResiduals, curve: Curve, dwell_s: Floats, r: Floats
) -> Floats:
    """Derivatives of the stacked residuals by the curve's values, (k, knots): one prediction if each flight has one."""
    nudge = curve.term.nudge
    if curve.term.columns:
        moved = replace(curve, values=curve.values + nudge)
        # each flight has one value, so one prediction with all moved gives every derivative by the chain rule
        along = (stack.residuals(AugmentedModel(model, [moved], dwell_s), values) - r) / nudge
        return np.asarray(along[:, None] * curve.basis[stack.event])
    out = np.empty((len(r), len(curve.values)))
    for i in range(len(curve.values)):
        values_moved = curve.values.copy()
        values_moved[i] += nudge
        moved = replace(curve, values=values_moved)
        out[:, i] = (stack.residuals(AugmentedModel(model, [moved], dwell_s), values) - r) / nudge
    return out


def covariance_of(curve: Curve, stack: StackedResiduals, r: Floats, jacobian: Floats) -> Floats:
    """Covariance of the curve's values at its knots, (k, k)."""
    normal, _ = normal_equations(stack, r, jacobian, penalty=penalty_of_curve(curve))
    return np.asarray(pinv(normal, rcond=1e-14))
