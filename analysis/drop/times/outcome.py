"""Results of impact times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from analysis.drop import outcome
from analysis.drop.laws import BOUNDS, Verdict, gain_of
from analysis.drop.thresholds import CONTRADICTION_SIGMAS, LEVEL_SIGMAS
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.model_selection import Judged

_USUAL_JITTER_S = 5e-4  # of a phone, a microphone or a contact, with the size of the ball's dent
_DRAWS = 1000


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
    heights = [_height(drop, without_heights or verdict, g_mps2, rng) for drop in drops]
    each = [_of_one(*parts) for parts in zip(drops, heights, stated, verdict.left_out, strict=True)]
    if without_heights is not None:
        off = [one["stated_height_m"].get("sigmas_off", 0.0) for one in each if "stated_height_m" in one]
        worst = max(off, key=abs, default=0.0)
        if abs(worst) > CONTRADICTION_SIGMAS and "mu" not in verdict.candidate(verdict.best).model.parameters:
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
    best = verdict.candidate(verdict.best)
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
        sigma = fit.half_width() / LEVEL_SIGMAS
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
        if abs(check.get("sigmas_off", 0.0)) > CONTRADICTION_SIGMAS:
            used = " (and was used as data all the same)" if check["used_as_data"] else ""
            off = f"{check['sigmas_off']:+.1f} sigma off what the impacts say{used}"
            words.append(f"{one['file']}: the stated height {check['value']:.3f} m is {off}")
    return words
