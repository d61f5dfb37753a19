"""Detection limits: the sizes below which a recording could not have shown an effect.

A size is named when it gains enough in the fit, and when steps that the fit did not see gain by it. Both expectations
follow from the change that the whole size makes, not from a derivative at nothing: what begins at a threshold is no
straight line there. An effect that shows in few steps needs to be larger than the gain of the fit promises, since the
others do not tell its size when those are left out. Decision 216.
"""

from __future__ import annotations

import math

import numpy as np

from analysis.attribution.candidates import coordinate_of, null_value_of, parameter_of, scale_of
from analysis.attribution.choice import LogScoreDifference, required_gain
from analysis.attribution.fit import Fitted, of_same_events
from analysis.attribution.hypothesis import Hypothesis
from analysis.linear_algebra import pinv
from analysis.residuals.noise.noise_model import robust_loss, robust_weight
from analysis.residuals.values import ParameterId
from analysis.thresholds import Thresholds
from kernels.arrays import Bools, Floats, Integers
from model.effects.registry import registry

SETTLED, TURNS = 0.1, 16  # relative change of a size at which it has been found; turns at most
FARTHEST, COARSE = 8.0, 7  # times the size tried, or its part, up to which expected gains are tested; at so many sizes


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
        self._channel = np.concatenate([opening.astype(np.int64), 2 + best.fitter.model.observations.plate.kind])
        self._loss = robust_loss(self._z, self._whitener.odds)
        self._beside = self._whitener.white_slopes(best.bare, best.raw)
        folds = np.array([fold[self._state.step] for fold in best.fitter.folds])
        self._weights = np.array([self._weight, *np.where(folds, 0.0, self._weight)])  # of all, and without a fold each
        self._covariances: dict[bytes, list[Floats]] = {}

    def limit(self, key: ParameterId) -> float:
        """Smallest detectable size of a parameter, in its own unit; infinite where it changes nothing.

        The parameter's own prior is left out; all others stay free. A calibration needs no gain on steps left out: what
        tells it from the others is what the profile states of them, and that is known beside any step.
        """
        q, (x, low, high) = parameter_of(key), self._axis(key)
        most, multiple = max(high - x, x - low), math.inf
        size, hidden, shown = min(1.0, most), 0.0, math.inf  # the largest size that is not named, the smallest that is
        slope = self._moved(key, size, self.best.x) / size
        # the change is not proportional to the size: each turn takes it at the size that the one before has found
        for turn in range(TURNS):
            slope, multiple = self.turn(key, size, slope)
            if turn > 0:  # the first one only guesses what calibrations do
                hidden, shown = (max(hidden, size), shown) if multiple > 1.0 else (hidden, min(shown, size))
            if abs(multiple - 1.0) < SETTLED or shown < (1.0 + SETTLED) * hidden or hidden == most:
                break
            further = size * min(multiple, FARTHEST)
            # calibrations that meet their bounds hide it no farther: from there on it shows all at once
            size = min(further if hidden < further < shown else math.sqrt(hidden * shown), most)
        found = size * multiple if abs(multiple - 1.0) < SETTLED else shown
        return float((found * scale_of(key)) ** q.power) if found <= most else math.inf

    def turn(self, key: ParameterId, size: float, slope: Floats) -> tuple[Floats, float]:
        """Change of whitened residuals (r,) per unit of a size, in coordinates, and its multiple that would be named.

        It is taken where calibrations have followed what ``slope`` promises, the change of a size near it, less what
        they have done by their derivatives: what they hide to first order they mostly hide to second.
        """
        others, (_, low, high) = np.array([k != key for k in self.best.keys]), self._axis(key)
        beside = np.clip(self.best.x - self._followed(others, size * slope, 0), self._state.low, self._state.high)
        slope = (self._moved(key, size, beside) - self._beside @ (beside - self.best.x)) / size
        return slope, self._multiple(key, others, slope, size, high - low)

    def _axis(self, key: ParameterId) -> tuple[float, float, float]:
        """Coordinate of a parameter in the fit, and its bounds."""
        q = parameter_of(key)
        x = coordinate_of(key, self.best.values.get(key, null_value_of(key)))
        return x, coordinate_of(key, q.low), coordinate_of(key, q.high)

    def _moved(self, key: ParameterId, size: float, beside: Floats) -> Floats:
        """Change of the whitened residuals by a size to the farther bound, at coordinates of what is fitted, (q,)."""
        fitter, raw, (x, low, high) = self.best.fitter, self.best.raw, self._axis(key)
        there = np.array([x + size if high - x >= x - low else x - size])
        values = {**fitter.values(self.best.keys, beside), **fitter.values((key,), there)}
        wanted = fitter.train[fitter.model.observations.measured.step]  # no other steps count
        there = self._whitener.stacked(fitter.model.residuals(values, wanted=wanted))
        change = of_same_events(there - raw, self._whitener)
        return np.asarray(self._whitener.white_slopes(change[:, None], raw)[:, 0])

    def _multiple(self, key: ParameterId, others: Bools, slope: Floats, tried: float, reach: float) -> float:
        """By what the size tried has to be multiplied to be named; ``slope`` is the change per unit of it."""
        follow = self._followed(others, slope, 0)
        paid, left = self._state.inverse * follow, slope - self._beside @ follow
        pulled = float(paid @ paid)
        signal, lost = self._left_out(others, slope, reach)

        def named(multiple: float) -> bool:
            size = tried * multiple
            gain, weakened = self._gain(size * left)
            # named, the size saves the priors what calibrations would pay to follow it
            if gain + 0.5 * size**2 * pulled < self.limits.gain_nats:
                return False
            if key in self.best.fitter.priors:
                return True
            train = self.best.fitter.train
            won, lose = (_sums(self._state.step, x, len(train)) for x in (size**2 * signal * weakened, lost))
            return LogScoreDifference.of(won, lose, train).exceeds(*required_gain(len(self.best.free), self.limits))

        if not named(1.0):
            above = (m for m in np.geomspace(1.0, FARTHEST, COARSE)[1:] if named(m))
            high = next(above, math.inf)
        else:
            below = (m for m in np.geomspace(1.0, 1.0 / FARTHEST, COARSE)[1:] if not named(m))
            high = next(below, 1.0 / FARTHEST) * FARTHEST ** (1.0 / (COARSE - 1))
        low = high / FARTHEST ** (1.0 / (COARSE - 1))
        while math.isfinite(high) and high > (1.0 + 0.3 * SETTLED) * low:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if named(middle) else (middle, high)
        return high

    def _gain(self, change: Floats) -> tuple[float, Floats]:
        """Expected gain of a change of whitened residuals, nats, and by what it is below a square law, (r,).

        Large residuals weigh less, and where a channel's own scatter is estimated, what is not named is taken for
        scatter: of ``n`` normal residuals a gain of ``g`` at known scatter is ``n / 2 log(1 + 2 g / n)``.
        """
        square = 0.5 * self._weight * change**2
        z, odds, seen = self._z, self._whitener.odds, self._state.mask
        gain = 0.5 * (robust_loss(z + change, odds) + robust_loss(z - change, odds)) - self._loss
        m = int(self._channel.max(initial=-1)) + 1
        known, whole, n = (_sums(self._channel, np.where(seen, x, 0.0), m) for x in (gain, square, np.ones(len(z))))
        of = 0.5 * n * np.log1p(np.maximum(2.0 * known / np.maximum(n, 1.0), 0.0))
        part = np.divide(of, whole, out=np.zeros(m), where=whole > 0.0)
        return float(of.sum()), part[self._channel]

    def _left_out(self, others: Bools, slope: Floats, reach: float) -> tuple[Floats, Floats]:
        """What each residual gains by a unit of the size where it is left out, and loses by its uncertainty, (r,) nats.

        Without the size, a fit to the other steps is off by what calibrations cannot follow; with it, by the error of
        the size found there, at most ``reach``.
        """
        signal, lost = np.zeros(len(slope)), np.zeros(len(slope))
        for i, fold in enumerate(self.best.fitter.folds, start=1):
            held = fold[self._state.step]
            bias = slope - self._beside @ self._followed(others, slope, i)
            # the range bounds the size as a prior of that width does
            known = float(slope @ (self._weights[i] * bias)) + reach**-2.0
            signal[held] = (0.5 * self._weight * bias**2)[held]
            lost[held] = signal[held] / known
        return signal, lost

    def _followed(self, others: Bools, values: Floats, part: int) -> Floats:
        """Coefficients of ``others`` in a fit to ``values``, (q,), with priors about zero.

        ``part`` is 0 for all steps, else the number of the fold left out.
        """
        if (key := others.tobytes()) not in self._covariances:
            beside, stiffness = self._beside * others, np.where(others, self._state.inverse**2, 1.0)
            normals = [(beside * w[:, None]).T @ beside + np.diag(stiffness) for w in self._weights]
            inverses = (pinv(normal, rcond=1e-14, hermitian=True) for normal in normals)
            self._covariances[key] = [others[:, None] * np.asarray(x) * others for x in inverses]
        return np.asarray(self._covariances[key][part] @ (self._beside.T @ (self._weights[part] * values)))


def _sums(place: Integers, values: Floats, count: int) -> Floats:
    return np.asarray(np.bincount(place, values, minlength=count), dtype=np.float64)


def detection_limits(best: Hypothesis, limits: Thresholds) -> tuple[dict[str, float], tuple[str, ...]]:
    """Detection limits by ``effect.parameter``, and the effects that no size would show.

    The limit is the smallest size whose expected gains pass the tests of a verdict, with calibrations and nuisances
    free (`Detectability`).
    """
    fitted, detectability = best.fitted, Detectability(best.fitted, limits)
    sizes: dict[str, float] = {}
    unidentifiable: list[str] = []
    for entry in registry():
        e = entry.effect
        if e.nuisance or not e.library or not entry.hooks:
            continue
        shown = []
        for q in e.parameters:
            key = (e.name, q.name)
            if q.is_shape or key in fitted.free:
                continue
            size = detectability.limit(key)
            if size < q.high - q.low:
                shown.append(q.name)
                sizes[f"{e.name}.{q.name}"] = size
        if not shown and not any(k[0] == e.name for k in fitted.free):
            unidentifiable.append(e.name)
    return sizes, tuple(unidentifiable)
