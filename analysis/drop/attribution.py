"""Which rung the bounces call for: held-out bounces, the tie set, and what the data cannot tell.

The rule kept here: an effect is added only when bounces that were not fitted are predicted better beyond doubt (twice
the standard error of the paired gain, and three nats), and rivals that are not worse beyond doubt are all named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bouncelaw import CONSTANT, FRICTION, LADDER, BounceModel
from analysis.drop.ladder import Fit, converge, fit, sensitivities, step, usable_rows
from analysis.drop.rows import Drop, Rows, noise_of, predict_s

Array = NDArray[np.float64]

LEAST_GAIN_NATS = 3.0
CHANCE_LOSS_NATS = 0.5
TIE_NATS = 6.0  # a rival with other parameters is out only this far behind
HINT_NATS = 1.0  # held out, by which an effect seems to help without being beyond doubt
_ENOUGH_DROPS = 4
_SIMPLE = 2  # parameters
_MOST_FOLDS = 8
_LEAST_ROWS = 5  # fewer bounces than this leave nothing to hold out


class Scored(Protocol):
    """A rung of any ladder: its model, and its held-out log likelihood unit by unit."""

    @property
    def model(self) -> BounceModel:
        """Name and parameters."""
        ...

    @property
    def scores(self) -> Array:
        """Held-out log likelihood, (units,)."""
        ...


@dataclass(frozen=True)
class Judged:
    """A rung, fitted and tried on bounces it did not see.

    Attributes
    ----------
    fit : Fit
    rms_s, held_out_rms_s : float
        Of the flight durations predicted from flights, in sample and held out (NaN where nothing could be held out).
    scores : (units,) float64
        Held-out log likelihood of each drop (or bounce, where there are few drops).
    identifiable : bool
        False where another rung with fewer parameters predicts exactly the same times.
    """

    fit: Fit
    rms_s: float
    held_out_rms_s: float
    scores: Array
    identifiable: bool = True

    @property
    def model(self) -> BounceModel:
        """The rung."""
        return self.fit.model


@dataclass(frozen=True)
class Verdict:
    """The ladder judged.

    Attributes
    ----------
    rungs : tuple of Judged
        In the ladder's order.
    chosen : str
    tie_set : tuple of str
        Rungs that the data cannot tell apart, the chosen one first.
    left_out : (drops,) int64
        Irregular bounces left out of each drop.
    """

    rungs: tuple[Judged, ...]
    chosen: str
    tie_set: tuple[str, ...]
    left_out: NDArray[np.int64]

    def rung(self, name: str) -> Judged:
        """The rung called ``name``."""
        return next(r for r in self.rungs if r.fit.model.name == name)


def judge(drops: Sequence[Drop], g_mps2: float, rng: np.random.Generator) -> Verdict:
    """Fit every rung to ``drops`` and say which the bounces call for."""
    rows, left_out = usable_rows(drops, g_mps2)
    folds = _folds(rows)
    with_height = bool((rows.from_height & rows.valid).any())
    rungs: list[Judged] = []
    for model in LADDER:
        if model is FRICTION and not with_height:
            rungs.append(_same_times(rungs[0]))
        elif model is not CONSTANT and rows.count <= len(model.parameters):
            continue
        else:
            rungs.append(_try(model, rows, folds, g_mps2, rng))
    chosen, ties = choose([r for r in rungs if r.identifiable])
    if not folds:  # nothing could be held out: nothing can be told
        simple = [model for model in LADDER if len(model.parameters) <= _SIMPLE]
        ties = tuple(model.name for model in simple if model is not FRICTION or with_height)
    if chosen == CONSTANT.name and not with_height:
        ties = (*ties, FRICTION.name)  # friction shortens every flight by one factor, as a lower restitution does
    return Verdict(tuple(rungs), chosen, ties, left_out)


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


def _try(
    model: BounceModel, rows: Rows, folds: Sequence[NDArray[np.bool_]], g_mps2: float, rng: np.random.Generator
) -> Judged:
    whole = fit(model, rows, g_mps2, rng)
    widths = (whole.jitter_s, whole.scatter)
    by_drop = bool(rows.valid.any(axis=1).sum() >= _ENOUGH_DROPS)
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
    rms = float(np.sqrt(np.nanmean(whole.residuals_s[~rows.from_height] ** 2)))
    held_rms = float(np.sqrt(np.concatenate(squares).mean())) if squares else float("nan")
    return Judged(whole, rms, held_rms, np.concatenate(scores) if scores else np.empty(0))


def _predictive(
    model: BounceModel, theta: Array, seen: Rows, unseen: Rows, widths: tuple[float, float], g_mps2: float
) -> Array:
    """Batched Cholesky factor of the covariance of unseen rows, what the seen ones leave open of ``theta`` included.

    Without it a model is blamed for where its best value happens to lie: the first, longest flight is far outside the
    others, and what is predicted for it is only as good as the parameters.
    """
    lower = noise_of(model, theta, unseen, g_mps2).lower(*widths)
    slope = np.where(unseen.valid[..., None], sensitivities(model, theta, unseen, g_mps2), 0.0)
    open_ = slope @ step(model, theta, seen, widths, g_mps2).covariance @ slope.transpose(0, 2, 1)
    return np.asarray(np.linalg.cholesky(lower @ lower.transpose(0, 2, 1) + open_), dtype=np.float64)


def gain_of(rival: Scored, than: Scored) -> tuple[float, bool]:
    """Held-out gain of ``rival`` in nats, and whether it is beyond doubt.

    Beyond doubt: above `LEAST_GAIN_NATS`, and either above twice the standard error of the paired gains or shared by
    all units (a long flight says more than a short one, so their gains may differ widely and still all agree).
    """
    each = rival.scores - than.scores
    if len(each) < 2:
        return 0.0, False
    gain = float(each.sum())
    doubt = 2.0 * float(each.std(ddof=1)) * float(np.sqrt(len(each)))
    agreed = bool(each.min() > -CHANCE_LOSS_NATS)
    return gain, gain > LEAST_GAIN_NATS and (gain > doubt or agreed)


def choose(rungs: Sequence[Scored]) -> tuple[str, tuple[str, ...]]:
    """Climb from the simplest rung while the gain is beyond doubt; then name who is not worse beyond doubt."""
    best = rungs[0]
    while True:
        gains = [(gain_of(rival, best), rival) for rival in rungs if rival.model.nests(best.model)]
        better = [(gain, rival) for (gain, sure), rival in gains if sure]
        if not better:
            break
        fewest = min(len(rival.model.parameters) for _, rival in better)
        best = max((b for b in better if len(b[1].model.parameters) == fewest), key=lambda b: b[0])[1]
    ties = [best.model.name]
    for rival in rungs:
        if rival is best or best.model.nests(rival.model):
            continue
        gain, _ = gain_of(rival, rungs[0])
        behind, beaten = gain_of(best, rival)
        if rival.model.nests(best.model):  # more parameters: named only where they seem to help, if not beyond doubt
            simpler = any(r.model.name in ties[1:] and rival.model.nests(r.model) for r in rungs)
            if behind < -HINT_NATS and not simpler:
                ties.append(rival.model.name)
        elif not (beaten and behind > TIE_NATS) and gain > HINT_NATS:
            ties.append(rival.model.name)
    return best.model.name, tuple(ties)
