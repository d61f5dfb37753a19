"""Impact times: the choice among the models by held-out bounces, what none of them accounts for, and the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from analysis.drop import outcome, thresholds
from analysis.drop.laws import BOUNDS, CONSTANT, FRICTION, MODELS, Candidate, Verdict, beyond_zero, choose, gain_of
from analysis.drop.times.model_fit import ENOUGH_DROPS, Drop, Fit, Rows, again, fit, folds_of, held_out, usable_rows

ANY_DRAG = (0.0, np.inf)
_USUAL_JITTER_S = 5e-4  # of a phone, a microphone or a contact, with the size of the ball's dent
_DRAWS = 1000


Judged = Candidate[Fit]  # not identifiable where another with fewer parameters predicts exactly the same times


def _candidate(fitted: Fit, rows: Rows, g_mps2: float, drag_limits: tuple[float, float]) -> Judged:
    """A fitted model, tried on bounces of ``rows`` that it was not fitted to."""
    pairs = zip(fitted.theta.tolist(), fitted.half_width().tolist(), strict=True)
    said = dict(zip(fitted.model.parameters, pairs, strict=True))
    rms = float(np.sqrt(np.nanmean(fitted.residuals_s[~rows.from_height] ** 2)))
    scores, missed = held_out(fitted, rows, g_mps2)
    may_be = beyond_zero(said) and _is_physical(said, drag_limits)
    return Candidate(fitted.model, scores, rms, missed, True, fitted, said, may_be, BOUNDS)


def _is_physical(estimates: dict[str, tuple[float, float]], drag_limits: tuple[float, float]) -> bool:
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
    can_hold_out = bool(folds_of(rows))
    with_height = bool((rows.from_height & rows.valid).any())
    candidates: list[Judged] = []
    for model in MODELS:
        if model is FRICTION and not with_height:
            candidates.append(_same_times(candidates[0]))
        elif model is CONSTANT or rows.count > len(model.parameters):
            candidates.append(_candidate(fit(model, rows, g_mps2, rng), rows, g_mps2, drag_limits))
    able = [r for r in candidates if r.identifiable]
    if can_hold_out:
        parts = [
            [_candidate(again(r.fit, part, g_mps2), part, g_mps2, drag_limits) for r in able] for part in _trimmed(rows)
        ]
        choices = [choose(models) for models in (able, *parts)]
        # no part of the data that lacks an impact may call for a simpler model; what the others call for is tied
        size = {model.name: len(model.parameters) for model in MODELS}
        first = [part[0] for part in choices]
        ties = tuple(dict.fromkeys([min(first, key=lambda name: size[name]), *first, *choices[0]]))
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
    if int(rows.valid.any(axis=1).sum()) >= ENOUGH_DROPS or int(flights.sum()) < 7:
        return []
    behind = np.cumsum(flights[:, ::-1], axis=1)[:, ::-1]  # flights from here to the end
    first = np.cumsum(flights, axis=1) == 1
    return [rows.keep(~(flights & out)) for out in (behind <= 1, behind <= 2, first)]


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
    elif fast - slow > thresholds.LARGEST_RISE * e0:
        words.append(
            f"the restitution would rise from {slow:.3f} at the slowest impact to {fast:.3f} at the fastest; a ball's "
            "falls with the speed: taps of a hand, a plate that gives way, or wrong impacts"
        )
    relative = fitted.widths.scatter / max(e0, 0.05)
    if relative > thresholds.LARGEST_SCATTER:
        words.append(
            f"the restitution scatters by {100 * relative:.1f} % from bounce to bounce, more than a ball on a flat "
            "plate does: a rough ball, a tilted or soft plate, or wrong impacts"
        )
    if fitted.widths.jitter_s > thresholds.LARGEST_JITTER_S:
        words.append(f"impact times scatter by {1e3 * fitted.widths.jitter_s:.1f} ms, more than any detector's do")
    chance = _chance_of_trend(fitted, rows)
    if chance < thresholds.STRUCTURE_CHANCE:
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


def of_times(
    drops: Sequence[Drop],
    verdict: Verdict[Judged],
    g_mps2: float,
    stated: Sequence[tuple[float, float] | None],
    rng: np.random.Generator,
    without_heights: Verdict[Judged] | None = None,
) -> outcome.Outcome:
    """Result of impact times.

    ``stated`` are heights that a person gave, with standard uncertainties; ``without_heights`` is the verdict that does
    not use them, where ``verdict`` does.
    """
    best = verdict.candidate(verdict.best)
    heights = [_height(drop, without_heights or verdict, g_mps2, rng) for drop in drops]
    each = [_of_one(*parts) for parts in zip(drops, heights, stated, verdict.left_out, strict=True)]
    if without_heights is not None:
        off = [one["stated_height_m"].get("sigmas_off", 0.0) for one in each if "stated_height_m" in one]
        worst = max(off, key=abs, default=0.0)
        if abs(worst) > thresholds.CONTRADICTION_SIGMAS and "mu" not in best.model.parameters:
            doubt = (
                f"a stated height taken as data is {worst:+.1f} sigma from what the impacts say, and friction does not "
                "account for it: check the height, and from which point of the ball it was measured"
            )
            verdict = replace(verdict, doubts=(*verdict.doubts, doubt))
    impacts_s = np.concatenate([drop.bounces.impacts_s for drop in drops]).tolist()
    names, height = [drop.name for drop in drops], outcome.pooled_height(heights)
    payload = outcome.payload_of("times", names, impacts_s, verdict, height)
    si = dict.fromkeys(BOUNDS, 1.0)
    payload["models"] = [outcome.model_json(one, si, 1e3) | _quality(one) for one in verdict.candidates]
    payload["drops"] = each
    rows = int(np.isfinite(best.fit.residuals_s).sum())
    source = f"drop test by impact times, {len(drops)} drop(s), {rows} bounces ({drops[0].name}), {verdict.best}"
    return outcome.Outcome(
        payload,
        _in_words(drops, int(verdict.left_out.sum()), payload),
        [] if verdict.doubts else outcome.declared(best, si, source),
    )


def _quality(one: Judged) -> dict[str, Any]:
    """Covariance, widths, and chi-square of the residuals against a usual jitter."""
    fit = one.fit
    residual, e = fit.residuals_s[np.isfinite(fit.residuals_s)], float(fit.theta[0])
    variance = _USUAL_JITTER_S**2 * (1.0 + (1.0 + e) ** 2 + e**2)  # of three impact times that a residual joins
    return {
        "covariance": {"of": list(fit.model.parameters), "matrix": fit.covariance.tolist()},
        "jitter_ms": 1e3 * fit.widths.jitter_s,
        "restitution_scatter": fit.widths.scatter,
        "rebound_scatter_ms": 1e3 * fit.widths.rebound_s,
        "chi_square_against_jitter": {
            "jitter_ms": 1e3 * _USUAL_JITTER_S,
            "value": float((residual**2).sum() / max(variance, 1e-300)),
            "freedom": fit.freedom,
        },
    }


def _height(drop: Drop, verdict: Verdict[Judged], g_mps2: float, rng: np.random.Generator) -> outcome.Interval:
    """Drop height from the first flight, over every candidate that the data leave standing."""
    if drop.bounces.missed[0] != 0:
        return outcome.UNKNOWN
    first = float(drop.bounces.intervals_s[0])
    chosen = verdict.candidate(verdict.best)
    value = float(chosen.model.drop_height_m(chosen.fit.theta, np.array(first), g_mps2, np.array(0.0)))
    ends = []
    for candidate in verdict.candidates:
        fit, model = candidate.fit, candidate.model
        simple = len(model.parameters) <= 2 or candidate is chosen
        if not candidate.identifiable or not simple or gain_of(chosen, candidate)[1]:
            continue
        sigma = fit.half_width() / thresholds.LEVEL_SIGMAS
        scale = sigma / np.maximum(np.sqrt(np.diag(fit.covariance)), 1e-300)
        theta = fit.theta + scale * rng.multivariate_normal(np.zeros(len(sigma)), fit.covariance, _DRAWS, method="svd")
        low, high = np.array([BOUNDS[p] for p in model.parameters]).T
        flight = first + np.sqrt(2.0) * fit.widths.jitter_s * rng.standard_normal(_DRAWS)
        scatter = fit.widths.scatter * rng.standard_normal(_DRAWS)
        draws = model.drop_height_m(np.clip(theta, low, high), flight, g_mps2, scatter)
        if np.isfinite(draws).sum() > 0.5 * _DRAWS:
            ends.append(np.nanquantile(draws, [0.025, 0.975]))
    lows, highs = np.array(ends).reshape(-1, 2).T
    return outcome.interval(value, lows.min(initial=np.inf), highs.max(initial=-np.inf))


def _of_one(drop: Drop, height: outcome.Interval, stated: tuple[float, float] | None, left_out: int) -> dict[str, Any]:
    """One drop for the JSON."""
    bounces = drop.bounces
    out: dict[str, Any] = {
        "file": drop.name,
        "impacts_s": bounces.impacts_s.tolist(),
        "missed": bounces.missed.tolist(),
        "false_events_s": bounces.false_s.tolist(),
        "irregular_bounces_left_out": int(left_out) + int(bounces.broken.sum()),
        "drop_height_m": height,
        "flights": [
            {"start_s": float(a), "duration_s": float(b), "impacts_missed": int(m)}
            for a, b, m in zip(bounces.impacts_s[:-1], bounces.intervals_s, bounces.missed, strict=True)
        ],
    }
    if stated is not None:
        out["stated_height_m"] = outcome.against_stated(height, stated) | {"used_as_data": drop.height_m is not None}
    return out


def _in_words(drops: Sequence[Drop], irregular: int, payload: dict[str, Any]) -> list[str]:
    missed = sum(int(drop.bounces.missed.sum()) for drop in drops)
    false = sum(len(drop.bounces.false_s) for drop in drops)
    total = len(payload["impacts_s"])
    words = [f"{len(drops)} drop(s), {total} impacts; {missed} missed, {false} false; {irregular} irregular"]
    words += outcome.describe_choice(payload)
    if drops[0].height_m is None:
        words.append(
            "Impact times alone cannot tell friction from restitution (both shorten every flight by one factor): the "
            "restitution given is that of a ball without friction. Give the drop height as data, or film it."
        )
    height = payload["drop_height_m"]
    known = [h["value"] for h in (one["drop_height_m"] for one in payload["drops"]) if h["value"] is not None]
    if height["value"] is not None and height["low"] is not None:
        words.append(f"drop height {outcome.in_digits(height, 3, ' m')}")
    elif len(known) > 1:
        shown = ", ".join(f"{value:.3f}" for value in known[: outcome.MOST_SAID])
        words.append(f"The drops fell from different heights: {shown} m.")
    else:
        words.append("The drop height cannot be had from these impacts.")
    for one in payload["drops"]:
        check = one.get("stated_height_m", {})
        if abs(check.get("sigmas_off", 0.0)) > thresholds.CONTRADICTION_SIGMAS:
            used = " (and was used as data all the same)" if check["used_as_data"] else ""
            off = f"{check['sigmas_off']:+.1f} sigma off what the impacts say{used}"
            words.append(f"{one['file']}: the stated height {check['value']:.3f} m is {off}")
    return words
