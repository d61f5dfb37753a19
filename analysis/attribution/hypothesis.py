"""Fitted hypotheses, how they are fitted alike, and the result of a selection among them.

The verdict's fit is led on along a valley, a direction in which parameters can hardly be told from each other. There a
damped step gains too little to go on, and an undamped one leaves the valley where it bends: each step is bent as the
residuals are (geodesic acceleration). Decision 593.

References
----------
M. K. Transtrum, J. P. Sethna, arXiv:1201.5885 (2012).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ParamSpec, TypeVar

import numpy as np

from analysis.attribution.candidates import Candidate, Prior, parameter_of, trends_of
from analysis.attribution.fit import LEAST_GAIN, Fitted, Fitter, damped_step, linear_gain, of_same_events
from analysis.linear_algebra import NotFiniteError
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import (
    goodness_of_fit,
    least_rms_standardised,
    plate_rms_standardised,
    rms_standardised,
)
from analysis.residuals.noise.noise_model import robust_loss, robust_weight
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.prediction_errors import held_out_errors, noise_floors_us, scored_rows
from analysis.residuals.values import ParameterId
from analysis.thresholds import CALIBRATION_SIGMAS, Thresholds
from kernels.arrays import Floats
from model.effects.registry import effect

P = ParamSpec("P")
T = TypeVar("T")
SETTLED = 0.2  # move of a free value in one more fit that still counts as none, in standard deviations
DAMPING = 1e-10  # along a valley
REACH = 0.1  # of a step, over which the curvature is taken
PARTS = (1.0, 0.5, 0.25, 0.125)
ODD, MOST_ODD = 1.2, 0.2  # loss of an event, nats (noise leaves .4), from which a step is odd; part of the steps


def _names(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """Names of all effects, each once, in order."""
    return tuple(dict.fromkeys(n for c in candidates for n in c.names))


@dataclass(frozen=True)
class Hypothesis:
    """A set of candidates, fitted and scored."""

    candidates: tuple[Candidate, ...]  # in the order in which they were added
    fitted: Fitted  # the joint fit
    whitener: Whitener  # uncertainties at the fitted point
    losses: Mapping[str, Floats]  # held-out loss by channel, (m,)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all effects, each once, in order."""
        return _names(self.candidates)

    @property
    def fitter(self) -> Fitter:
        """What it was fitted by."""
        return self.fitted.fitter

    @property
    def model(self) -> ForwardModel:
        """The forward model that it is a fit of."""
        return self.fitted.fitter.model

    @property
    def free(self) -> tuple[ParameterId, ...]:
        """All parameters that the candidates free."""
        return tuple(k for c in self.candidates for k in c.free)

    @property
    def numbers(self) -> int:
        """How many numbers its effects need: two that are one in the simplest case are one where they may agree."""
        number, x = len(self.free), self.fitted.x
        for name, (one, other) in [(n, q) for n in {n for n, _ in self.free} for q in effect(n).effect.tied.values()]:
            if (name, one) in self.free and (name, other) in self.free:
                i, j = self.fitted.keys.index((name, one)), self.fitted.keys.index((name, other))
                covariance = self.fitted.covariance()
                spread = covariance[i, i] + covariance[j, j] - 2.0 * covariance[i, j]
                number -= bool((x[i] - x[j]) ** 2 < 3.84 * spread)  # by 95 %
        return number

    @property
    def per_step(self) -> Floats:
        """Held-out loss of all channels, (m,)."""
        return np.asarray(sum(self.losses.values()))

    @functools.cached_property
    def level(self) -> float:
        """Loss of the fit on the training steps, each channel's excess noise at its best."""
        return Refits(self.fitter).profile_loss(self.whitener, self.fitted.values)

    @property
    def strained(self) -> bool:
        """Whether a calibration is as far off as it may be: it may play a cause that is not named."""
        return bool(self.fitted.moved_calibrations(0.99 * CALIBRATION_SIGMAS))

    def noise_like(self, ratio: float, plate_ratio: float | None = None) -> bool:
        """Whether flights and plate data leave residuals below ``ratio`` times their uncertainty, rms.

        ``plate_ratio`` is that of plate data where it is another.
        """
        model, values = self.model, self.fitted.values
        if plate_rms_standardised(model, values) >= (plate_ratio or ratio):
            return False
        u = uncertainty_at(model, values)
        return least_rms_standardised(model, values, u) < ratio and rms_standardised(model, values, u) < ratio

    def passes(self, limits: Thresholds) -> bool:
        """Whether what it leaves passes the verdict's tests of flights, plate data and landings, on all steps."""
        if self.noise_like(limits.lack_ratio, limits.plate_rms_z):
            return True
        model, values = self.model, self.fitted.values
        left = goodness_of_fit(model, values, limits)
        if not (left.flights_pass(limits) and left.plate_passes(limits)):
            return False
        rows, excluded = scored_rows(model, values, np.ones(len(model.observations.steps), dtype=np.bool_))
        missed = held_out_errors(model, values, rows, excluded).landing_rms_us
        return missed <= limits.most_rms_us(noise_floors_us(model, values, rows)[0])


class Refits:
    """Fits of hypotheses, all with weights iterated in the same way.

    Parameters
    ----------
    fitter
        Of the model, its priors and its training steps.
    anew
        Whether weights are made anew at each point; else of what has hardly changed they take over what was near.

    Attributes
    ----------
    failed
        By the names of a set of effects, why its fit failed.
    """

    def __init__(self, fitter: Fitter, *, anew: bool = True) -> None:
        self.fitter, self.model, self.train, self.anew = fitter, fitter.model, fitter.train, anew
        self.plate_noise = self.model.observations.plate.noise(self.train)
        self.failed: dict[tuple[str, ...], str] = {}

    def attempted(
        self, chosen: Sequence[Candidate], fit: Callable[P, T | None], *args: P.args, **options: P.kwargs
    ) -> T | None:
        """The fit of ``chosen``, called with the rest; None where it is not finite: `failed` says why."""
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # a plate mode may diverge
                return fit(*args, **options)
        except NotFiniteError as error:
            self.failed[_names(chosen)] = str(error)
            return None

    def weights(self, values: Mapping[ParameterId, float], near: Whitener) -> Whitener:
        """The weights at ``values``."""
        return Whitener.of(self.model, values, None if self.anew else near)

    def profile_loss(self, whitener: Whitener, values: Mapping[ParameterId, float]) -> float:
        """Loss at ``values`` on the training steps, each channel's excess noise at its best."""
        seen = self.model.residuals(values, wanted=self.fitter.events)
        return whitener.profile_loss(seen, self.train, self.plate_noise)

    def scored(self, candidates: tuple[Candidate, ...], fitted: Fitted) -> Hypothesis:
        """The hypothesis with its held-out loss, at the weights of its own fit."""
        whitener = self.weights(fitted.values, fitted.state.whitener)
        return Hypothesis(candidates, fitted, whitener, fitted.held_out(whitener))

    def reweighted(self, fitted: Fitted) -> Fitted:
        """The fit repeated with the weights of the point found, until they converge.

        Derivatives by calibrations are taken anew once: weights move a fit by less than would change them.
        """
        known = None
        # weights depend on the fit and the fit on the weights: four turns, or until the loss stands still
        for _ in range(4):
            before = fitted.state.whitener
            after = self.weights(fitted.values, before)
            if after.near(before):
                break
            fitted = self.fitter.fit(after, fitted.free, fitted.values, known)
            known = {k: x for k, x in fitted.slopes.items() if k not in fitted.free}
        return fitted

    def converged(
        self,
        candidates: tuple[Candidate, ...],
        whitener: Whitener,
        free: Sequence[ParameterId],
        start: Mapping[ParameterId, float],
    ) -> Hypothesis:
        """The hypothesis fitted from ``start``, first with the weights given, until they converge."""
        return self.scored(candidates, self.reweighted(self.fitter.fit(whitener, free, start)))

    def again(self, x: Hypothesis) -> Hypothesis:
        """The hypothesis fitted once more from where it stands: derivatives of calibrations are those of the start.

        Where a calibration and an effect are correlated, a fit from afar stops short with too small an error.
        """
        return self.converged(x.candidates, x.whitener, x.free, x.fitted.values)

    def _past_odd_steps(self, x: Hypothesis) -> Hypothesis:
        """The hypothesis fitted from where the other steps lead, where a few steps cost far more than noise would.

        Where flights graze, they leap between minima: a step of them can hold a fit that all others would lead on.
        """
        step = x.whitener.step
        z, odds = x.whitener.white_all(x.fitted.raw)[: len(step)], x.whitener.odds[: len(step)]
        lost, events = (np.bincount(step, v, len(self.train)) for v in (robust_loss(z, odds), np.ones(len(step))))
        odd = self.train & (lost > ODD * events)
        if not 0 < odd.sum() <= MOST_ODD * self.train.sum():
            return x
        without = Fitter(self.model, self.fitter.priors, self.train & ~odd).fit
        led = self.attempted(x.candidates, without, x.whitener, x.free, x.fitted.values)
        if led is None:
            return x
        # with their weights: by those of the place that was left, a step to the bottom leads back there
        weights = self.weights(led.values, x.whitener)
        back = self.attempted(x.candidates, self.converged, x.candidates, weights, x.free, led.values)
        if back is None or float((back.per_step - x.per_step)[self.train].sum()) > -LEAST_GAIN:
            return x
        return back

    def _past_flat_shapes(self, x: Hypothesis) -> Hypothesis:
        """The hypothesis fitted from where its shapes may begin as well; the best, one away from bounds if it ties.

        Far off, a shape changes so little that a fit stops there, and seems to know the sizes: over the heights of
        short flights a magnet of any long range is a constant pull with a spring that takes from another one.
        """
        for shape in [k for k in x.free if parameter_of(k).is_shape and not parameter_of(k).hint]:
            q, fits = parameter_of(shape), [x]
            for at in q.start_grid if q.low > 0.0 else ():
                start = {**x.fitted.values, shape: at}
                y = self.attempted(x.candidates, self.converged, x.candidates, x.whitener, x.free, start)
                fits += [] if y is None else [y]
            held = [1.92 * (y.fitted.values[shape] in (q.low, q.high)) for y in fits]  # nats, what 95 % allow
            losses = [self.profile_loss(x.whitener, y.fitted.values) for y in fits]
            x = fits[int(np.argmin(np.add(losses, held)))]
        return x

    def settled(self, x: Hypothesis) -> Hypothesis:
        """The hypothesis fitted again until no free value moves by more than a part of its standard deviation."""

        def lowest(x: Hypothesis) -> Hypothesis:  # led on where a fit would end above the bottom of a valley
            fitted = to_the_bottom(self.fitter.fit(x.whitener, x.free, x.fitted.values))
            return self.scored(x.candidates, self.reweighted(fitted))

        x = self._past_flat_shapes(self._past_odd_steps(x)) if x.free else x
        for _ in range(4):
            if not x.free:
                break
            y = self.attempted(x.candidates, lowest, x)
            if y is None:
                break
            moved = max(abs(y.fitted.values[k] - x.fitted.values[k]) / (y.fitted.sigma(k) or math.inf) for k in x.free)
            x = y
            if moved < SETTLED:
                break
        return x


def with_hidden_free(x: Hypothesis) -> Hypothesis:
    """The hypothesis fitted once more, what its effects can hide free within a prior: its intervals then allow for it.

    A high-pass makes an accelerometer's phase early, a low-pass late. At one frequency only their sum can be seen, and
    the weaker one gains nothing that would have it named.
    """
    fitter, model = x.fitter, x.model
    hidden = {
        key: Prior(*known)
        for name in x.names
        for key, known in effect(name).effect.hides.items()
        if key[0] not in x.names and key not in fitter.priors and key not in model.base
    }
    if not hidden:
        return x
    refits = Refits(Fitter(model, {**fitter.priors, **hidden}, fitter.train))
    return refits.attempted(x.candidates, refits.again, x) or x


def to_the_bottom(fitted: Fitted) -> Fitted:
    """The fit where no step gains more than `LEAST_GAIN` any more, by slopes of all parameters taken anew."""
    state = fitted.state
    for _ in range(12):
        normal, gradient = fitted.normal(state.mask)
        step = damped_step(normal, gradient, DAMPING, state.low - fitted.x, state.high - fitted.x)
        if linear_gain(normal, gradient, step) < LEAST_GAIN:
            break
        bare = np.zeros_like(fitted.bare)
        state.fill(bare, fitted.x, fitted.raw, range(len(fitted.x)))
        fitted = replace(fitted, bare=bare)
        further = _further(fitted)
        if further is None:
            break
        fitted = further
    return fitted


def _further(fitted: Fitted) -> Fitted | None:
    """The fit after one bent step, or a part of it; None where nothing gains."""
    state, here = fitted.state, fitted.x
    low, high = state.low - here, state.high - here
    normal, gradient = fitted.normal(state.mask)
    step = damped_step(normal, gradient, DAMPING, low, high)
    change = state.raw(here + REACH * step) - fitted.raw
    same = (change == of_same_events(change, state.whitener)) & ~state.leaping
    curved = np.where(same, 2.0 / REACH * (change / REACH - fitted.bare @ step), 0.0)
    white = state.whitener
    jacobian = white.white_slopes(np.column_stack([fitted.bare, curved]), fitted.raw)
    weight = np.where(state.mask, robust_weight(white.white_all(fitted.raw), white.odds), 0.0)
    bend = damped_step(normal, -(jacobian[:, :-1].T @ (weight * jacobian[:, -1])), DAMPING, low - step, high - step)
    for part in PARTS:
        x = np.clip(here + part * step + 0.5 * part**2 * bend, state.low, state.high)
        raw = state.raw(x)
        loss = state.loss(raw, x)
        if loss < fitted.loss:
            return replace(fitted, x=x, raw=raw, loss=loss)
    return None


@dataclass(frozen=True)
class Rejected:
    """A candidate that gained and was refused."""

    names: tuple[str, ...]  # effects that it would have added
    gain: float  # held-out gain over what it was added to, nats
    error: float  # its standard error, nats
    reason: str  # what forbade it, in words


@dataclass(frozen=True)
class ChanceTest:
    """The best candidate of a round, held against what the best of all gains by chance."""

    names: tuple[str, ...]  # effects that it adds
    gain: float  # its gain on the steps of the fit, nats
    p: float  # probability that the best of all candidates gains so much by chance
    critical: float  # gain that chance exceeds with the probability of the threshold, nats
    accepted: bool  # whether it was added


@dataclass(frozen=True)
class Scatter:
    """Standard deviation of the restitution from impact to impact, its own standard deviation, and its gain in nats
    over uncertainties of another size and over one excess noise of all landings after rebounds."""

    sd: float
    sigma: float
    gain: float

    def is_clear(self, limits: Thresholds) -> bool:
        """Whether it is beyond doubt, as a further cause has to be."""
        return self.gain > limits.next_effect_nats and self.sd > limits.next_effect_sigmas * self.sigma


def remaining_candidates(pool: Sequence[Candidate], best: Hypothesis, without: Sequence[str] = ()) -> list[Candidate]:
    """Candidates not named yet nor ``without``, fuller forms of those that are, and trends of what is free."""
    taken, names = set(best.free), set(best.names)
    own = {name: {k for k in taken if k[0] == name} for name in names}
    more = [
        c
        for c in pool
        if not set(c.names) & names or (len(c.names) == 1 and own[c.names[0]] and own[c.names[0]] < set(c.free))
    ]
    return [c for c in more if not set(c.names) & set(without)] + trends_of(best.free)
