"""Results of impact times: numbers with intervals as JSON, sentences for a person, values for a profile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from analysis.drop.laws.bouncelaw import BOUNDS
from analysis.drop.laws.choice import UNEXPLAINED, gain_of
from analysis.drop.times.lack_of_fit import chi_square
from analysis.drop.times.model_selection import Judged, Verdict
from analysis.drop.times.one_ahead import Drop

Array = NDArray[np.float64]

LEVEL_SIGMAS = 1.96
CONTRADICTION_SIGMAS = 3.0
_USUAL_JITTER_S = 5e-4  # of a phone, a microphone or a contact, with the size of the ball's dent
_DRAWS = 1000


@dataclass(frozen=True)
class Measured:
    """A parameter with its pedigree: effect and parameter by their shared names, one standard deviation, source."""

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
    """One height for several drops: the weighted mean; null where there is none, or where the drops' heights differ."""
    good = [h for h in heights if None not in (h["value"], h["low"], h["high"])]
    if not good:
        return interval(np.nan, np.nan, np.nan)
    if len(good) == 1:
        return good[0]
    value = np.array([h["value"] for h in good], dtype=np.float64)
    half = np.array([0.5 * (h["high"] - h["low"]) for h in good], dtype=np.float64)  # type: ignore[operator]
    sigma = np.maximum(half / LEVEL_SIGMAS, np.maximum(0.02 * value, 1e-9))  # a hand lets go 2 % higher or lower
    mean = float((value / sigma**2).sum() / (1.0 / sigma**2).sum())
    if float((((value - mean) / sigma) ** 2).sum()) > float(stats.chi2.ppf(0.999, len(value) - 1)):
        return interval(np.nan, np.nan, np.nan)
    spread = max(float(value.std(ddof=1)), float(half.mean()) / LEVEL_SIGMAS)
    reach = float(stats.t.ppf(0.975, len(value) - 1)) * spread / float(np.sqrt(len(value)))
    return interval(mean, max(mean - reach, 0.0), mean + reach)


def of_times(
    drops: Sequence[Drop],
    verdict: Verdict,
    g_mps2: float,
    stated: Sequence[tuple[float, float] | None],
    rng: np.random.Generator,
    without_heights: Verdict | None = None,
) -> Outcome:
    """Result of impact times.

    Parameters
    ----------
    stated : sequence of (height, standard uncertainty) or None
        Heights a person gave.
    without_heights : Verdict, optional
        The verdict that does not use the stated heights, where ``verdict`` does.
    """
    blind = without_heights or verdict
    heights = [_height(drop, blind, g_mps2, rng) for drop in drops]
    payload: dict[str, Any] = {
        "kind": "times",
        "files": [drop.name for drop in drops],
        "impacts_s": [float(t) for drop in drops for t in drop.bounces.impacts_s],
        "models": [_model(candidate, drops[0].height_m is not None) for candidate in verdict.candidates],
        "chosen": verdict.chosen,
        "best": verdict.best,
        "explained": verdict.chosen != UNEXPLAINED,
        "unexplained_because": list(verdict.doubts),
        "tie_set": list(verdict.tie_set),
        "drop_height_m": pooled_height(heights),
        "drops": [_one(d, h, s, int(n)) for d, h, s, n in zip(drops, heights, stated, verdict.left_out, strict=True)],
    }
    if without_heights is not None:
        _contradicted(payload, verdict)
    words = _times_in_words(drops, verdict, payload)
    return Outcome(payload, words, [] if not payload["explained"] else _measured(verdict, drops))


def _contradicted(payload: dict[str, Any], verdict: Verdict) -> None:
    """Stated heights taken as data that the impacts contradict, and that friction does not account for."""
    off = [one["stated_height_m"]["sigmas_off"] for one in payload["drops"] if "sigmas_off" in one["stated_height_m"]]
    worst = max(off, key=abs, default=0.0)
    if abs(worst) > CONTRADICTION_SIGMAS and "mu" not in verdict.candidate(verdict.best).model.parameters:
        payload["unexplained_because"].append(
            f"a stated height taken as data is {worst:+.1f} sigma from what the impacts say, and friction does not "
            "account for it: check the height, and from which point of the ball it was measured"
        )
        payload |= {"chosen": UNEXPLAINED, "explained": False}


def _model(candidate: Judged, with_height: bool) -> dict[str, Any]:
    fit, half = candidate.fit, candidate.fit.half_width()
    parameters = {}
    for name, value, reach in zip(candidate.model.parameters, fit.theta, half, strict=True):
        floor, ceiling = BOUNDS[name]
        entry = interval(value, max(value - reach, floor), min(value + reach, ceiling))
        if name == "mu":
            parameters["mu_up"] = parameters["mu_down"] = entry
        else:
            parameters[name] = entry
    if not candidate.identifiable:
        e = min(float(fit.theta[0]), 1.0)
        most = (1.0 - e * e) / (1.0 + e * e)
        parameters["e0"] = interval(fit.theta[0], fit.theta[0] - half[0], max(1.0, fit.theta[0]))
        parameters["mu_up"] = parameters["mu_down"] = interval(0.0, 0.0, most)
    chi2, freedom = chi_square(fit, _USUAL_JITTER_S)
    return {
        "name": candidate.model.name,
        "parameters": parameters,
        "covariance": {"of": list(candidate.model.parameters), "matrix": fit.covariance.tolist()},
        "rms_ms": milliseconds(candidate.rms_s),
        "held_out_rms_ms": milliseconds(candidate.held_out_rms_s),
        "identifiable": candidate.identifiable,
        "zero_excluded": candidate.identifiable and candidate.significant,
        "jitter_ms": 1e3 * fit.widths.jitter_s,
        "restitution_scatter": fit.widths.scatter,
        "rebound_scatter_ms": 1e3 * fit.widths.rebound_s,
        "chi_square_against_jitter": {"jitter_ms": 1e3 * _USUAL_JITTER_S, "value": chi2, "freedom": freedom},
    }


def _height(drop: Drop, verdict: Verdict, g_mps2: float, rng: np.random.Generator) -> dict[str, float | None]:
    """Drop height from the first flight, over every candidate that the data leave standing."""
    if drop.bounces.missed[0] != 0:
        return interval(np.nan, np.nan, np.nan)
    first = float(drop.bounces.intervals_s[0])
    lows, highs, value = [], [], np.nan
    chosen = verdict.candidate(verdict.best)
    for candidate in verdict.candidates:
        name, fit = candidate.model.name, candidate.fit
        simple = len(candidate.model.parameters) <= 2 or candidate is chosen
        if not candidate.identifiable or not simple or gain_of(chosen, candidate)[1]:
            continue
        sigma = fit.half_width() / LEVEL_SIGMAS
        scale = sigma / np.maximum(np.sqrt(np.diag(fit.covariance)), 1e-300)
        theta = fit.theta + scale * rng.multivariate_normal(np.zeros(len(sigma)), fit.covariance, _DRAWS, method="svd")
        low, high = np.array([BOUNDS[p] for p in candidate.model.parameters]).T
        flight = first + np.sqrt(2.0) * fit.widths.jitter_s * rng.standard_normal(_DRAWS)
        scatter = fit.widths.scatter * rng.standard_normal(_DRAWS)
        draws = candidate.model.drop_height_m(np.clip(theta, low, high), flight, g_mps2, scatter)
        if name == verdict.best:
            value = float(candidate.model.drop_height_m(fit.theta, np.array(first), g_mps2, np.array(0.0)))
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
        "flights": [
            {"start_s": float(a), "duration_s": float(b), "impacts_missed": int(m)}
            for a, b, m in zip(bounces.impacts_s[:-1], bounces.intervals_s, bounces.missed, strict=True)
        ],
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
    words += describe_choice(payload)
    if drops[0].height_m is None:
        words.append(
            "Impact times alone cannot tell friction from restitution (both shorten every flight by one factor): the "
            "restitution given is that of a ball without friction. Give the drop height as data, or film it."
        )
    entry = payload["drop_height_m"]
    if entry["value"] is not None and entry["low"] is not None:
        words.append(f"drop height {entry['value']:.3f} m ({entry['low']:.3f} to {entry['high']:.3f})")
    else:
        each = [one["drop_height_m"]["value"] for one in payload["drops"]]
        known = [f"{value:.3f}" for value in each if value is not None]
        words.append(
            f"The drops fell from different heights: {', '.join(known[:12])} m."
            if len(known) > 1
            else "The drop height cannot be had from these impacts."
        )
    for one in payload["drops"]:
        check = one.get("stated_height_m", {})
        if abs(check.get("sigmas_off", 0.0)) > CONTRADICTION_SIGMAS:
            used = " (and was used as data all the same)" if check["used_as_data"] else ""
            off = f"{check['sigmas_off']:+.1f} sigma off what the impacts say{used}"
            words.append(f"{one['file']}: the stated height {check['value']:.3f} m is {off}")
    return words


_TERMS = {
    "e0": "restitution e0 = {}",
    "e1_s_per_m": "falling with impact speed by e1 = {} s/m",
    "k_per_m": "air drag k = {} /m",
    "mu_up": "friction f = {} g",
}


def describe_parameters(parameters: dict[str, dict[str, float | None]]) -> str:
    """The parameters of a model with their 95 % intervals, as one phrase."""
    parts = []
    for name, form in _TERMS.items():
        if name in parameters:
            parts.append(form.format(with_interval(parameters[name])))
    return ", ".join(parts)


def with_interval(entry: dict[str, float | None]) -> str:
    """``value (low to high)`` with as many digits as the interval is worth."""
    value, low, high = entry["value"], entry["low"], entry["high"]
    if value is None:
        return "unknown"
    if low is None or high is None:
        return f"{value:.3g} (no interval)"
    width = max(high - low, 1e-12)
    places = min(max(int(np.ceil(-np.log10(width))) + 1, 0), 8)
    return f"{value:.{places}f} ({low:.{places}f} to {high:.{places}f})"


def describe_choice(payload: dict[str, Any]) -> list[str]:
    """The verdict in sentences: parameters, error before and after, what cannot be told, what is not explained."""
    models, best, ties = payload["models"], payload["best"], payload["tie_set"]
    by_name = {model["name"]: model for model in models}
    words = []
    for reason in payload["unexplained_because"]:
        words.append(f"Unexplained: {reason}.")
    label = best if payload["explained"] else f"{best} (not believed)"
    words.append(f"{label}: {describe_parameters(by_name[best]['parameters'])}; intervals are 95 %.")
    before, after = models[0]["held_out_rms_ms"], by_name[best]["held_out_rms_ms"]
    if payload["kind"] == "camera" and not payload["impacts_s"]:
        pass
    elif before is None or after is None:
        words.append("Too few bounces to hold any out: no effect beyond a constant restitution can be judged.")
    elif best == models[0]["name"]:
        words.append(f"A constant restitution predicts held-out bounces to {before:.2f} ms; no more is beyond doubt.")
    else:
        words.append(f"{best}: held-out error {before:.2f} ms before (constant restitution), {after:.2f} ms after.")
    others = [name for name in ties if name != best]
    if others:
        words.append(f"The data cannot tell {best} from {' or '.join(others)}.")
    return words


def _measured(verdict: Verdict, drops: Sequence[Drop]) -> list[Measured]:
    candidate = verdict.candidate(verdict.chosen)
    rows = int(np.isfinite(candidate.fit.residuals_s).sum())
    source = f"drop test by impact times, {len(drops)} drop(s), {rows} bounces ({drops[0].name}), {verdict.chosen}"
    sigma = candidate.fit.half_width() / LEVEL_SIGMAS
    out = []
    for name, value, own in zip(candidate.model.parameters, candidate.fit.theta, sigma, strict=True):
        out += declared_as(name, float(value), float(own), source)
    return out


def declared_as(name: str, value: float, sigma: float, source: str) -> list[Measured]:
    """A model's parameter under the names of the effect library; nothing where it is compatible with zero."""
    if not np.isfinite(sigma) or not abs(value) > LEVEL_SIGMAS * sigma:
        return []
    effect = {"k_per_m": "quadratic_drag", "mu": "coulomb_friction"}.get(name, "restitution")
    keys = ("mu_up", "mu_down") if name == "mu" else (name,)
    return [Measured(effect, key, round(value, 8), round(sigma, 8), source) for key in keys]
