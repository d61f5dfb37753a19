"""Explanations of what was recorded so far, each with its probability and the size that it would have.

Every candidate of the library is one effect more than the best set found; its size has a normal prior as wide as the
size at which it would matter. The log likelihood is taken to second order about the best fit (finite differences of
whitened residuals, robust weights fixed), so that probability and size follow from one set of derivatives; summaries of
many runs are made of it as well. What is fitted with a size goes with it: an explanation contradicts no recording that
is there already.

References
----------
P. J. Huber, Proc. 5th Berkeley Symp. 1, 221 (1967): variance of an estimator whose likelihood is not the noise's own.
R. E. Chandler and S. Bate, Biometrika 94, 167 (2007): a log likelihood adjusted to that variance.
D. J. C. MacKay, Neural Comput. 4, 415 (1992): observations of linear models with normal priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.attribution.candidates import candidates_of, coordinate_of, null_value_of, parameter_of
from analysis.attribution.chance import Place
from analysis.attribution.fit import Fitter, of_same_events
from analysis.attribution.hypothesis import Hypothesis
from analysis.linear_algebra import inv, lstsq, slogdet
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import robust_curvature, robust_weight
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import ParameterId, Values
from analysis.thresholds import IMPROBABLE
from kernels.arrays import Floats, Integers

STEP = 0.01  # finite difference of a coordinate
LARGEST_STEP = 1.0  # secant of a coordinate
STUDENT = 0.75  # mean square slope of the robust loss, and mean curvature, where residuals are Student's own


def slopes_at(
    model: ForwardModel, fitter: Fitter, whitener: Whitener, at: Values, places: Sequence[Place], step: float = STEP,
    raw: Floats | None = None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Bare residuals at the values ``at``, (r,), and derivatives to coordinates, each at its place's shapes, (r, K).

    ``step`` is that of the finite differences; ``raw`` are the residuals where they are known.
    """
    raw = whitener.stacked(model.residuals(dict(at))) if raw is None else raw
    out = np.zeros((len(raw), len(places)))
    origins: dict[tuple[tuple[ParameterId, float], ...], Floats] = {(): raw}  # residuals where derivatives begin
    for j, (key, shapes) in enumerate(places):
        base = {key: null_value_of(key), **at, **dict(shapes)}
        if shapes not in origins:
            names = {name for (name, _), _ in shapes}
            # shapes change nothing as long as the sizes of their effects are zero
            idle = all(x == null_value_of(k) for k, x in at.items() if k[0] in names)
            origins[shapes] = raw if idle else whitener.stacked(model.residuals(base))
        x = coordinate_of(key, base[key])
        low, high = fitter.bounds(key, released=True)
        h = step if x + step <= high or x - step < low else -step
        there = whitener.stacked(model.residuals({**base, **fitter.values((key,), np.array([x + h]))}))
        out[:, j] = of_same_events(there - origins[shapes], whitener) / h
    return raw, out


def secants_at(
    model: ForwardModel, fitter: Fitter, whitener: Whitener, at: Values, places: Sequence[Place], raw: Floats,
    slopes: Floats,
) -> Floats:  # fmt: skip
    """Derivatives, (r, K), with secants for what can only grow from where it is.

    A size that begins at nothing is told by what it does at a size that the run resolves: one standard deviation by
    itself, all else known. A pull at take-off, for one, does nothing to first order where the contact opens late.
    """
    out = slopes.copy()
    for j, (key, shapes) in enumerate(places):
        x = coordinate_of(key, at.get(key, null_value_of(key)))
        low, high = fitter.bounds(key, released=True)
        # what can move both ways has a derivative
        if low < x < high:
            continue
        known = float(np.sum(whitener.white_slopes(slopes[:, [j]], raw) ** 2))
        step = min(max(known**-0.5, STEP), LARGEST_STEP) if known > 0.0 else LARGEST_STEP
        out[:, [j]] = slopes_at(model, fitter, whitener, at, [(key, shapes)], step, raw)[1]
    return out


def gradient_and_information(whitener: Whitener, raw: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """Slope and negative curvature of the log likelihood, (K,) and (K, K), from bare residuals and derivatives."""
    z, jacobian = whitener.white_all(raw), whitener.white_slopes(slopes, raw)
    weighted = jacobian * robust_weight(z, whitener.odds)[:, None]
    information = weighted.T @ jacobian
    return -(weighted.T @ z), 0.5 * (information + information.T)


def adjusted_gradient_and_information(whitener: Whitener, raw: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """As `gradient_and_information`, of a log likelihood that is as sharp as the residuals scatter.

    The weights of a least-squares step are no curvature: for normal residuals they are 1.04 in the mean, the curvature
    of the robust loss is 0.81, and the mean square of its slope 0.69. One step with them covers three quarters of the
    way. Here curvature ``B`` and mean square slope ``A`` are measured, of events and of plate data: slopes times
    ``B / A``, curvature ``B^2 / A`` (the inverse of Huber's variance).
    """
    z, jacobian = whitener.white_all(raw), whitener.white_slopes(slopes, raw)
    score = robust_weight(z, whitener.odds) * z
    curvature = robust_curvature(z, whitener.odds)
    gradient, information = np.zeros(jacobian.shape[1]), np.zeros((jacobian.shape[1],) * 2)
    events = np.arange(len(z)) < len(whitener.step)
    for rows in (events, ~events):
        square, bend = STUDENT, STUDENT
        # fewer than twenty residuals say nothing of their own scatter
        if rows.sum() >= 20:
            # a mean curvature below a quarter, where outliers rule, would raise the width without bound
            square, bend = float(np.mean(score[rows] ** 2)), max(float(np.mean(curvature[rows])), 0.25)
        gradient -= bend / square * (jacobian[rows].T @ score[rows])
        information += bend**2 / square * (jacobian[rows].T @ jacobian[rows])
    return gradient, 0.5 * (information + information.T)


@dataclass(frozen=True)
class Explanation:
    """One way to explain what was recorded."""

    names: tuple[str, ...]  # effects beyond the declared ones
    free: tuple[ParameterId, ...]  # their parameters
    values: Values  # parameter values, calibrations included
    probability: float  # given the recordings so far; all sum to one


@dataclass(frozen=True)
class Weighed:
    """Explanations, and what the recordings so far tell about every parameter that any of them has."""

    explanations: tuple[Explanation, ...]  # the most probable first
    # calibrations and nuisances first (``shared`` of them), then what explanations free; K in all
    keys: tuple[ParameterId, ...]
    shared: int
    information: Floats  # of the coordinates of ``keys`` from the recordings, without priors, (K, K)
    stiffness: Floats  # what the calibrations tell about them, one over their variances, (K,); 0 for what has none

    def known_under(self, x: Explanation) -> tuple[Integers, Floats]:
        """Places in ``keys`` of what ``x`` leaves open, and the information on them: it frees its own calibrations."""
        rows = np.array([i for i, key in enumerate(self.keys) if i < self.shared or key in x.free], dtype=np.int64)
        own = np.array([self.keys[i] in x.free for i in rows], dtype=bool)
        return rows, self.information[np.ix_(rows, rows)] + np.diag(np.where(own, 0.0, self.stiffness[rows]))

    def among(self, names: Sequence[tuple[str, ...]]) -> Weighed:
        """The same with the explanations ``names`` only, where the others are not in question."""
        some = [x for x in self.explanations if x.names in names]
        total = sum(x.probability for x in some)
        return replace(self, explanations=tuple(replace(x, probability=x.probability / total) for x in some))


def weighed(model: ForwardModel, fitter: Fitter, best: Hypothesis, ties: Sequence[Hypothesis] = ()) -> Weighed:
    """Explanations of the observations of ``model``, weighed.

    ``best`` is the best set so far (the declared model where nothing was found); ``ties`` are other sets that the data
    do not distinguish from it, and share its probability.
    """
    library = [c for c in candidates_of(model) if not set(c.names) & set(best.names) and len(c.names) == 1]
    # candidates begin with their shapes at the first start, their sizes at nothing
    begin = {
        k: start.get(k, null_value_of(k)) if parameter_of(k).is_shape else null_value_of(k)
        for c in library
        for start in c.starts[:1] or ({},)
        for k in c.free
    }
    at = {**begin, **best.fitted.values}
    sizes = [tuple(k for k in c.free if not parameter_of(k).is_shape) for c in library]
    shared = tuple(dict.fromkeys((*fitter.priors, *best.free)))
    keys = tuple(dict.fromkeys((*shared, *(k for own in sizes for k in own))))
    raw, slopes = slopes_at(model, fitter, best.whitener, at, [(key, ()) for key in keys])
    gradient, information = gradient_and_information(best.whitener, raw, slopes)
    stated, sharpness = fitter.prior_rows(keys)
    stiffness = sharpness**2
    fit = _Fit(
        information,
        gradient,
        stiffness=np.where([k in best.free for k in keys], 0.0, stiffness),
        off=np.where(sharpness > 0.0, [coordinate_of(k, at[k]) - x for k, x in zip(keys, stated, strict=True)], 0.0),
        shared=len(shared),
    )
    logs, found = [0.0], [Explanation(best.names, best.free, best.fitted.values, 0.0)]
    for candidate, own in zip(library, sizes, strict=True):
        nulls = np.array([coordinate_of(k, null_value_of(k)) for k in own])
        x = np.array([coordinate_of(k, at.get(k, null_value_of(k))) for k in own])
        places = np.array([keys.index(k) for k in own], dtype=np.int64)
        log, mean, deviation = fit.observations(places, x - nulls)
        moved = _within(fitter, own, x + mean + np.where(mean < 0.0, -1.0, 1.0) * deviation)
        rest = [k for k in shared if k not in own]
        others = np.array([coordinate_of(k, at.get(k, null_value_of(k))) for k in rest])
        others = _within(fitter, rest, others - fit.follow(places) @ (moved - x))
        values = {**at, **fitter.values(rest, others), **fitter.values(own, moved)}
        logs.append(log)
        found.append(Explanation((*best.names, *candidate.names), (*best.free, *candidate.free), values, 0.0))
    for rival in ties:
        if rival.names != best.names:
            logs.append(0.0)
            found.append(Explanation(rival.names, rival.free, rival.fitted.values, 0.0))
    return Weighed(_normalised(found, np.array(logs)), keys, len(shared), information, stiffness)


def _within(fitter: Fitter, keys: Sequence[ParameterId], x: Floats) -> Floats:
    """Coordinates of ``keys``, none beyond its bounds."""
    bounds = np.array([fitter.bounds(k, released=True) for k in keys]).reshape(-1, 2)
    return np.clip(x, bounds[:, 0], bounds[:, 1])


@dataclass(frozen=True)
class _Fit:
    """The linear model around a fit of K coordinates."""

    information: Floats  # of the data, (K, K)
    gradient: Floats  # of the data, (K,)
    stiffness: Floats  # one over the variance of each calibration that the fit holds to, (K,)
    off: Floats  # its distance from what is stated, (K,)
    shared: int  # how many of the coordinates the fit varies; they come first

    def _others(self, own: Integers) -> Integers:
        """Places of what the fit varies other than ``own``."""
        return np.setdiff1d(np.arange(self.shared), own)

    def follow(self, own: Integers) -> Floats:
        """By how much each other coordinate that the fit varies goes back when one of ``own`` goes up by one."""
        shared = self._others(own)
        inner = self.information[np.ix_(shared, shared)] + np.diag(self.stiffness[shared])
        return np.asarray(lstsq(inner, self.information[np.ix_(shared, own)], rcond=1e-12)[0])

    def observations(self, own: Integers, at: Floats) -> tuple[float, Floats, Floats]:
        """Log evidence of freeing ``own`` over not freeing it, and how far its coordinates then move, and deviations.

        Each has a normal prior of one unit, the size that matters, around nothing; the fit has it ``at`` so much. A
        calibration that is freed no longer has its own prior. A fit leaves a gradient of its own precision; what is
        shared follows it first, else a candidate that it nearly replaces would seem to explain it.
        """
        shared, follow = self._others(own), self.follow(own)
        cross = self.information[np.ix_(shared, own)]
        profiled = self.information[np.ix_(own, own)] - cross.T @ follow
        score = self.gradient[own] - follow.T @ (self.gradient - self.stiffness * self.off)[shared]
        held = own < self.shared  # calibrations that the fit varies, too, by their own priors
        places = own[held]
        before = _log_evidence(profiled[np.ix_(held, held)], score[held], self.stiffness[places], self.off[places])
        after = _log_evidence(profiled, score, np.ones(len(own)), at)
        return after[0] - before[0], after[1], after[2]


def _log_evidence(information: Floats, score: Floats, precision: Floats, off: Floats) -> tuple[float, Floats, Floats]:
    """Log evidence of a linear model with normal priors ``off`` from here, and mean and deviation of its coordinates.

    MacKay (1992), equation 2.5; without the factor that all models of the same data share.
    """
    known = 0.5 * (information + information.T) + np.diag(precision)
    pull = score - precision * off
    covariance = inv(known)
    mean = covariance @ pull
    log = pull @ mean - slogdet(known)[1] + np.sum(np.log(precision)) - np.sum(precision * off**2)
    return 0.5 * float(log), mean, np.sqrt(np.diag(covariance))


def _normalised(found: Sequence[Explanation], logs: Floats) -> tuple[Explanation, ...]:
    """With probabilities, of one effect's variants only the likeliest, the most probable first."""
    best: dict[tuple[str, ...], int] = {}
    for i, x in enumerate(found):
        if x.names not in best or logs[i] > logs[best[x.names]]:
            best[x.names] = i
    likeliest = sorted(best.values(), key=lambda i: -logs[i])
    weights = np.exp(logs[likeliest] - np.max(logs[likeliest]))
    weights /= weights.sum()
    chosen = [(found[i], float(w)) for i, w in zip(likeliest, weights, strict=True) if w > IMPROBABLE or i == 0]
    total = sum(w for _, w in chosen)
    return tuple(Explanation(x.names, x.free, x.values, w / total) for x, w in chosen)
