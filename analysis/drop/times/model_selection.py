"""Model selection for impact times: held-out bounces, the tie set, lack of fit, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.drop import lack_of_fit
from analysis.drop.laws import BOUNDS, CONSTANT, FRICTION, MODELS, Candidate, Verdict, choose, stable_choice
from analysis.drop.times.model_fit import (
    Drop,
    Fit,
    Rows,
    converge,
    fit,
    linearised,
    noise_of,
    predict_s,
    sensitivities,
    usable_rows,
    wider,
)
from kernels.arrays import Bools, Floats

ANY_DRAG = (0.0, np.inf)
_ENOUGH_DROPS = 4  # from which whole drops are held out, not bounces
_MOST_FOLDS = 8


@dataclass(frozen=True)
class Judged(Candidate):
    """A model of impact times; not identifiable where another with fewer parameters predicts exactly the same times."""

    LIMITS = BOUNDS
    fit: Fit
    drag_limits: tuple[float, float] = ANY_DRAG  # 1/m, of this ball by its mass and size

    def estimates(self) -> dict[str, tuple[float, float]]:
        """Value and half of the 95 % interval of each parameter."""
        pairs = zip(self.fit.theta.tolist(), self.fit.half_width().tolist(), strict=True)
        return dict(zip(self.model.parameters, pairs, strict=True))

    def intervals(self) -> dict[str, tuple[float, float, float]]:
        """Value and 95 % interval of each parameter, inside its bounds; as wide as may be if not identifiable."""
        if self.identifiable:
            return super().intervals()
        e0, half = self.estimates()["e0"]  # friction of any size, and a restitution that makes up for it
        return {"e0": (e0, e0 - half, max(1.0, e0)), "mu": (0.0, 0.0, _most_friction(min(e0, 1.0)))}

    @property
    def significant(self) -> bool:
        """Whether every interval after that of ``e0`` excludes zero, and a drag is one this ball can have."""
        return self.physical and super().significant

    @property
    def physical(self) -> bool:
        """Whether the interval of the drag reaches what mass and size allow."""
        k, half = self.estimates().get("k_per_m", (self.drag_limits[0], 0.0))
        return k + half >= self.drag_limits[0] and k - half <= self.drag_limits[1]


def _most_friction(e: float) -> float:
    """Friction at which an impact would have to be lossless, for flights that shorten by ``e``."""
    return (1.0 - e * e) / (1.0 + e * e)


def judge(
    drops: Sequence[Drop], g_mps2: float, rng: np.random.Generator, drag_limits: tuple[float, float] = ANY_DRAG
) -> Verdict[Judged]:
    """Fit every candidate model to ``drops`` and choose among them.

    ``drag_limits``: smallest and largest ``k`` that the ball's mass and size allow, 1/m.
    """
    rows, left_out = usable_rows(drops, g_mps2)
    can_hold_out = bool(_folds(rows))
    with_height = bool((rows.from_height & rows.valid).any())
    candidates: list[Judged] = []
    for model in MODELS:
        if model is FRICTION and not with_height:
            candidates.append(_same_times(candidates[0]))
        elif model is CONSTANT or rows.count > len(model.parameters):
            whole = fit(model, rows, g_mps2, rng)
            rms = float(np.sqrt(np.nanmean(whole.residuals_s[~rows.from_height] ** 2)))
            scores, held_out = _held_out(whole, rows, g_mps2)
            candidates.append(Judged(model, scores, rms, held_out, True, whole, drag_limits))
    able = [r for r in candidates if r.identifiable]
    if can_hold_out:
        parts = [[_again(r, part, g_mps2) for r in able] for part in _trimmed(rows)]
        ties = stable_choice([choose(models) for models in (able, *parts)], MODELS)
    else:  # every simple model may be the one
        simple = [model for model in MODELS if len(model.parameters) <= 2]
        ties = tuple(model.name for model in simple if model is not FRICTION or with_height)
    best = next(r for r in candidates if r.model.name == ties[0])
    if best.model is CONSTANT and not with_height:
        ties = (*ties, FRICTION.name)  # friction shortens every flight by one factor, as a lower restitution does
    doubts = [*lack_of_fit.of_times(best.fit, rows, g_mps2), *_beyond_physics(able, best)]
    return Verdict(tuple(candidates), ties, tuple(doubts), left_out)


def _beyond_physics(models: Sequence[Judged], best: Judged) -> list[str]:
    """A drag that no ball of this mass and size has, but that the bounces call for all the same."""
    for rival in models:
        if not rival.physical and choose([best, replace(rival, drag_limits=ANY_DRAG)])[0] == rival.model.name:
            low, high = rival.drag_limits
            return [
                f"the bounces call for a drag of {rival.estimates()['k_per_m'][0]:.3g} /m; a sphere of this mass and "
                f"size has {low:.2g} to {high:.2g} /m: something else takes the energy"
            ]
    return []


def _trimmed(rows: Rows) -> list[Rows]:
    """The rows without the last, the last two, and the first of each drop, where single bounces decide."""
    flights = rows.flights
    # a row may be left out at an end only of seven or more
    if int(rows.valid.any(axis=1).sum()) >= _ENOUGH_DROPS or int(flights.sum()) < 7:
        return []
    behind = np.cumsum(flights[:, ::-1], axis=1)[:, ::-1]  # flights from here to the end
    first = np.cumsum(flights, axis=1) == 1
    return [rows.keep(~(flights & out)) for out in (behind <= 1, behind <= 2, first)]


def _again(judged: Judged, rows: Rows, g_mps2: float) -> Judged:
    """The same model on other rows, with the widths that it has."""
    whole = judged.fit
    theta = converge(whole.model, whole.theta, rows, whole.widths, g_mps2)
    covariance = wider(linearised(whole.model, theta, rows, whole.widths, g_mps2)[0], whole.covariance)
    part = replace(whole, theta=theta, covariance=covariance, freedom=rows.count - len(theta))
    return replace(judged, fit=part, scores=_held_out(part, rows, g_mps2)[0])


def _same_times(constant: Judged) -> Judged:
    """Friction without a known height: the same times as a constant restitution, whatever the friction."""
    own = constant.fit
    theta = np.append(own.theta, 0.0)
    draws = np.column_stack([own.draws, np.zeros(len(own.draws))])
    most = _most_friction(float(np.clip(own.theta[0], 0.0, 1.0)))
    covariance = np.diag([own.covariance[0, 0], most**2 / 12.0])  # evenly between none and the most
    same = replace(own, model=FRICTION, theta=theta, covariance=covariance, draws=draws)
    return replace(constant, model=FRICTION, fit=same, identifiable=False, drag_limits=ANY_DRAG)


def _folds(rows: Rows) -> list[Bools]:
    """Rows that each fold holds out: whole drops where there are enough, else every so many-th bounce."""
    with_data = np.flatnonzero(rows.valid.any(axis=1))
    fold_of = np.full(rows.valid.shape, -1)
    if len(with_data) >= _ENOUGH_DROPS:
        fold_of[with_data] = (np.arange(len(with_data)) % _MOST_FOLDS)[:, None]
    elif rows.count >= 5:  # fewer bounces than this leave nothing to hold out
        fold_of[rows.valid] = np.arange(rows.count) % min(_MOST_FOLDS, rows.count)
    return [rows.valid & (fold_of == k) for k in range(int(fold_of.max()) + 1)]


def _held_out(whole: Fit, rows: Rows, g_mps2: float) -> tuple[Floats, float]:
    """Held-out log likelihood of each unit, and rms error of the flights, s (NaN where nothing is held out)."""
    by_drop = bool(rows.valid.any(axis=1).sum() >= _ENOUGH_DROPS)
    model, widths = whole.model, whole.widths
    squares, scores = [np.empty(0)], [np.empty(0)]
    for held in _folds(rows):
        fitted, unseen = rows.keep(~held), rows.keep(held)
        theta = converge(model, whole.theta, fitted, widths, g_mps2)
        residual = rows.after_s - predict_s(model, theta, rows, g_mps2)
        squares.append(residual[held & ~rows.from_height] ** 2)
        # What the fitted rows leave open of the parameters is part of the covariance. Else a model is blamed for
        # where its best value happens to lie: the first, longest flight is far outside the others.
        noise = noise_of(model, theta, unseen, g_mps2).lower(widths)
        slope = np.where(held[..., None], sensitivities(model, theta, unseen, g_mps2), 0.0)
        left_open = slope @ linearised(model, theta, fitted, widths, g_mps2)[0] @ slope.transpose(0, 2, 1)
        lower = np.linalg.cholesky(noise @ noise.transpose(0, 2, 1) + left_open)
        white = np.linalg.solve(lower, np.where(held, residual, 0.0)[..., None])[..., 0]
        log = -0.5 * white**2 - np.log(np.diagonal(lower, axis1=1, axis2=2)) - 0.5 * np.log(2 * np.pi)
        log = np.where(held, log, 0.0)
        scores.append(log.sum(axis=1)[held.any(axis=1)] if by_drop else log[held])
    errors = np.concatenate(squares)
    return np.concatenate(scores), float(np.sqrt(errors.mean())) if len(errors) else float("nan")
