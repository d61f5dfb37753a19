"""Robust, bounded fit of a set of effects to the observations, with priors, scored on held-out steps.

Calibrations and nuisances are always free within their priors, so that an effect must explain what they cannot. A fit
is scored only on steps that it did not see.

References
----------
K. Levenberg, Q. Appl. Math. 2, 164 (1944); D. Marquardt, J. SIAM 11, 431 (1963): damped least squares.
P. J. Green, J. R. Stat. Soc. B 46, 149 (1984): iteratively reweighted least squares for robust likelihoods.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from analysis.attribution.candidates import Prior, coordinate_of, null_value_of, parameter_of, scale_of, value_at
from analysis.linear_algebra import NotFiniteError, bounded_step, scaled_inverse
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import FREEDOM, robust_loss, robust_weight
from analysis.residuals.noise.whitening import Whitener, step_losses
from analysis.residuals.values import ParameterId
from analysis.thresholds import ANOTHER_EVENT_S, CALIBRATION_SIGMAS, NULL_P
from kernels.arrays import Bools, Floats
from model.effects.registry import effect

LEAST_GAIN = 0.1  # of a step in nats, below which a fit ends: hypotheses are compared in whole ones
RELATIVE_STEP = 0.004  # finite difference of a parameter, of its scale
HELD = 0.33  # of its standard deviation, that of what was identified without a flight
CURVATURE = (FREEDOM + 1.0) / (FREEDOM + 3.0)  # of the robust loss, over that of its weights: Fisher's information
FOLDS = 3  # of the cross-validation


class Fitter:
    """Fits sets of parameters to one model.

    Parameters
    ----------
    model
    priors
        Of everything that is always free.
    train
        True for the steps that fits and selection may see, shape (m,).
    """

    def __init__(self, model: ForwardModel, priors: Mapping[ParameterId, Prior], train: Bools) -> None:
        self.model, self.train = model, train
        self.events = train[model.observations.measured.step]  # no others count in a fit
        self.priors = {k: prior for k, prior in priors.items() if not model.is_idle(k)}
        mode = model.observations.ringing.mode
        self.identified = {k: Prior(*v) for k, v in mode.measured().items()} if mode and mode.sure else {}
        spread = np.flatnonzero(train)
        self.folds = [np.isin(np.arange(len(train)), spread[i::FOLDS]) for i in range(FOLDS)]

    # -- coordinates: the scale of a parameter is one unit -------------------------------------------------------------
    def bounds(self, key: ParameterId, *, released: bool) -> tuple[float, float]:
        """Bounds of a coordinate: what is physically possible, and for a calibration what its uncertainty allows.

        A calibration that would have to be farther off is an effect, to be named; it must not be absorbed.
        """
        q, prior = parameter_of(key), self.priors.get(key)
        low, high = q.low, q.high
        if prior is not None and not released and not effect(key[0]).effect.nuisance:
            reach = CALIBRATION_SIGMAS * prior.sigma
            low, high = max(low, prior.mean - reach), min(high, prior.mean + reach)
        return coordinate_of(key, low), coordinate_of(key, high)

    def values(self, keys: Sequence[ParameterId], x: Floats) -> dict[ParameterId, float]:
        """Parameter values at the coordinates ``x``."""
        return {k: value_at(k, float(xi)) for k, xi in zip(keys, x, strict=True)}

    def prior_rows(
        self, keys: Sequence[ParameterId], released: frozenset[ParameterId] = frozenset()
    ) -> tuple[Floats, Floats]:
        """Means and inverse widths of the priors in coordinates; width 0 where nothing is known.

        What was identified without a prediction is a datum where it is released: flights over a plate that rings follow
        their own errors farther than they know, so they weigh less.
        """
        mean, inverse = np.zeros(len(keys)), np.zeros(len(keys))
        for i, key in enumerate(keys):
            prior = self.identified.get(key) if key in released or key not in self.priors else self.priors[key]
            if prior is not None:
                mean[i] = coordinate_of(key, prior.mean)
                sigma = prior.sigma * (HELD if key in self.identified else 1.0)
                inverse[i] = scale_of(key) / sigma ** (1.0 / parameter_of(key).power)
        return mean, inverse

    def fit(
        self,
        whitener: Whitener,
        free: Sequence[ParameterId],
        start: Mapping[ParameterId, float],
        slopes: Mapping[ParameterId, Floats] | None = None,
        most: float = math.inf,
    ) -> Fitted:
        """Levenberg-Marquardt on the robust loss from ``start``.

        Raises `NotFiniteError` where predictions at ``start`` or the equations of a step are not finite.

        Parameters
        ----------
        whitener
            Weights of the residuals, kept fixed.
        free
            Parameters without prior; those of ``self.priors`` are always free within theirs.
        start
            Where to begin; missing ones begin at their prior's mean or null value.
        slopes
            Known derivatives of the bare residuals near ``start``. Those of free parameters count for one step only.
        most
            Loss that is of interest: a fit which would stay above it if it went on gaining as in its last step ends.
        """
        keys = [*free, *(k for k in self.priors if k not in free)]
        begin = {k: prior.mean for k, prior in self.priors.items()} | dict(start)
        x = np.array([coordinate_of(k, begin.get(k, null_value_of(k))) for k in keys])
        state = _State(self, whitener, keys, *self.prior_rows(keys, frozenset(free)))
        loss = state.loss(raw := state.raw(x), x)
        if not math.isfinite(loss):
            raise NotFiniteError("what it predicts is not finite")
        known, damping = slopes or {}, 1e-3
        bare = np.array([known.get(k, np.zeros(len(raw))) for k in keys]).reshape(len(keys), len(raw)).T.copy()
        state.fill(bare, x, raw, [j for j, k in enumerate(keys) if k not in known])
        # what was identified hardly moves in its prior: its slopes, which cost most, stay those of the start
        held = [j for j, key in enumerate(keys) if key in self.identified]
        own, gained = not known, math.inf  # whether slopes are those of this fit
        for i in range(12):
            # a step that gains less than a nat leads so near that slopes stay as they are
            if math.isfinite(gained) and not (own and gained < 1.0):
                state.fill(bare, x, raw, [j for j in range(len(free)) if j not in held])
                own = True
            (normal, gradient), gained = state.normal(bare, raw, x, state.mask), 0.0
            for _ in range(6):
                trial = x + damped_step(normal, gradient, damping, state.low - x, state.high - x)
                # a tenth of a deviation is worth 0.005 nats, and each move of a mode is a motion of the plate anew
                trial[held] = np.where(np.all((trial - x)[held] ** 2 * np.diag(normal)[held] < 0.01), x, trial)[held]
                # weighted least squares promise about half of what they gain where residuals are large
                if own and linear_gain(normal, gradient, trial - x) < 0.5 * LEAST_GAIN:
                    break
                loss_trial = state.loss(raw_trial := state.raw(trial), trial)
                if loss_trial < loss:
                    gained = loss - loss_trial
                    x, raw, loss, damping = trial, raw_trial, loss_trial, max(damping * 0.2, 1e-7)
                    break
                damping *= 8.0
            if gained < LEAST_GAIN or loss - (11 - i) * gained > most:
                break
        return Fitted(self, state, tuple(free), keys, x, raw, loss, bare)

    def linear_step(
        self, best: Fitted, free: Sequence[ParameterId], shapes: Mapping[ParameterId, float] | None = None
    ) -> tuple[float, dict[ParameterId, float]]:
        """Gain in nats of freeing ``free`` if residuals were linear, and the values there.

        What ``best`` itself would gain by another step is not counted. Shape parameters stay where ``shapes`` puts
        them.
        """
        keys = [*free, *(k for k in best.keys if k not in free)]
        at = {**best.values, **(shapes or {})}
        x = np.array([coordinate_of(k, at.get(k, null_value_of(k))) for k in keys])
        state = _State(self, best.state.whitener, keys, *self.prior_rows(keys, frozenset((*best.free, *free))))
        bare = np.column_stack([best.slopes.get(k, np.zeros(len(best.raw))) for k in keys])
        sizes = [j for j, k in enumerate(free) if not parameter_of(k).is_shape]
        state.fill(bare, x, best.raw, sizes, kept=True)
        normal, gradient = state.normal(bare, best.raw, x, state.mask)
        low, high, rest = state.low - x, state.high - x, slice(len(free), None)
        step = damped_step(normal, gradient, 1e-6, low, high)
        without = damped_step(normal[rest, rest], gradient[rest], 1e-6, low[rest], high[rest])
        gain = linear_gain(normal, gradient, step) - linear_gain(normal[rest, rest], gradient[rest], without)
        return gain, self.values(keys, x + step)

    def slope(self, best: Fitted, key: ParameterId, shapes: Mapping[ParameterId, float] | None = None) -> Floats:
        """Derivative of the bare residuals to one parameter beyond ``best``, its shapes where ``shapes`` puts them."""
        at = {key: null_value_of(key), **best.values, **(shapes or {})}
        keys = [key, *(k for k in at if k != key)]
        x = np.array([coordinate_of(k, at[k]) for k in keys])
        state = _State(self, best.state.whitener, keys, *self.prior_rows(keys, frozenset((*best.free, key))))
        bare = np.zeros((len(best.raw), 1))
        state.fill(bare, x, best.raw, (0,), kept=True)
        return bare[:, 0]


class _State:
    """One fit's bookkeeping: stacked residuals of events and plate, their steps, and the priors."""

    def __init__(
        self, fitter: Fitter, whitener: Whitener, keys: Sequence[ParameterId], mean: Floats, inverse: Floats
    ) -> None:
        self.fitter, self.whitener, self.keys, self.mean, self.inverse = fitter, whitener, list(keys), mean, inverse
        self.step = np.concatenate([whitener.step, fitter.model.observations.plate.step])
        self.mask = fitter.train[self.step]
        self.leaping = np.zeros(len(self.step), dtype=bool)  # flights whose slopes are none, by any parameter
        bounds = [fitter.bounds(k, released=inverse[i] == 0.0) for i, k in enumerate(keys)]
        self.low, self.high = np.array(bounds, dtype=np.float64).reshape(-1, 2).T

    def point(self, x: Floats) -> dict[ParameterId, float]:
        return self.fitter.values(self.keys, x)

    def raw(self, x: Floats) -> Floats:
        """Bare residuals of the training steps at ``x``, stacked; those of other steps are not predicted."""
        return self.whitener.stacked(self.fitter.model.residuals(self.point(x), wanted=self.fitter.events))

    def loss(self, raw: Floats, x: Floats) -> float:
        """Robust loss of the training steps, priors included; infinite where a prediction is."""
        if not np.isfinite(raw).all():
            return math.inf
        z = self.whitener.white_all(raw)
        return float(np.sum(robust_loss(z, self.whitener.odds)[self.mask])) + self.prior_penalty(x)

    def prior_penalty(self, x: Floats) -> float:
        """Negative log prior at ``x``, nats."""
        return 0.5 * float(np.sum(((x - self.mean) * self.inverse) ** 2))

    def fill(self, bare: Floats, x: Floats, raw: Floats, columns: Iterable[int], *, kept: bool = False) -> None:
        """Derivatives of the bare residuals, one column a parameter; ``kept`` where they will be asked for again."""
        model = self.fitter.model
        point = self.point(x) if kept else {}
        here = tuple(sorted((k, v) for k, v in point.items() if k in model.base or v != null_value_of(k)))
        for j in columns:
            # at an upper bound the difference is taken inwards
            h = RELATIVE_STEP if x[j] + RELATIVE_STEP <= self.high[j] else -RELATIVE_STEP
            if kept:
                key = (here, self.keys[j], h)
                bare[:, j] = model.slope_memory.recall(key, functools.partial(self._difference, x, raw, j, h))
            else:
                bare[:, j] = self._difference(x, raw, j, h)
        bare[self.leaping] = 0.0

    def _difference(self, x: Floats, raw: Floats, j: int, h: float) -> Floats:
        """Slopes of the bare residuals by one coordinate, from a finite difference.

        A flight that grazes leaps to another landing within the difference, which would hold the parameter where it is.
        So a flight that says most of a parameter is flown once more: where both differences disagree, no slope counts.
        """
        slopes, n = self._one_sided(x, raw, j, h), len(self.whitener.step)
        information = self.whitener.white_slopes(slopes[:, None], raw)[:n, 0] ** 2
        # the slope of a flight that says a fifth of what all flights say is looked at again
        heavy = np.flatnonzero(information > 0.2 * information.sum())
        if len(heavy):
            other = -h if self.low[j] <= x[j] - h <= self.high[j] else h / 8
            product, square = self._one_sided(x, raw, j, other)[heavy] * slopes[heavy], slopes[heavy] ** 2
            self.leaping[heavy[(product < 0.5 * square) | (product > 2.0 * square)]] = True
        slopes[self.leaping] = 0.0
        return slopes

    def _one_sided(self, x: Floats, raw: Floats, j: int, h: float) -> Floats:
        moved = x.copy()
        moved[j] += h
        change = of_same_events(self.raw(moved) - raw, self.whitener)
        return np.where(self.mask, change, 0.0) / h

    def normal(self, slopes: Floats, raw: Floats, x: Floats, mask: Bools) -> tuple[Floats, Floats]:
        """Normal equations of the weighted step, priors included, from bare residuals and their slopes."""
        z, jacobian = self.whitener.white_all(raw), self.whitener.white_slopes(slopes, raw)
        # iteratively reweighted least squares: with these weights the step lowers the robust loss
        weight = np.where(mask, robust_weight(z, self.whitener.odds), 0.0)
        weighted = jacobian * weight[:, None]
        pull = self.inverse**2
        return weighted.T @ jacobian + np.diag(pull), -(weighted.T @ z) - pull * (x - self.mean)


def of_same_events(change: Floats, whitener: Whitener) -> Floats:
    """Changes of stacked bare residuals, (r,); 0 where a flight became another one or is not predicted."""
    events = np.arange(len(change)) < len(whitener.step)
    return np.where((events & (np.abs(change) > ANOTHER_EVENT_S)) | ~np.isfinite(change), 0.0, change)


def damped_step(normal: Floats, gradient: Floats, damping: float, below: Floats, above: Floats) -> Floats:
    """Minimum of the damped quadratic model within ``below <= step <= above``."""
    diagonal = np.diag(normal).copy()
    # Marquardt scales the damping by the diagonal: what nothing shows has none, and must not move for it
    diagonal[diagonal <= 0] = 1e-12
    return bounded_step(normal + np.diag(damping * diagonal + 1e-12), gradient, below, above)


def linear_gain(normal: Floats, gradient: Floats, step: Floats) -> float:
    """Gain of a step in the quadratic model, nats."""
    return float(step @ gradient - 0.5 * step @ normal @ step)


@dataclass(frozen=True)
class Fitted:
    """A fit, with what held-out losses and intervals are computed from."""

    fitter: Fitter
    state: _State
    free: tuple[ParameterId, ...]
    keys: list[ParameterId]
    x: Floats
    raw: Floats
    loss: float
    bare: Floats

    @property
    def slopes(self) -> dict[ParameterId, Floats]:
        """Derivatives of the bare residuals, by parameter."""
        return {k: self.bare[:, j] for j, k in enumerate(self.keys)}

    def normal(self, mask: Bools) -> tuple[Floats, Floats]:
        """Normal equations and their right side, of the rows in ``mask``."""
        return self.state.normal(self.bare, self.raw, self.x, mask)

    @property
    def values(self) -> dict[ParameterId, float]:
        """Fitted and fixed values."""
        return self.state.point(self.x)

    @property
    def prior_penalty(self) -> float:
        """Negative log prior of calibrations and nuisances, nats."""
        return self.state.prior_penalty(self.x)

    def moved_calibrations(self, sigmas: float) -> set[ParameterId]:
        """What is always free and was fitted by more than ``sigmas`` from where it is stated."""
        away = np.abs((self.x - self.state.mean) * self.state.inverse)
        return {k for k, d in zip(self.keys, away, strict=True) if k not in self.free and d > sigmas}

    def covariance(self) -> Floats:
        """Of all coordinates."""
        return scaled_inverse(self.normal(self.state.mask)[0])

    def covariance_of(self, slopes: Floats) -> Floats:
        """Of further parameters, fitted with all coordinates, from their slopes of the bare residuals: (rows, p)."""
        whitener, p = self.state.whitener, slopes.shape[1]
        jacobian = whitener.white_slopes(np.hstack([slopes, self.bare]), self.raw)
        weight = np.where(self.state.mask, robust_weight(whitener.white_all(self.raw), whitener.odds), 0.0)
        normal = (jacobian * weight[:, None]).T @ jacobian
        normal[p:, p:] += np.diag(self.state.inverse**2)
        return scaled_inverse(normal)[:p, :p]

    @functools.cached_property
    def _variances(self) -> Floats:
        """Of all coordinates: from the noise as stated, or from how much steps differ where that is more, (k,).

        Errors that events of a step share and nothing states make each step pull a value its own way (the sandwich of
        White, Econometrica 48, 817 (1980), by steps).
        """
        state, whitener = self.state, self.state.whitener
        normal, prior = self.normal(state.mask)[0], np.diag(state.inverse**2)
        covariance = scaled_inverse(CURVATURE * (normal - prior) + prior)
        z, jacobian = whitener.white_all(self.raw), whitener.white_slopes(self.bare, self.raw)
        score = (z * robust_weight(z, whitener.odds))[:, None] * jacobian
        steps = np.unique(state.step[state.mask])
        pulls = np.array([score[state.step == s].sum(axis=0) for s in steps]) @ covariance
        between = len(steps) * np.var(pulls, axis=0, ddof=min(1, len(steps) - 1))
        return np.asarray(np.maximum(np.diag(covariance), between))

    def sigma(self, key: ParameterId) -> float:
        """Standard deviation of a fitted value, in its own unit."""
        j = self.keys.index(key)
        q, scale = parameter_of(key), scale_of(key)
        spread = math.sqrt(max(self._variances[j], 0.0)) * scale
        if key in self.fitter.identified:
            return max(spread, self.fitter.identified[key].sigma)
        if q.power == 1.0:
            return spread
        y = abs(self.x[j] * scale)
        return float(q.power * max(y, spread) ** (q.power - 1.0) * spread)  # at zero, as far as one sigma leads

    def differs(self, keys: Sequence[ParameterId]) -> bool:
        """Whether sizes among ``keys`` together differ from their null values by 95 %, by the quadratic model.

        What else is fitted follows to its bounds only: a height at zero cannot sink to make up for a lag.
        """
        rows = np.isin(np.arange(len(self.keys)), [self.keys.index(k) for k in keys if not parameter_of(k).is_shape])
        to_null = np.array([coordinate_of(k, null_value_of(k)) for k in self.keys]) - self.x
        step, (normal, _) = np.where(rows, to_null, 0.0), self.normal(self.state.mask)
        low, high = (bound[~rows] - self.x[~rows] for bound in (self.state.low, self.state.high))
        step[~rows] = damped_step(normal[np.ix_(~rows, ~rows)], -(normal @ step)[~rows], 1e-9, low, high)
        return float(step @ normal @ step) > float(chdtri(np.count_nonzero(rows), NULL_P))

    def held_out(self, whitener: Whitener) -> dict[str, Floats]:
        """Loss of each training step in each channel when the fit did not see it, shape (m,); 0 on other steps.

        Each fold's fit is one step from the common one, on the other folds' steps; its residuals are then exact.
        """
        model = self.fitter.model
        out: dict[str, Floats] = {}
        for fold in self.fitter.folds:
            mask, seen = self.state.mask & ~fold[self.state.step], fold[model.observations.measured.step]
            normal, gradient = self.normal(mask)
            x = self.x + damped_step(normal, gradient, 1e-6, self.state.low - self.x, self.state.high - self.x)
            losses = step_losses(model, whitener, model.residuals(self.state.point(x), wanted=seen))
            for channel, values in losses.items():
                out[channel] = out.get(channel, np.zeros_like(values)) + np.where(fold, values, 0.0)
        return out
