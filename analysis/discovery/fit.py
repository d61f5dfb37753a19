"""Fits of missing terms to residuals: the solver of curves and formulas, and penalised splines.

The solver is Gauss-Newton on the robust loss of stacked residuals of take-offs and landings.
`scipy.optimize.least_squares` cannot do it: the widths of the residuals are found anew in each pass, from a quantile
that falls from pass to pass, so that a fit that begins among other events is drawn to the right ones; and slopes, each
a prediction of all flights, are taken anew only after a step that gained much. Decision 369.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from scipy.special import ndtri

from analysis.discovery.terms import AugmentedModel, Curve
from analysis.linear_algebra import lstsq
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.changes import Changes
from analysis.residuals.noise.noise_model import excess_noise, log_odds, robust_loss, robust_weight
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.values import Values
from analysis.thresholds import FARTHEST_PERIODS, LEAST_EXCESS_S
from kernels.arrays import Bools, Floats, Integers

CURVE_FOLDS = 8  # of the cross-validation over steps
Penalty = tuple[Floats, Floats]  # quadratic form (p, p), and the values (p,) that it is taken of


@dataclass(frozen=True)
class StackedResiduals:
    """Openings, then landings, of the judged flights: arrays (k,)."""

    event: Integers  # the flight
    first: Bools  # True for openings
    sigma_s: Floats  # uncertainty without excess
    period_s: Floats  # of the forcing
    train: Bools  # True where a fit may look
    step: Integers  # the flight's step
    fit_steps: Bools  # steps that the fit may use, (m,)

    @classmethod
    def of(cls, model: ForwardModel, values: Values, train: Bools, near: Changes | None = None) -> StackedResiduals:
        """Residuals' stack of a forward model at ``values``; ``train`` by step, (m,); ``near`` as for uncertainties."""
        observations, u = model.observations, uncertainty_at(model, values, near)
        opening, landing = np.flatnonzero(model.from_rest), np.flatnonzero(observations.scored)
        event = np.concatenate([opening, landing])
        step = observations.measured.step[event]
        sigma = np.concatenate([u.opening_total_s[opening], u.landing_total_s[landing]])
        first, period_s = np.arange(len(event)) < len(opening), observations.steps.plate.period_s[step]
        return cls(event, first, sigma, period_s, train[step], step, train)

    def landings(self) -> StackedResiduals:
        """Only the landings: unlike openings they do not depend on the contact's gap, which a wrong model bends."""
        return replace(self, **{name: rows[~self.first] for name, rows in vars(self).items() if name != "fit_steps"})

    def without(self, rows: Bools) -> StackedResiduals:
        """The same with a fit that may not look at ``rows`` (k,)."""
        return replace(self, train=self.train & ~rows)

    def folds(self) -> Iterator[Bools]:
        """Rows (k,) of each fold of the cross-validation over the steps of the fit."""
        steps = np.flatnonzero(self.fit_steps)
        for i in range(CURVE_FOLDS):
            yield np.isin(self.step, steps[i::CURVE_FOLDS])

    def held_out(
        self, r: Floats, slopes: Floats, after: Callable[[Floats], Floats], penalty: Penalty | None = None
    ) -> tuple[Floats, Floats]:
        """Residuals, each step's as they are ``after`` the step of a fit to the others; these steps (f, p)."""
        held, moves = r.copy(), []
        for fold in self.folds():
            moves.append(newton_step(self.without(fold), r, slopes, penalty=penalty))
            held[fold] = after(moves[-1])[fold]
        return held, np.array(moves)

    def residuals(self, model: ForwardModel, values: Values) -> Floats:
        """Residuals of this stack at ``values``, clipped at `FARTHEST_PERIODS`."""
        p, measured = model.predict(values), model.observations.measured
        return self.cut(measured.opening_s - p.opening_s, measured.landing_s - p.landing_s)

    def widths(self, r: Floats, tail: float = 0.5) -> Floats:
        """Uncertainty with an excess of each channel that fits the residual at the quantile ``tail``."""
        out = np.empty_like(r)
        for rows in (self.first, ~self.first):
            look = rows & self.train
            size = float(np.quantile(np.abs(r[look]), tail) / ndtri(0.5 + 0.5 * tail)) if look.any() else 0.0
            usual = float(np.median(self.sigma_s[look])) if look.any() else 0.0
            out[rows] = np.hypot(self.sigma_s[rows], max(np.sqrt(max(size**2 - usual**2, 0.0)), LEAST_EXCESS_S))
        return out

    def by_step(self, r: Floats) -> Floats:
        """Loss of each step, (m,), each excess at its best on the steps of the fit."""
        out = np.zeros(len(self.fit_steps))
        for rows in (self.first, ~self.first):
            look = rows & self.train
            if look.any():
                excess = excess_noise(r[look], self.sigma_s[look], self.period_s[look])[0]
                total = np.hypot(self.sigma_s[rows], excess)
                loss = robust_loss(r[rows] / total, log_odds(total, self.period_s[rows])) + np.log(total)
                out += np.bincount(self.step[rows], loss, minlength=len(out))
        return out

    def cut(self, opening_s: Floats, landing_s: Floats) -> Floats:
        """Residuals of this stack, from those of all flights (n,), cut at the farthest."""
        both = np.where(self.first, opening_s[self.event], landing_s[self.event])
        cap = FARTHEST_PERIODS * self.period_s
        return np.asarray(np.clip(np.where(np.isfinite(both), both, cap), -cap, cap))

    def scatter(self, r: Floats) -> float:
        """Root mean square of the trained landings over their uncertainty, each at most 6 and with at least 1 us."""
        rows = ~self.first & self.train
        return float(np.sqrt(np.mean(np.clip(r[rows] / np.hypot(self.sigma_s[rows], 1e-6), -6.0, 6.0) ** 2)))

    def loss(self, r: Floats) -> float:
        """Loss of what is trained on, each channel's excess at its best."""
        total = 0.0
        for rows in (self.first & self.train, ~self.first & self.train):
            total += excess_noise(r[rows], self.sigma_s[rows], self.period_s[rows])[1]
        return total


X = TypeVar("X")


@dataclass(frozen=True)
class Problem(Generic[X]):
    """What is fitted: a point of some kind with p parameters, and k stacked residuals."""

    residuals: Callable[[X], Floats]  # at a point, (k,)
    slopes: Callable[[X, Floats], Floats]  # from the point and its residuals to the derivatives there, (k, p)
    moved: Callable[[X, Floats], X]  # the point after a step (p,), within its bounds
    penalty: Callable[[X], Penalty] | None = None  # a quadratic form of the parameters; none where not given

    def loss(self, x: X, stack: StackedResiduals, r: Floats, width: Floats) -> float:
        """Robust loss of the training steps at fixed widths, with the penalty."""
        data = float(np.sum(robust_loss(r / width, log_odds(width, stack.period_s))[stack.train]))
        if self.penalty is None:
            return data
        form, values = self.penalty(x)
        return data + 0.5 * float(values @ form @ values)


def normal_equations(
    stack: StackedResiduals, r: Floats, slopes: Floats, tail: float = 0.5, penalty: Penalty | None = None
) -> tuple[Floats, Floats]:
    """Normal equations of a weighted step, (p, p) and (p,), with widths by the quantile ``tail`` of the residuals."""
    width = stack.widths(r, tail)
    z, j = r / width, slopes / width[:, None]
    weight = np.where(stack.train, robust_weight(z, log_odds(width, stack.period_s)), 0.0)
    normal, push = (j * weight[:, None]).T @ j, -(j.T @ (weight * z))
    return (normal, push) if penalty is None else (normal + penalty[0], push - penalty[0] @ penalty[1])


def newton_step(
    stack: StackedResiduals, r: Floats, slopes: Floats, tail: float = 0.5, penalty: Penalty | None = None
) -> Floats:
    """Step (p,) that lowers the penalised robust loss, to second order."""
    normal, push = normal_equations(stack, r, slopes, tail, penalty)
    normal = normal + 1e-6 * np.diag(np.diag(normal)) + 1e-12 * np.eye(len(push))
    return np.asarray(lstsq(normal, push, rcond=1e-10)[0])


def descend(
    problem: Problem[X], start: X, stack: StackedResiduals, tails: Sequence[float], far_nats: float = 0.0
) -> tuple[X, Floats]:
    """The fitted point and its residuals.

    ``tails`` are quantiles of the residuals that set the robust width, a pass each. The fit ends early where a step
    with slopes of its own point gains nothing and the quantile stays the same. Slopes are taken anew after a step that
    gains more than ``far_nats``.
    """
    x, r = start, problem.residuals(start)
    slopes, here, gained = np.zeros((0, 0)), False, np.inf
    for i, tail in enumerate(tails):
        if not here and gained > far_nats:
            slopes, here = problem.slopes(x, r), True
        own = here  # whether the slopes are those of this point
        step = newton_step(stack, r, slopes, tail, None if problem.penalty is None else problem.penalty(x))
        width = stack.widths(r, tail)
        now, gained = problem.loss(x, stack, r, width), 0.0
        # a step that does not lower the loss is halved up to three times
        for half in range(4):
            trial = problem.moved(x, 0.5**half * step)
            r_trial = problem.residuals(trial)
            gained = now - problem.loss(trial, stack, r_trial, width)
            if gained > 0.0:
                x, r, here = trial, r_trial, False
                break
        # a step that gains less than 0.2 nats ends the fit
        if gained < 0.2:
            if own and set(tails[i:]) == {tail}:
                break
            gained = np.inf
    return x, r


def fit_in_flight(
    model: ForwardModel, values: Values, stack: StackedResiduals, start: Curve, dwell_s: Floats, tails: Sequence[float]
) -> Curve:
    """Gauss-Newton by predictions, a pass for each of ``tails``; slopes are taken anew after a step of large gain."""
    problem = Problem[Curve](
        lambda c: stack.residuals(AugmentedModel(model, [c], dwell_s), values),
        lambda c, r: jacobian_of(model, values, stack, c, dwell_s, r),
        Curve.stepped,
        Curve.penalty,
    )
    # after a gain of five nats the slopes of the start no longer hold
    return descend(problem, start, stack, tails, 5.0)[0]


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
    for i, step in enumerate(nudge * np.eye(len(curve.values))):
        moved = replace(curve, values=curve.values + step)
        out[:, i] = (stack.residuals(AugmentedModel(model, [moved], dwell_s), values) - r) / nudge
    return out
