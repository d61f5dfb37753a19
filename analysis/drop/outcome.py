"""What a drop test says: numbers with intervals, for a machine; sentences, for a person.

The rule kept here: every number has its interval, and what the data cannot carry is said in words instead of given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.attribution import Judged, Verdict, gain_of
from analysis.drop.bouncelaw import BOUNDS
from analysis.drop.rows import Drop

Array = NDArray[np.float64]

LEVEL_SIGMAS = 1.96
_DRAWS = 1000


@dataclass(frozen=True)
class Measured:
    """A parameter for a profile: effect and parameter by their shared names, one standard deviation, source."""

    effect: str
    parameter: str
    value: float
    uncertainty: float
    source: str

    @property
    def key(self) -> str:
        """Its dotted key in a profile."""
        return f"declared.{self.effect}.{self.parameter}"


@dataclass
class Outcome:
    """A result on its way out.

    Attributes
    ----------
    payload : dict
        The JSON.
    sentences : list of str
        The same for a person, what cannot be told included.
    measured : list of Measured
        What may be declared in a profile.
    """

    payload: dict[str, Any]
    sentences: list[str] = field(default_factory=list)
    measured: list[Measured] = field(default_factory=list)


def interval(value: float, low: float, high: float) -> dict[str, float | None]:
    """A number with its 95 % interval, as JSON has it; None where it is not finite."""
    return {k: (float(v) if np.isfinite(v) else None) for k, v in (("value", value), ("low", low), ("high", high))}


def of_draws(value: float, draws: Array) -> dict[str, float | None]:
    """The interval that holds 95 % of the draws."""
    good = draws[np.isfinite(draws)]
    if not len(good) or not np.isfinite(value):
        return interval(value, np.nan, np.nan)
    low, high = np.quantile(good, [0.025, 0.975])
    return interval(value, min(low, value), max(high, value))


def milliseconds(seconds: float) -> float | None:
    """For JSON: None where there is none."""
    return 1e3 * seconds if np.isfinite(seconds) else None


def pooled_height(heights: Sequence[dict[str, float | None]]) -> dict[str, float | None]:
    """One height for several drops: the mean, its interval widened by their spread; null where there is none."""
    good = [h for h in heights if None not in (h["value"], h["low"], h["high"])]
    if not good:
        return interval(np.nan, np.nan, np.nan)
    if len(good) == 1:
        return good[0]
    value = np.array([h["value"] for h in good], dtype=np.float64)
    half = np.array([0.5 * (h["high"] - h["low"]) for h in good], dtype=np.float64)  # type: ignore[operator]
    spread = max(float(value.std(ddof=1)), float(half.mean()) / LEVEL_SIGMAS)
    mean, reach = float(value.mean()), LEVEL_SIGMAS * spread / float(np.sqrt(len(value)))
    return interval(mean, mean - reach, mean + reach)


def of_times(
    drops: Sequence[Drop],
    verdict: Verdict,
    g_mps2: float,
    stated: Sequence[tuple[float, float] | None],
    rng: np.random.Generator,
) -> Outcome:
    """Result of impact times.

    Parameters
    ----------
    stated : sequence of (height, standard uncertainty) or None
        Heights a person gave, to be checked against.
    """
    heights = [_height(drop, verdict, g_mps2, rng) for drop in drops]
    payload: dict[str, Any] = {
        "kind": "times",
        "files": [drop.name for drop in drops],
        "impacts_s": [float(t) for drop in drops for t in drop.bounces.impacts_s],
        "models": [_model(rung, drops[0].height_m is not None) for rung in verdict.rungs],
        "chosen": verdict.chosen,
        "tie_set": list(verdict.tie_set),
        "drop_height_m": pooled_height(heights),
        "drops": [_one(d, h, s, int(n)) for d, h, s, n in zip(drops, heights, stated, verdict.left_out, strict=True)],
    }
    return Outcome(payload, _times_in_words(drops, verdict, payload), _measured(verdict, drops))


def _model(rung: Judged, with_height: bool) -> dict[str, Any]:
    fit, half = rung.fit, rung.fit.half_width()
    parameters = {}
    for name, value, reach in zip(rung.model.parameters, fit.theta, half, strict=True):
        floor, ceiling = BOUNDS[name]
        entry = interval(value, max(value - reach, floor), min(value + reach, ceiling))
        if name == "mu":
            parameters["mu_up"] = parameters["mu_down"] = entry
        else:
            parameters[name] = entry
    if not rung.identifiable:
        e = min(float(fit.theta[0]), 1.0)
        most = (1.0 - e * e) / (1.0 + e * e)
        parameters["e0"] = interval(fit.theta[0], fit.theta[0] - half[0], max(1.0, fit.theta[0]))
        parameters["mu_up"] = parameters["mu_down"] = interval(0.0, 0.0, most)
    return {
        "name": rung.model.name,
        "parameters": parameters,
        "rms_ms": milliseconds(rung.rms_s),
        "held_out_rms_ms": milliseconds(rung.held_out_rms_s),
        "identifiable": rung.identifiable,
        "jitter_ms": 1e3 * fit.jitter_s,
        "restitution_scatter": fit.scatter,
    }


def _height(drop: Drop, verdict: Verdict, g_mps2: float, rng: np.random.Generator) -> dict[str, float | None]:
    """Drop height from the first flight, over every rung that the data leave standing."""
    if drop.bounces.missed[0] != 0:
        return interval(np.nan, np.nan, np.nan)
    first = float(drop.bounces.intervals_s[0])
    lows, highs, value = [], [], np.nan
    chosen = verdict.rung(verdict.chosen)
    for rung in verdict.rungs:
        name, fit = rung.model.name, rung.fit
        simple = len(rung.model.parameters) <= 2 or rung is chosen
        if not rung.identifiable or not simple or gain_of(chosen, rung)[1]:
            continue
        sigma = fit.half_width() / LEVEL_SIGMAS
        scale = sigma / np.maximum(np.sqrt(np.diag(fit.covariance)), 1e-300)
        theta = fit.theta + scale * rng.multivariate_normal(np.zeros(len(sigma)), fit.covariance, _DRAWS, method="svd")
        low, high = np.array([BOUNDS[p] for p in rung.model.parameters]).T
        flight = first + np.sqrt(2.0) * fit.jitter_s * rng.standard_normal(_DRAWS)
        scatter = fit.scatter * rng.standard_normal(_DRAWS)
        draws = rung.model.drop_height_m(np.clip(theta, low, high), flight, g_mps2, scatter)
        if name == verdict.chosen:
            value = float(rung.model.drop_height_m(fit.theta, np.array(first), g_mps2, np.array(0.0)))
        if np.isfinite(draws).sum() > 0.5 * _DRAWS:
            a, b = np.nanquantile(draws, [0.025, 0.975])
            lows.append(a)
            highs.append(b)
    return interval(value, min(lows, default=np.nan), max(highs, default=np.nan))


def _one(
    drop: Drop, height: dict[str, float | None], stated: tuple[float, float] | None, left_out: int
) -> dict[str, Any]:
    bounces = drop.bounces
    out: dict[str, Any] = {
        "file": drop.name,
        "impacts_s": bounces.impacts_s.tolist(),
        "missed": bounces.missed.tolist(),
        "false_events_s": bounces.false_s.tolist(),
        "irregular_bounces_left_out": left_out + int(bounces.broken.sum()),
        "drop_height_m": height,
    }
    if stated is not None:
        used = drop.height_m is not None
        out["stated_height_m"] = {"value": stated[0], "uncertainty": stated[1], "used_as_data": used}
        if None not in height.values():
            own = (height["high"] - height["low"]) / (2 * LEVEL_SIGMAS)  # type: ignore[operator]
            off = height["value"] - stated[0]  # type: ignore[operator]
            out["stated_height_m"]["sigmas_off"] = off / float(np.hypot(own, stated[1]))
    return out


def _times_in_words(drops: Sequence[Drop], verdict: Verdict, payload: dict[str, Any]) -> list[str]:
    total = sum(len(drop.bounces.impacts_s) for drop in drops)
    missed = sum(int(drop.bounces.missed.sum()) for drop in drops)
    false = sum(len(drop.bounces.false_s) for drop in drops)
    irregular = int(verdict.left_out.sum())
    words = [f"{len(drops)} drop(s), {total} impacts; {missed} missed, {false} false; {irregular} irregular"]
    words += describe_choice(payload["models"], verdict.chosen, verdict.tie_set)
    if drops[0].height_m is None:
        words.append(
            "Impact times alone cannot tell friction from restitution (both shorten every flight by one factor): the "
            "restitution given is that of a ball without friction. Give the drop height as data, or film it."
        )
    entry = payload["drop_height_m"]
    if entry["value"] is None or entry["low"] is None:
        words.append("The drop height cannot be had from these impacts.")
    else:
        words.append(f"drop height {entry['value']:.3f} m ({entry['low']:.3f} to {entry['high']:.3f})")
    for one in payload["drops"]:
        check = one.get("stated_height_m", {})
        if abs(check.get("sigmas_off", 0.0)) > 3.0:
            off = f"{check['sigmas_off']:+.1f} sigma off"
            words.append(f"{one['file']}: the stated height {check['value']:.3f} m is {off}")
    return words


def describe_choice(models: list[dict[str, Any]], chosen: str, ties: Sequence[str]) -> list[str]:
    """The ladder in sentences: error before and after, and what cannot be told."""
    by_name = {model["name"]: model for model in models}
    before, after = models[0]["held_out_rms_ms"], by_name[chosen]["held_out_rms_ms"]
    words = []
    if before is None or after is None:
        words.append("Too few bounces to hold any out: no effect beyond a constant restitution can be judged.")
    elif chosen == models[0]["name"]:
        words.append(f"A constant restitution predicts held-out bounces to {before:.2f} ms; no more is beyond doubt.")
    else:
        words.append(f"{chosen}: held-out error {before:.2f} ms before (constant restitution), {after:.2f} ms after.")
    others = [name for name in ties if name != chosen]
    if others:
        words.append(f"The data cannot tell {chosen} from {' or '.join(others)}.")
    return words


def _measured(verdict: Verdict, drops: Sequence[Drop]) -> list[Measured]:
    rung = verdict.rung(verdict.chosen)
    rows = int(np.isfinite(rung.fit.residuals_s).sum())
    source = f"drop test by impact times, {len(drops)} drop(s), {rows} bounces ({drops[0].name}), {verdict.chosen}"
    sigma = rung.fit.half_width() / LEVEL_SIGMAS
    out = []
    for name, value, own in zip(rung.model.parameters, rung.fit.theta, sigma, strict=True):
        out += declared_as(name, float(value), float(own), source)
    return out


def declared_as(name: str, value: float, sigma: float, source: str) -> list[Measured]:
    """A ladder's parameter under the names of the effect library."""
    effect = {"k_per_m": "quadratic_drag", "mu": "coulomb_friction"}.get(name, "restitution")
    keys = ("mu_up", "mu_down") if name == "mu" else (name,)
    return [Measured(effect, key, round(value, 8), round(sigma, 8), source) for key in keys]
