"""Detection limit of a parameter: the smallest size whose expected gains pass the tests of a verdict.

A size is named when it gains enough in the fit, and when steps that the fit did not see gain by it. Both expectations
follow from the change that the whole size makes, not from a derivative at nothing: what begins at a threshold is no
straight line there. An effect that shows in few steps needs to be larger than the gain of the fit promises, since the
others do not tell its size when those are left out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from analysis.attribution.comparison import LogScoreDifference
from analysis.attribution.fit import LEAP_S, Fitted
from analysis.attribution.priors import null_value_of, parameter_of
from analysis.residuals.forward_model import ParameterId
from analysis.residuals.noise_model import robust_loss, robust_weight
from analysis.thresholds import Thresholds

Array = NDArray[np.float64]

LEAST_INFORMATION = 1e-9  # of one scale of a parameter: below, it changes nothing
MOST_ROUNDS = 6  # of sizes that are tried
SETTLED = 0.1  # relative change of a size at which it has been found
FARTHEST = 100.0  # times the size tried, or its part, up to which expected gains are tested


class Detectability:
    """Expected gains of sizes beside one fit.

    Parameters
    ----------
    best
        The fit; its calibrations and named effects stay free beside every size.
    limits
        Thresholds of the verdict.
    """

    def __init__(self, best: Fitted, limits: Thresholds) -> None:
        self.best, self.limits = best, limits
        self._state, self._whitener = best.state, best.state.whitener
        self._z = self._whitener.white_all(best.raw)
        self._weight = np.where(self._state.mask, robust_weight(self._z, self._whitener.odds), 0.0)
        opening = self._whitener.order < len(self._whitener.opening)
        self._channel = np.concatenate([opening.astype(np.int64), 2 + best.fitter.world.evidence.plate.kind])
        self._beside = self._whitener.white_slopes(best.bare, best.raw)
        self._stiffness = self._state.inverse**2

    def limit(self, key: ParameterId) -> float:
        """Smallest detectable size of a parameter, in its own unit; infinite where it changes nothing.

        The parameter's own prior is left out; all others stay free.
        """
        fitter, q = self.best.fitter, parameter_of(key)
        at = self.best.values.get(key, null_value_of(key))
        x = fitter.to_x(key, at)
        low, high = fitter.to_x(key, q.low), fitter.to_x(key, q.high)
        size, found = 1.0, math.inf
        for _ in range(MOST_ROUNDS):
            reached = x + size if x + size <= high else max(x - size, low)
            tried = abs(reached - x)
            multiple = self._multiple(key, self._change(key, reached) / tried, tried, high - low)
            found = tried * multiple
            if not math.isfinite(found) or abs(multiple - 1.0) < SETTLED or (found > tried and tried < size):
                break
            size = found
        return float((found * fitter.scale(key)) ** q.power) if math.isfinite(found) else math.inf

    def _change(self, key: ParameterId, x: float) -> Array:
        """Change of the whitened residuals when a parameter goes to the coordinate ``x``.

        It is taken where calibrations have followed, less what they have done by their derivatives: what they hide to
        first order they mostly hide to second.
        """
        others = np.array([k != key for k in self.best.keys])
        beside, stiffness = self._beside[:, others], self._stiffness[others]
        now = self.best.x[others]
        alone = self._moved(key, x, now)
        follow = -_fitted(beside, stiffness, self._weight, alone)
        after = np.clip(now + follow, self._state.low[others], self._state.high[others])
        return np.asarray(self._moved(key, x, after) - beside @ (after - now))

    def _moved(self, key: ParameterId, x: float, others: Array) -> Array:
        """Change of the whitened residuals at a coordinate of a parameter, and at those of what is fitted beside it."""
        fitter, raw = self.best.fitter, self.best.raw
        keys = [k for k in self.best.keys if k != key]
        values = {**fitter.values(keys, others), **fitter.values((key,), np.array([x]))}
        change = self._whitener.stacked(fitter.world.residuals(values)) - raw
        events = np.arange(len(change)) < len(self._whitener.step)
        change[(events & (np.abs(change) > LEAP_S)) | ~np.isfinite(change)] = 0.0
        return np.asarray(self._whitener.white_slopes(change[:, None], raw)[:, 0])

    def _multiple(self, key: ParameterId, slope: Array, tried: float, reach: float) -> float:
        """By what the size tried has to be multiplied to be named; ``slope`` is the change per unit of it."""
        others = np.array([k != key for k in self.best.keys])
        beside, stiffness = self._beside[:, others], self._stiffness[others]
        left = slope - beside @ _fitted(beside, stiffness, self._weight, slope)
        if float(slope @ (self._weight * left)) <= LEAST_INFORMATION:
            return math.inf
        signal, lost = self._left_out(slope, beside, stiffness, reach)
        low, high = math.log(1.0 / FARTHEST), math.log(FARTHEST)
        if not self._named(tried * FARTHEST, left, signal, lost):
            return math.inf
        while high - low > 0.25 * SETTLED:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._named(tried * math.exp(middle), left, signal, lost) else (middle, high)
        return math.exp(high)

    def _named(self, size: float, left: Array, signal: Array, lost: Array) -> bool:
        """Whether expected gains of a size pass; what a unit leaves beside calibrations, and does to steps left out."""
        gain, weakened = self._gain(size * left)
        if gain < self.limits.gain_nats:
            return False
        seen, m = self.best.fitter.train, len(self.best.fitter.train)
        won = np.bincount(self._state.step, size**2 * signal * weakened, minlength=m)
        lose = np.bincount(self._state.step, lost, minlength=m)
        return LogScoreDifference.of(won, lose, seen).exceeds(*self._wanted)

    def _gain(self, change: Array) -> tuple[float, Array]:
        """Expected gain of a change of whitened residuals, nats, and by what it is below a square law, (r,).

        Large residuals weigh less, and where a channel's own scatter is estimated, what is not named is taken for
        scatter: of ``n`` normal residuals a gain of ``g`` at known scatter is ``n / 2 log(1 + 2 g / n)``.
        """
        square = 0.5 * self._weight * change**2
        z, odds, seen = self._z, self._whitener.odds, self._state.mask
        gain = 0.5 * (robust_loss(z + change, odds) + robust_loss(z - change, odds)) - robust_loss(z, odds)
        channels = self._channel[seen]
        of, n = np.bincount(channels, gain[seen]), np.bincount(channels)
        of = 0.5 * n * np.log1p(np.maximum(2.0 * of / np.maximum(n, 1), 0.0))
        whole = np.bincount(channels, square[seen], minlength=len(of))
        part = np.divide(of, whole, out=np.zeros(len(of)), where=whole > 0.0)
        return float(of.sum()), np.append(part, np.zeros(int(self._channel.max()) + 1 - len(part)))[self._channel]

    @property
    def _wanted(self) -> tuple[float, float]:
        """Nats and standard errors of a gain on steps left out."""
        if self.best.free:
            return self.limits.next_effect_nats, self.limits.next_effect_sigmas
        return self.limits.first_effect_nats, self.limits.first_effect_sigmas

    def _left_out(self, slope: Array, beside: Array, stiffness: Array, reach: float) -> tuple[Array, Array]:
        """What each residual gains by a unit of the size where it is left out, and loses by its uncertainty, (r,) nats.

        Without the size, a fit to the other steps is off by what calibrations cannot follow; with it, by the error of
        the size found there, at most ``reach``.
        """
        both, stiff = np.column_stack([slope, beside]), np.append(reach**-2.0, stiffness)
        signal, lost = np.zeros(len(slope)), np.zeros(len(slope))
        for fold in self.best.fitter.folds:
            held = fold[self._state.step]
            weight = np.where(held, 0.0, self._weight)
            bias = slope - beside @ _fitted(beside, stiffness, weight, slope)
            more = _variance(both, stiff, weight) - _variance(beside, stiffness, weight)
            signal[held] = (0.5 * self._weight * bias**2)[held]
            lost[held] = (0.5 * self._weight * more)[held]
        return signal, lost


def _covariance(columns: Array, stiffness: Array, weight: Array) -> Array:
    normal = (columns * weight[:, None]).T @ columns + np.diag(stiffness)
    return np.asarray(np.linalg.pinv(normal, rcond=1e-14, hermitian=True), dtype=np.float64)


def _fitted(columns: Array, stiffness: Array, weight: Array, values: Array) -> Array:
    """Coefficients of a weighted fit of ``columns`` to ``values`` with priors about zero."""
    return np.asarray(_covariance(columns, stiffness, weight) @ (columns.T @ (weight * values)))


def _variance(columns: Array, stiffness: Array, weight: Array) -> Array:
    """Variance of each row's fitted value, (n,)."""
    return np.asarray(np.einsum("ij,jk,ik->i", columns, _covariance(columns, stiffness, weight), columns))
