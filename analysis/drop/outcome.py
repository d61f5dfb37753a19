"""Results of a drop test, of impact times and of paths alike: numbers with intervals as JSON, sentences for a person,
values for a profile. Decision 315.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import stats

from analysis.drop.laws import Candidate, Verdict
from analysis.drop.thresholds import LEVEL_SIGMAS
from daq.setup.values import MeasuredValue
from kernels.arrays import Floats

Interval = dict[str, float | None]  # value, low, high; None where not known

_KEYS = {"mu": ("mu_up", "mu_down")}  # in the JSON and in the effect library
MOST_SAID = 12  # heights or bounces in a sentence


@dataclass
class Outcome:
    """A result on its way out."""

    payload: dict[str, Any]  # the JSON
    sentences: list[str] = field(default_factory=list)  # the same for a person, what the data cannot say included
    measured: list[MeasuredValue] = field(default_factory=list)  # what may be declared in a profile


def interval(value: float, low: float, high: float) -> Interval:
    """A number with its 95 % interval, as JSON has it; None where it is not finite."""
    return {k: (float(v) if np.isfinite(v) else None) for k, v in (("value", value), ("low", low), ("high", high))}


UNKNOWN = interval(np.nan, np.nan, np.nan)


def around(value: float, half: float) -> Interval:
    """A number with an interval that reaches as far up as down."""
    return interval(value, value - half, value + half)


def of_draws(value: float, draws: Floats) -> Interval:
    """The interval that holds 95 % of the draws."""
    good = draws[np.isfinite(draws)]
    if not len(good) or not np.isfinite(value):
        return interval(value, np.nan, np.nan)
    low, high = np.quantile(good, [0.025, 0.975])
    return interval(value, min(low, value), max(high, value))


def sigma_of(entry: Interval) -> float | None:
    """Standard deviation of a number by its interval; None where a part of it is not known."""
    value, low, high = entry.values()
    return None if value is None or low is None or high is None else (high - low) / (2.0 * LEVEL_SIGMAS)


def pooled_height(heights: Sequence[Interval]) -> Interval:
    """One height for several drops: the weighted mean; null where there is none, or where the drops' heights differ."""
    good = [(h, sigma) for h in heights if (sigma := sigma_of(h)) is not None]
    if len(good) < 2:
        return good[0][0] if good else UNKNOWN
    value = np.array([h["value"] for h, _ in good], dtype=np.float64)
    own = np.array([sigma for _, sigma in good])
    sigma = np.maximum(own, np.maximum(0.02 * value, 1e-9))  # relative: a hand lets go so much higher or lower
    mean = float((value / sigma**2).sum() / (1.0 / sigma**2).sum())
    if float((((value - mean) / sigma) ** 2).sum()) > float(stats.chi2.ppf(0.999, len(value) - 1)):
        return UNKNOWN
    spread = max(float(value.std(ddof=1)), float(own.mean()))
    reach = float(stats.t.ppf(0.975, len(value) - 1)) * spread / float(np.sqrt(len(value)))
    return interval(mean, max(mean - reach, 0.0), mean + reach)


def against_stated(height: Interval, stated: tuple[float, float]) -> dict[str, Any]:
    """A stated height with its uncertainty, and by how many sigma the measured one is off it, where there is one."""
    own = sigma_of(height)
    said: dict[str, Any] = {"value": stated[0], "uncertainty": stated[1]}
    if own is not None and height["value"] is not None:
        said["sigmas_off"] = (height["value"] - stated[0]) / float(np.hypot(own, stated[1]))
    return said


def payload_of(
    kind: str, files: Sequence[str], impacts_s: Sequence[float], verdict: Verdict[Any], height: Interval
) -> dict[str, Any]:
    """The part of the JSON that every kind of drop test has; ``models`` are added by `model_json`."""
    return {
        "kind": kind,
        "files": list(files),
        "impacts_s": [float(t) for t in impacts_s],
        "chosen": verdict.chosen,
        "best": verdict.best,
        "explained": not verdict.doubts,
        "unexplained_because": list(verdict.doubts),
        "tie_set": list(verdict.tie_set),
        "drop_height_m": height,
    }


def model_json(candidate: Candidate[Any], to_si: Mapping[str, float], per: float, unit: str = "ms") -> dict[str, Any]:
    """A fitted model for the JSON.

    ``to_si`` are factors of the parameters to SI (one that is missing cannot be given), ``per`` that of the candidate's
    errors to ``unit``, NaN where it is not known.
    """
    parameters: dict[str, Interval] = {}
    for name, (value, half) in candidate.estimates.items():
        if name in to_si:
            low, high = candidate.limits.get(name, (-np.inf, np.inf))
            ends = max(value - half, low), min(value + half, high)
            entry = interval(*(to_si[name] * number for number in (value, *ends)))
            parameters |= {key: entry for key in _KEYS.get(name, (name,))}
    errors = {f"rms_{unit}": per * candidate.rms, f"held_out_rms_{unit}": per * candidate.held_out_rms}
    return {key: error if np.isfinite(error) else None for key, error in errors.items()} | {
        "name": candidate.model.name,
        "parameters": parameters,
        "identifiable": candidate.identifiable,
        "zero_excluded": candidate.identifiable and candidate.significant,
    }


def declared(candidate: Candidate[Any], to_si: Mapping[str, float], source: str) -> list[MeasuredValue]:
    """A model's parameters under the names of the effect library, without those that are compatible with zero."""
    out = []
    for name, (value, half) in candidate.estimates.items():
        factor, effect = to_si.get(name, 0.0), {"k_per_m": "quadratic_drag", "mu": "coulomb_friction"}.get(name)
        sigma = half / LEVEL_SIGMAS * factor
        if np.isfinite(sigma) and abs(value * factor) > LEVEL_SIGMAS * sigma:
            numbers = round(value * factor, 8), round(sigma, 8)
            keys = (f"declared.{effect or 'restitution'}.{key}" for key in _KEYS.get(name, (name,)))
            out += [MeasuredValue(key, *numbers, source) for key in keys]
    return out


def with_interval(entry: Interval) -> str:
    """``value (low to high)`` with as many digits as the interval is worth."""
    value, low, high = entry["value"], entry["low"], entry["high"]
    if value is None:
        return "unknown"
    if low is None or high is None:
        return f"{value:.3g} (no interval)"
    places = min(max(int(np.ceil(-np.log10(max(high - low, 1e-12)))) + 1, 0), 8)
    return in_digits(entry, places)


def in_digits(entry: Interval, places: int, unit: str = "") -> str:
    """``value unit (low to high)`` with so many decimals."""
    return f"{entry['value']:.{places}f}{unit} ({entry['low']:.{places}f} to {entry['high']:.{places}f})"


_TERMS = {
    "e0": "restitution e0 = {}",
    "e1_s_per_m": "falling with impact speed by e1 = {} s/m",
    "k_per_m": "air drag k = {} /m",
    "mu_up": "friction f = {} g",
}


def describe_choice(payload: dict[str, Any]) -> list[str]:
    """The verdict in sentences: parameters, error before and after, ties, what is not explained."""
    best, by_name = payload["best"], {model["name"]: model for model in payload["models"]}
    words = [f"Unexplained: {reason}." for reason in payload["unexplained_because"]]
    label = best if payload["explained"] else f"{best} (not believed)"
    parameters = by_name[best]["parameters"]
    terms = [form.format(with_interval(parameters[name])) for name, form in _TERMS.items() if name in parameters]
    words.append(f"{label}: {', '.join(terms)}; intervals are 95 %.")
    plainest = payload["models"][0]
    before, after = plainest["held_out_rms_ms"], by_name[best]["held_out_rms_ms"]
    if payload["impacts_s"]:  # else nothing is known in seconds
        if before is None or after is None:
            words.append("Too few bounces to hold any out: no effect beyond a constant restitution can be judged.")
        elif best == plainest["name"]:
            words.append(
                f"A constant restitution predicts held-out bounces to {before:.2f} ms; no more is beyond doubt."
            )
        else:
            words.append(f"{best}: held-out error {before:.2f} ms before (constant restitution), {after:.2f} ms after.")
    return words + ties_in_words(payload)


def ties_in_words(payload: dict[str, Any]) -> list[str]:
    """What the data cannot tell from the best model."""
    others = [name for name in payload["tie_set"] if name != payload["best"]]
    return [f"The data cannot tell {payload['best']} from {' or '.join(others)}."] if others else []
