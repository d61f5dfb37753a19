"""Model selection for impact times: held-out bounces, the tie set, lack of fit, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.laws.bouncelaw import CONSTANT, FRICTION, MODELS, BounceModel
from analysis.drop.laws.choice import UNEXPLAINED, choose, stable_choice
from analysis.drop.times.lack_of_fit import lack_of_fit
from analysis.drop.times.model_fit import Fit, converge, fit, sensitivities, step, usable_rows, wider
from analysis.drop.times.one_ahead import Drop, Rows, Widths, noise_of, predict_s

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ENOUGH_DROPS = 4
_SIMPLE = 2  # parameters
_MOST_FOLDS = 8
_LEAST_ROWS = 5  # fewer bounces than this leave nothing to hold out
_LEAST_TRIMMED = 7  # rows, of which one may be left out at an end


@dataclass(frozen=True)
class Judged:
    """A model, fitted and tried on bounces it did not see.

    Attributes
    ----------
    fit : Fit
    rms_s, held_out_rms_s : float
        Of the flight durations predicted from flights, in sample and held out (NaN where nothing could be held out).
    scores : (units,) float64
        Held-out log likelihood of each drop (or bounce, where there are few drops).
    identifiable : bool
        False where another model with fewer parameters predicts exactly the same times.
    drag_limits : (low, high), 1/m
        Between which the drag of this ball must lie by its mass and size.
    """

    fit: Fit
    rms_s: float
    held_out_rms_s: float
    scores: Array
    identifiable: bool = True
    drag_limits: tuple[float, float] = (0.0, np.inf)

    @property
    def model(self) -> BounceModel:
        """Name and parameters."""
        return self.fit.model

    @property
    def significant(self) -> bool:
        """Whether the interval of every parameter beside ``e0`` excludes zero, and a drag is one this ball can have."""
        half = self.fit.half_width()
        return bool(np.all(np.abs(self.fit.theta[1:]) > half[1:])) and self.physical

    @property
    def physical(self) -> bool:
        """Whether the interval of the drag reaches what mass and size allow."""
        if "k_per_m" not in self.model.parameters:
            return True
        j = self.model.parameters.index("k_per_m")
        k, half = float(self.fit.theta[j]), float(self.fit.half_width()[j])
        return k + half >= self.drag_limits[0] and k - half <= self.drag_limits[1]


@dataclass(frozen=True)
class Verdict:
    """The models judged.

    Attributes
    ----------
    candidates : tuple of Judged
        In the order of `MODELS`.
    chosen : str
        A model's name, or "unexplained".
    best : str
        The model that describes the data best: the chosen one, where there is one.
    tie_set : tuple of str
        Models that the data cannot tell apart, the best first.
    left_out : (drops,) int64
        Irregular bounces left out of each drop.
    doubts : tuple of str
        What no model accounts for, in words.
    """

    candidates: tuple[Judged, ...]
    chosen: str
    best: str
    tie_set: tuple[str, ...]
    left_out: NDArray[np.int64]
    doubts: tuple[str, ...] = ()

    def candidate(self, name: str) -> Judged:
        """The model called ``name``."""
        return next(r for r in self.candidates if r.fit.model.name == name)


def judge(
    drops: Sequence[Drop], g_mps2: float, rng: np.random.Generator, drag_limits: tuple[float, float] = (0.0, np.inf)
) -> Verdict:
    """Fit every candidate model to ``drops`` and choose among them.

    Parameters
    ----------
    drops
        Drops of one ball with one set-up.
    g_mps2
        Local gravity, m/s^2.
    rng
        For the bootstrap.
    drag_limits
        Smallest and largest ``k`` that the ball's mass and size allow, 1/m.
    """
    rows, left_out = usable_rows(drops, g_mps2)
    folds = _folds(rows)
    with_height = bool((rows.from_height & rows.valid).any())
    candidates: list[Judged] = []
    for model in MODELS:
        if model is FRICTION and not with_height:
            candidates.append(_same_times(candidates[0]))
        elif model is not CONSTANT and rows.count <= len(model.parameters):
            continue
        else:
            candidates.append(replace(_try(model, rows, folds, g_mps2, rng), drag_limits=drag_limits))
    able = [r for r in candidates if r.identifiable]
    choices = [choose(able)]
    choices += [choose([_again(r, part, g_mps2) for r in able]) for part in _trimmed(rows, len(folds))]
    ties = stable_choice(choices, MODELS)
    if not folds:  # nothing could be held out: nothing can be told
        simple = [model for model in MODELS if len(model.parameters) <= _SIMPLE]
        ties = tuple(model.name for model in simple if model is not FRICTION or with_height)
    best = next(r for r in candidates if r.model.name == ties[0])
    if best.model is CONSTANT and not with_height:
        ties = (*ties, FRICTION.name)  # friction shortens every flight by one factor, as a lower restitution does
    doubts = [*lack_of_fit(best.fit, rows, g_mps2), *_beyond_physics(able, best)]
    return Verdict(tuple(candidates), UNEXPLAINED if doubts else ties[0], ties[0], ties, left_out, tuple(doubts))


def _beyond_physics(models: Sequence[Judged], best: Judged) -> list[str]:
    """A drag that no ball of this mass and size has, but that the bounces call for all the same."""
    for rival in models:
        if not rival.physical and choose([best, replace(rival, drag_limits=(0.0, np.inf))])[0] == rival.model.name:
            k = float(rival.fit.theta[rival.model.parameters.index("k_per_m")])
            low, high = rival.drag_limits
            return [
                f"the bounces call for a drag of {k:.3g} /m; a sphere of this mass and size has {low:.2g} to {high:.2g}"
                " /m: something else takes the energy"
            ]
    return []


def _trimmed(rows: Rows, folds: int) -> list[Rows]:
    """The rows without the last, the last two, and the first of each drop, where single bounces decide."""
    if int(rows.valid.any(axis=1).sum()) >= _ENOUGH_DROPS or not folds:
        return []
    flights = rows.valid & ~rows.from_height
    if int(flights.sum()) < _LEAST_TRIMMED:
        return []
    behind = np.cumsum(flights[:, ::-1], axis=1)[:, ::-1]  # flights from here to the end
    return [rows.keep(~(flights & (behind <= 1))), rows.keep(~(flights & (behind <= 2))), rows.keep(~_first(flights))]


def _first(flights: Mask) -> Mask:
    return np.asarray(flights & (np.cumsum(flights, axis=1) == 1))


def _again(judged: Judged, rows: Rows, g_mps2: float) -> Judged:
    """The same model on other rows, with the widths that it has."""
    fit_, folds = judged.fit, _folds(rows)
    theta = converge(fit_.model, fit_.theta, rows, fit_.widths, g_mps2)
    covariance = step(fit_.model, theta, rows, fit_.widths, g_mps2).covariance
    covariance = wider(covariance, fit_.covariance)
    part = replace(fit_, theta=theta, covariance=covariance, freedom=rows.count - len(theta))
    scores, _ = _held_out(part, rows, folds, g_mps2)
    return replace(judged, fit=part, scores=scores)


def _same_times(constant: Judged) -> Judged:
    """Friction without a known height: the same times as a constant restitution, whatever the friction."""
    e = float(np.clip(constant.fit.theta[0], 0.0, 1.0))
    pad = np.append(constant.fit.theta, 0.0)
    most = (1.0 - e * e) / (1.0 + e * e)  # the friction at which the impact itself would have to be lossless
    draws = np.column_stack([constant.fit.draws, np.zeros(len(constant.fit.draws))])
    covariance = np.diag([constant.fit.covariance[0, 0], most**2 / 12.0])
    same = replace(constant.fit, model=FRICTION, theta=pad, covariance=covariance, draws=draws)
    return replace(constant, fit=same, identifiable=False)


def _folds(rows: Rows) -> list[NDArray[np.bool_]]:
    """Which rows each fold holds out: whole drops where there are enough, else every so many-th bounce."""
    with_data = np.flatnonzero(rows.valid.any(axis=1))
    fold_of = np.full(rows.valid.shape, -1)
    if len(with_data) >= _ENOUGH_DROPS:
        for k, d in enumerate(with_data):
            fold_of[d] = k % _MOST_FOLDS
    elif rows.count >= _LEAST_ROWS:
        fold_of[rows.valid] = np.arange(rows.count) % min(_MOST_FOLDS, rows.count)
    return [rows.valid & (fold_of == k) for k in range(int(fold_of.max()) + 1)]


def _try(model: BounceModel, rows: Rows, folds: Sequence[Mask], g_mps2: float, rng: np.random.Generator) -> Judged:
    whole = fit(model, rows, g_mps2, rng)
    scores, squares = _held_out(whole, rows, folds, g_mps2)
    rms = float(np.sqrt(np.nanmean(whole.residuals_s[~rows.from_height] ** 2)))
    return Judged(whole, rms, float(np.sqrt(squares.mean())) if len(squares) else float("nan"), scores)


def _held_out(whole: Fit, rows: Rows, folds: Sequence[Mask], g_mps2: float) -> tuple[Array, Array]:
    """Held-out log likelihood of each unit, and squared errors of the flights, s^2."""
    by_drop = bool(rows.valid.any(axis=1).sum() >= _ENOUGH_DROPS)
    model, widths = whole.model, whole.widths
    squares: list[Array] = []
    scores: list[Array] = []
    for held in folds:
        seen, unseen = rows.keep(~held), rows.keep(held)
        theta = converge(model, whole.theta, seen, widths, g_mps2)
        residual = rows.after_s - predict_s(model, theta, rows, g_mps2)
        squares.append(residual[held & ~rows.from_height] ** 2)
        lower = _predictive(model, theta, seen, unseen, widths, g_mps2)
        white = np.linalg.solve(lower, np.where(held, residual, 0.0)[..., None])[..., 0]
        log = -0.5 * white**2 - np.log(np.diagonal(lower, axis1=1, axis2=2)) - 0.5 * np.log(2 * np.pi)
        log = np.where(held, log, 0.0)
        scores.append(log.sum(axis=1)[held.any(axis=1)] if by_drop else log[held])
    if not folds:
        return np.empty(0), np.empty(0)
    return np.concatenate(scores), np.concatenate(squares)


def _predictive(model: BounceModel, theta: Array, seen: Rows, unseen: Rows, widths: Widths, g_mps2: float) -> Array:
    """Batched Cholesky factor of the covariance of unseen rows, what the seen ones leave open of ``theta`` included.

    Without it a model is blamed for where its best value happens to lie: the first, longest flight is far outside the
    others, and what is predicted for it is only as good as the parameters.
    """
    lower = noise_of(model, theta, unseen, g_mps2).lower(widths)
    slope = np.where(unseen.valid[..., None], sensitivities(model, theta, unseen, g_mps2), 0.0)
    open_ = slope @ step(model, theta, seen, widths, g_mps2).covariance @ slope.transpose(0, 2, 1)
    return np.asarray(np.linalg.cholesky(lower @ lower.transpose(0, 2, 1) + open_), dtype=np.float64)
