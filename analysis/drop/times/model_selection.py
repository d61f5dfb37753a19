"""Model selection for impact times: held-out bounces, the tie set, lack of fit, and what the data cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from analysis.drop.laws import (
    BOUNDS,
    CONSTANT,
    FRICTION,
    MODELS,
    Candidate,
    Estimates,
    Verdict,
    beyond_zero,
    choose,
    stable_choice,
)
from analysis.drop.thresholds import LARGEST_JITTER_S, LARGEST_RISE, LARGEST_SCATTER, STRUCTURE_CHANCE
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


Judged = Candidate[Fit]  # not identifiable where another with fewer parameters predicts exactly the same times


def _estimates(fitted: Fit) -> Estimates:
    pairs = zip(fitted.theta.tolist(), fitted.half_width().tolist(), strict=True)
    return dict(zip(fitted.model.parameters, pairs, strict=True))


def _is_physical(estimates: Estimates, drag_limits: tuple[float, float]) -> bool:
    """Whether the interval of the drag reaches what mass and size allow."""
    k, half = estimates.get("k_per_m", (drag_limits[0], 0.0))
    return k + half >= drag_limits[0] and k - half <= drag_limits[1]


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
            said = _estimates(whole)
            may_be = beyond_zero(said) and _is_physical(said, drag_limits)
            candidates.append(Candidate(model, scores, rms, held_out, True, whole, said, may_be, BOUNDS))
    able = [r for r in candidates if r.identifiable]
    if can_hold_out:
        parts = [[_again(r, part, g_mps2, drag_limits) for r in able] for part in _trimmed(rows)]
        ties = stable_choice([choose(models) for models in (able, *parts)], MODELS)
    else:  # every simple model may be the one
        simple = [model for model in MODELS if len(model.parameters) <= 2]
        ties = tuple(model.name for model in simple if model is not FRICTION or with_height)
    best = next(r for r in candidates if r.model.name == ties[0])
    if best.model is CONSTANT and not with_height:
        ties = (*ties, FRICTION.name)  # friction shortens every flight by one factor, as a lower restitution does
    doubts = _lack_of_fit(best.fit, rows, g_mps2)
    low, high = drag_limits
    for rival in able:  # a drag that no ball of this mass and size has, but that the bounces call for all the same
        said, free = rival.estimates, replace(rival, significant=beyond_zero(rival.estimates))
        if not _is_physical(said, drag_limits) and choose([best, free])[0] == rival.model.name:
            doubts.append(
                f"the bounces call for a drag of {said['k_per_m'][0]:.3g} /m; a sphere of this mass and size has "
                f"{low:.2g} to {high:.2g} /m: something else takes the energy"
            )
            break
    return Verdict(tuple(candidates), ties, tuple(doubts), left_out)


def _trimmed(rows: Rows) -> list[Rows]:
    """The rows without the last, the last two, and the first of each drop, where single bounces decide."""
    flights = rows.flights
    # a row may be left out at an end only of seven or more
    if int(rows.valid.any(axis=1).sum()) >= _ENOUGH_DROPS or int(flights.sum()) < 7:
        return []
    behind = np.cumsum(flights[:, ::-1], axis=1)[:, ::-1]  # flights from here to the end
    first = np.cumsum(flights, axis=1) == 1
    return [rows.keep(~(flights & out)) for out in (behind <= 1, behind <= 2, first)]


def _again(judged: Judged, rows: Rows, g_mps2: float, drag_limits: tuple[float, float]) -> Judged:
    """The same model on other rows, with the widths that it has."""
    whole = judged.fit
    theta = converge(whole.model, whole.theta, rows, whole.widths, g_mps2)
    covariance = wider(linearised(whole.model, theta, rows, whole.widths, g_mps2)[0], whole.covariance)
    part = replace(whole, theta=theta, covariance=covariance, freedom=rows.count - len(theta))
    said, scores = _estimates(part), _held_out(part, rows, g_mps2)[0]
    may_be = beyond_zero(said) and _is_physical(said, drag_limits)
    return replace(judged, fit=part, scores=scores, estimates=said, significant=may_be)


def _same_times(constant: Judged) -> Judged:
    """Friction without a known height: the same times as a constant restitution, whatever the friction.

    Of any size, that is, and with a restitution that makes up for it.
    """
    own, (e0, half) = constant.fit, constant.estimates["e0"]
    e = float(np.clip(own.theta[0], 0.0, 1.0))
    most = (1.0 - e * e) / (1.0 + e * e)  # at which an impact would have to be lossless, for flights that shorten so
    covariance = np.diag([own.covariance[0, 0], most**2 / 12.0])  # evenly between none and the most
    same = replace(own, model=FRICTION, theta=np.append(own.theta, 0.0), covariance=covariance)
    said, limits = {"e0": (e0, np.inf), "mu": (0.0, np.inf)}, {"e0": (e0 - half, max(1.0, e0)), "mu": (0.0, most)}
    return replace(constant, model=FRICTION, fit=same, identifiable=False, estimates=said, limits=limits)


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


def _lack_of_fit(fitted: Fit, rows: Rows, g_mps2: float) -> list[str]:
    """Things that the model fitted to ``rows`` leaves unexplained; none where the residuals are usual noise."""
    words = []
    e0, half = float(fitted.theta[0]), float(fitted.half_width()[0])
    slow = fast = e0
    before = rows.before_s[rows.flights]
    if len(before):  # restitution at the slowest and at the fastest impact that was fitted
        law = fitted.model.law(fitted.theta, g_mps2)
        speeds = law.return_speed_mps(law.takeoff_speed_mps(np.array([before.min(), before.max()])))
        slow, fast = (float(e) for e in fitted.model.rebound_mps(fitted.theta, speeds) / speeds)
    if e0 - half > 1.0:
        words.append(f"a restitution of {e0:.3f} +- {half:.3f} would gain energy at each impact")
    elif max(slow, fast) > 1.0:
        words.append(f"a restitution of {max(slow, fast):.3f} at some of the speeds seen would gain energy")
    elif fast - slow > LARGEST_RISE * e0:
        words.append(
            f"the restitution would rise from {slow:.3f} at the slowest impact to {fast:.3f} at the fastest; a ball's "
            "falls with the speed: taps of a hand, a plate that gives way, or wrong impacts"
        )
    relative = fitted.widths.scatter / max(e0, 0.05)
    if relative > LARGEST_SCATTER:
        words.append(
            f"the restitution scatters by {100 * relative:.1f} % from bounce to bounce, more than a ball on a flat "
            "plate does: a rough ball, a tilted or soft plate, or wrong impacts"
        )
    if fitted.widths.jitter_s > LARGEST_JITTER_S:
        words.append(f"impact times scatter by {1e3 * fitted.widths.jitter_s:.1f} ms, more than any detector's do")
    chance = _chance_of_trend(fitted, rows)
    if chance < STRUCTURE_CHANCE:
        words.append(f"what is left over changes steadily with the length of the flight (chance {chance:.1g})")
    return words


def _chance_of_trend(fitted: Fit, rows: Rows) -> float:
    """Probability by chance of the trend of the whitened residuals with flight duration (F test; 1 where too few)."""
    from_flight = ~rows.from_height[rows.valid]
    white, length = fitted.white[from_flight], np.log(rows.before_s[rows.valid])[from_flight]
    n = len(white)
    if n < 8 or float(np.ptp(length)) < 1e-9:  # of residuals in which a trend is looked for
        return 1.0
    basis = np.vander((length - length.mean()) / float(np.ptp(length)), 3)
    left = white - basis @ np.linalg.lstsq(basis, white, rcond=None)[0]
    explained = float((white**2).sum() - (left**2).sum()) / 3.0
    return float(stats.f.sf(explained / max(float((left**2).sum()) / (n - 3), 1e-300), 3, n - 3))
