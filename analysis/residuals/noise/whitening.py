"""Whitening of residuals step by step, and their robust loss.

Errors of the plate's tones are common to all events of a step, and so is a small error of the contact circuit. So the
residuals of a step are whitened together; weights stay fixed while a fit runs. Decision 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from analysis.linear_algebra import NotFiniteError, eigh
from analysis.residuals.forward_model import ForwardModel, Residuals
from analysis.residuals.noise.changes import Changes
from analysis.residuals.noise.noise_model import NEVER, PlateNoise, excess_noise, log_odds, robust_loss
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.values import Values
from analysis.statistics import mad_sigma
from analysis.thresholds import (
    COMMON_MODE_SIGMAS,
    FARTHEST_PERIODS,
    LEAST_EXCESS_S,
    LOST_RATIO,
    SHARED_S,
    UNSHARED_RATIO,
)
from kernels import njit
from kernels.arrays import Bools, Floats, Integers

ENOUGH_EVENTS = 8  # residuals of a channel from which its excess is found


def _capped(x: Floats, cap: Floats) -> Floats:
    """Residuals within their caps; the cap itself where nothing was predicted."""
    return np.clip(np.where(np.isfinite(x), x, cap), -cap, cap)


class StepWeights(NamedTuple):
    """What makes the events of each step, in the order of steps, independent unit ones."""

    bounds: Integers  # of the steps' blocks
    sd: Floats  # own deviation of each event
    shared: Floats  # directions of the common errors of a step, orthonormal in each block
    shrink: Floats  # of each direction
    cap: Floats  # of each unit residual: beyond, it is excluded from the estimate of the common errors
    log: Floats  # of what each event is divided by in all

    def white(self, bare: Floats) -> Floats:
        """Whitened residuals of the events, (n,)."""
        unit = bare / self.sd
        # an outlier says nothing of the errors that its step shares: it counts as far as its cap
        return self.unshared(unit[:, None], np.clip(unit, -self.cap, self.cap)[:, None])[:, 0]

    def unshared(self, y: Floats, limited: Floats) -> Floats:
        """Columns ``y`` (n, k) without the common modes that ``limited`` shows."""
        out = np.ascontiguousarray(y)
        _unshare(out, np.ascontiguousarray(limited), self.bounds, self.shared, self.shrink)
        return out


@dataclass(frozen=True)
class Whitener:
    """Turns residuals into independent unit ones, step by step; fixed while a fit runs.

    ``excess_s`` is the excess noise of openings and of landings: scatter beyond their uncertainty. Hypotheses are
    compared each at its own excess.
    """

    opening: Integers
    landing: Integers
    step: Integers
    order: Integers
    weights: StepWeights
    period_s: Floats  # of the stacked events, before they are ordered by step
    odds: Floats  # log odds of being an outlier, of each event; never of plate data
    plate_sigma: Floats
    plate_log: Floats
    excess_s: tuple[float, float]
    total_s: Floats  # uncertainty of the stacked events, without excess, before they are ordered by step
    lost: bool  # whether landings are so far off that a fit may begin on the wrong branch
    changes: Changes  # of which uncertainties are made

    @classmethod
    def of(cls, model: ForwardModel, values: Values, near: Whitener | None = None, *, lean: bool = False) -> Whitener:
        """From the uncertainty and the excess at ``values``; ``lean``: as if there were no excess.

        What events change by is taken from a whitener ``near`` where they have hardly moved.
        """
        point, known = model.start(values), None if near is None else near.changes
        return model.memory.recall(("whitener", lean, point.ordered), lambda: cls._made(model, point, known, lean))

    @classmethod
    def _made(cls, model: ForwardModel, values: Values, near: Changes | None, lean: bool) -> Whitener:
        ev = model.observations
        u, r = uncertainty_at(model, values, near), model.residuals(values)
        opening, landing = np.flatnonzero(model.from_rest), np.flatnonzero(ev.scored)
        step = np.concatenate([ev.measured.step[opening], ev.measured.step[landing]])
        period = ev.steps.plate.period_s[step]
        first = np.arange(len(step)) < len(opening)
        bare = _capped(np.concatenate([r.opening_s[opening], r.landing_s[landing]]), FARTHEST_PERIODS * period)
        total = np.concatenate([u.opening_total_s[opening], u.landing_total_s[landing]])
        excess = (
            excess_noise(bare[first], total[first], period[first])[0],
            excess_noise(bare[~first], total[~first], period[~first])[0],
        )
        if lean:
            excess = (LEAST_EXCESS_S, LEAST_EXCESS_S)
        edges = np.concatenate([u.opening_sigma_s[opening], u.landing_sigma_s[landing]])
        tones = np.concatenate([u.opening_by_tone[opening], u.landing_by_tone[landing]])
        # grazes are not linear in the plate's error: a tenth of what a step shares counts as an event's own
        edges = np.hypot(edges, 0.1 * np.linalg.norm(tones, axis=1))
        # a small error of the contact circuit is common to all openings of a step, another to all landings
        tones = np.column_stack([tones, SHARED_S * first, SHARED_S * ~first])
        order = np.argsort(step, kind="stable")
        bounds = np.concatenate([[0], np.cumsum(np.unique(step, return_counts=True)[1])]).astype(np.int64)
        blocks = StepBlocks(bare[order], edges[order], tones[order], first[order], period[order], bounds)
        lost = excess[1] > LOST_RATIO * float(np.median(total))
        if not lean:
            excess = blocks.likeliest(excess, tuple(x > UNSHARED_RATIO * float(np.median(total)) for x in excess))
        weights = blocks.weights(excess)
        noise = ev.plate.noise()
        sigma, log = np.empty((2, len(ev.plate)))
        sigma[noise.rows], log[noise.rows] = noise.scaled(r.plate)
        odds = np.concatenate([log_odds(np.exp(weights.log), period[order]), np.full(len(ev.plate), NEVER)])
        return cls(
            opening, landing, step[order], order, weights, period, odds, sigma, log, excess, total, lost, u.changes
        )  # fmt: skip

    def near(self, other: Whitener) -> bool:
        """Whether the weights have converged, plate data included."""
        shrunk = max(a / b for a, b in zip(other.excess_s, self.excess_s, strict=True))
        plate = np.max(np.abs(np.log(self.plate_sigma / other.plate_sigma)), initial=0.0)
        return bool(
            0.8 < shrunk < 1.25 and np.median(np.abs(self.weights.log - other.weights.log)) < 0.1 and plate < 0.2
        )

    def profile_loss(self, r: Residuals, train: Bools, noise: PlateNoise) -> float:
        """Loss of the steps in ``train`` with the excess of each channel at its best for these very residuals.

        ``noise`` is that of the plate data of these steps. Infinite where a prediction is.
        """
        if not np.isfinite(r.plate).all():
            return math.inf
        step = np.empty_like(self.step)
        step[self.order] = self.step
        events = self._events(r)
        channel = np.arange(len(events)) < len(self.opening)
        total = 0.0
        for rows in (channel & train[step], ~channel & train[step]):
            total += excess_noise(events[rows], self.total_s[rows], self.period_s[rows])[1]
        return total + noise.loss(r.plate)

    def _events(self, r: Residuals) -> Floats:
        both = np.concatenate([r.opening_s[self.opening], r.landing_s[self.landing]])
        return _capped(both, FARTHEST_PERIODS * self.period_s)

    def stacked(self, r: Residuals) -> Floats:
        """Bare residuals in one column: events in the order of ``step``, then plate data."""
        return np.concatenate([self._events(r)[self.order], r.plate])

    def white_all(self, bare: Floats) -> Floats:
        """Whitened residuals, from bare ones."""
        n = len(self.step)
        return np.concatenate([self.weights.white(bare[:n]), bare[n:] / self.plate_sigma])

    def white_slopes(self, slopes: Floats, bare: Floats) -> Floats:
        """Derivatives of the whitened residuals, from columns of derivatives of the bare ones at ``bare``."""
        n = len(self.step)
        unit = slopes[:n] / self.weights.sd[:, None]
        counts = np.abs(bare[:n] / self.weights.sd) < self.weights.cap
        events = self.weights.unshared(unit, unit * counts[:, None])
        return np.concatenate([events, slopes[n:] / self.plate_sigma[:, None]])

    def white(self, r: Residuals) -> tuple[Floats, Floats]:
        """Whitened event residuals (in the order of ``step``) and plate residuals."""
        both = self.white_all(self.stacked(r))
        return both[: len(self.step)], both[len(self.step) :]


@dataclass(frozen=True)
class StepBlocks:
    """Events in the order of their steps: bare residuals, each one's own error, and errors common to its step."""

    bare: Floats
    edges: Floats
    tones: Floats
    opening: Bools
    period_s: Floats
    bounds: Integers

    def weights(self, excess: tuple[float, float]) -> StepWeights:
        """What the events are divided by at an excess."""
        sd = np.hypot(self.edges, np.where(self.opening, *excess))
        relative = self.tones / sd[:, None]
        shared, shrink, logs = _shared(relative, self.bounds)
        cap = COMMON_MODE_SIGMAS * np.sqrt(1.0 + np.sum(relative**2, axis=1))
        return StepWeights(self.bounds, sd, shared, shrink, cap, logs + np.log(sd))

    def loss(self, excess: tuple[float, float]) -> float:
        """Negative log likelihood at an excess."""
        weights = self.weights(excess)
        odds = log_odds(np.exp(weights.log), self.period_s)
        return float(np.sum(robust_loss(weights.white(self.bare), odds) + weights.log))

    def likeliest(self, guess: tuple[float, float], unshared: Sequence[bool]) -> tuple[float, float]:
        """Excess of openings and of landings by maximum likelihood, with the common errors of a step.

        Hypotheses are compared at this likelihood: off its maximum, mere weights would gain. Where the guess is
        ``unshared``, larger than common errors explain, it is at most raised: weights sharp for the few events that
        fit would take the others for outliers.
        """
        opening, landing = guess
        if unshared[1]:
            landing = self._raised(~self.opening, lambda x: (opening, x), landing)
        elif np.sum(~self.opening) >= ENOUGH_EVENTS:
            landing = _lowest(lambda x: self.loss((opening, x)), landing)
        if unshared[0]:
            opening = self._raised(self.opening, lambda x: (x, landing), opening)
        elif np.sum(self.opening) >= ENOUGH_EVENTS:
            opening = _lowest(lambda x: self.loss((x, landing)), opening)
        return opening, landing

    def _raised(self, rows: Bools, both: Callable[[float], tuple[float, float]], excess: float) -> float:
        """The excess raised while whitened residuals scatter by more than a unit."""
        # each channel's excess changes the scale of the others: three rounds, while one scatters 10 % too much
        for _ in range(3):
            z = self.weights(both(excess)).white(self.bare)
            scale = mad_sigma(z[rows]) if rows.sum() >= ENOUGH_EVENTS else 0.0
            if scale <= 1.1:
                break
            typical = float(np.median(np.hypot(self.edges[rows], excess)))
            excess = math.sqrt(excess**2 + (scale**2 - 1.0) * typical**2)
        return excess


def _lowest(loss: Callable[[float], float], guess: float) -> float:
    """Excess of lowest loss, from the least one to somewhat above a guess: on a grid, then between its points."""
    start = math.log(max(guess, 4.0 * LEAST_EXCESS_S))
    # coarse steps of a factor of two up to four times the start, then to 5 %
    grid = np.arange(math.log(LEAST_EXCESS_S), start + 1.4, 0.7)
    losses = [loss(math.exp(x)) for x in grid]
    k = int(np.argmin(losses))
    if k == 0 and loss(math.exp(grid[0] + 0.05)) > losses[0]:  # most fits leave no excess: it only rises from there
        return LEAST_EXCESS_S
    ends = (float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)]))
    fine: Any = minimize_scalar(lambda x: loss(math.exp(x)), bounds=ends, method="bounded", options={"xatol": 0.05})
    return math.exp(fine.x) if fine.fun < losses[k] else max(math.exp(grid[k]), LEAST_EXCESS_S)


def _shared(tones: Floats, bounds: Integers) -> tuple[Floats, Floats, Floats]:
    """Orthonormal directions of each block's common errors, their shrinkage, and their share of each log sigma."""
    # common errors count by their square: 1e-8 of an event's own changes nothing
    counts, tones = np.diff(bounds), tones[:, np.max(np.abs(tones), axis=0, initial=0.0) > 1e-8]
    place = np.arange(len(tones)) - np.repeat(bounds[:-1], counts)
    block = np.repeat(np.arange(len(counts)), counts)
    padded = np.zeros((len(counts), int(counts.max(initial=0)), tones.shape[1]))
    padded[block, place] = tones
    # unit residuals have the covariance 1 + T T'; its inverse root shrinks T's singular directions by
    # 1 / sqrt(1 + s^2)
    squares, turned = eigh(np.swapaxes(padded, 1, 2) @ padded)
    # where T's columns depend on each other, rounding leaves such squares of nothing
    squares = np.where(squares > 1e-12 * squares[:, -1:], squares, 0.0)
    vectors = padded @ (turned / np.sqrt(np.where(squares > 0.0, squares, np.inf))[:, None, :])
    # half the logarithm of its determinant, shared out evenly among the events
    logs = 0.5 * np.sum(np.log1p(squares), axis=1) / counts
    return vectors[block, place], 1.0 / np.sqrt(1.0 + squares) - 1.0, logs[block]


@njit()
def _unshare(y: Floats, limited: Floats, bounds: Integers, shared: Floats, shrink: Floats) -> None:
    """Subtract the common mode of each block: ``y += U shrink U^T limited``, in place, (n, columns)."""
    total = np.empty(y.shape[1])
    for i in range(len(bounds) - 1):
        for q in range(shared.shape[1]):
            if shrink[i, q] == 0.0:
                continue
            total[:] = 0.0
            for j in range(bounds[i], bounds[i + 1]):
                for c in range(y.shape[1]):
                    total[c] += shared[j, q] * limited[j, c]
            for j in range(bounds[i], bounds[i + 1]):
                for c in range(y.shape[1]):
                    y[j, c] += shrink[i, q] * total[c] * shared[j, q]


def step_losses(model: ForwardModel, whitener: Whitener, r: Residuals) -> dict[str, Floats]:
    """Loss of each step in each channel (events: openings and landings together), arrays of shape (m,).

    Raises `NotFiniteError` where plate data are predicted that are not finite.
    """
    if not np.isfinite(r.plate).all():
        raise NotFiniteError("what it predicts for steps that it was not fitted to is not finite")
    m, n = len(model.observations.steps), len(whitener.step)
    events, plate = whitener.white(r)
    by_event = robust_loss(events, whitener.odds[:n]) + whitener.weights.log
    by_datum = robust_loss(plate) + whitener.plate_log
    return {
        "events": np.asarray(np.bincount(whitener.step, by_event, minlength=m), dtype=np.float64),
        "plate": np.asarray(np.bincount(model.observations.plate.step, by_datum, minlength=m), dtype=np.float64),
    }
