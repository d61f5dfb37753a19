"""Falls without a bounce: causes of what free fall leaves, tried on drops that they were not fitted to, and the result:
one law, a table of balls, what each fall can tell and what it cannot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from analysis.drop import outcome
from analysis.drop.falls.fit import (
    AIR_KG_PER_M3,
    AXIS,
    OWN_AXIS,
    SPHERE,
    Axis,
    Fall,
    FallFit,
    Noise,
    Setting,
    Sizes,
    Values,
    fit_falls,
    heights_m,
)
from analysis.drop.laws import BounceModel, Candidate, Verdict, beyond_zero, choose, worth_of
from analysis.drop.outcome import Interval, around, interval, with_interval
from analysis.drop.thresholds import LARGEST_MISFIT, LEVEL_SIGMAS
from analysis.statistics import mad_sigma
from daq.setup.values import MeasuredValue
from kernels.arrays import Floats

# What each cause adds to free fall, by its name in words and in the JSON.
CAUSES = {
    "quadratic_drag": ("k_per_m",), "linear_drag": ("c_per_s",), "axis_distortion": (*AXIS, *OWN_AXIS),
    "release_speed": ("below_m",), "steady_wind": ("wind_mps",),
}  # fmt: skip
FREE_FALL = BounceModel("free_fall", ())
_TOGETHER = (
    ("quadratic_drag",), ("linear_drag",), ("axis_distortion",), ("quadratic_drag", "axis_distortion"),
    ("linear_drag", "axis_distortion"), ("quadratic_drag", "axis_distortion", "release_speed"),
    ("quadratic_drag", "axis_distortion", "steady_wind"),
)  # fmt: skip
_RICHEST = ("k_per_m", *AXIS, *OWN_AXIS)
_OPEN = (*_RICHEST, "wind_mps")  # what an interval of a drag leaves open
_OWN_AXES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08)  # by how much axes of drops may differ; each as likely beforehand


@dataclass(frozen=True)
class FallCandidate(Candidate[FallFit]):
    """A combination of causes, fitted to all falls."""

    _: KW_ONLY
    noise: Noise
    own: tuple[str, ...]  # parameters that are a drop's own, beyond its release
    shared: list[Values | None]  # of each fall: what the other falls say; None where its ball was dropped once
    held_out: list[Floats]  # of each fall: read less predicted with that, what is its own fitted to all of it, m


@dataclass(frozen=True)
class Judged:
    """Falls with everything that was fitted to them."""

    falls: list[Fall]
    setting: Setting
    noise: Noise
    verdict: Verdict[FallCandidate]
    # `held_out` of the model chosen where a drop's own axis comes from every other stretch of it: the error of the
    # stretches between
    between: list[Floats]
    uncalibrated: list[Floats]  # the same where only the release is the drop's own
    # Fits of drag with the distortion of the axis, and how likely each is: `_OWN_AXES` one after the other.
    fits: list[FallFit]
    odds: Floats
    gravity: tuple[float, float] | None  # g with its standard deviation; None: cannot be measured
    strays: int  # heights that were left out

    @property
    def best(self) -> FallCandidate:
        """The model chosen."""
        return self.verdict.candidate(self.verdict.best)

    @property
    def level(self) -> float:
        """Half of a 95 % interval in standard deviations: how axes of drops differ is known from so many drops only."""
        return float(stats.t.ppf(0.975, len(self.falls)))

    def estimate(self, name: str, owner: str = "") -> tuple[float, float]:
        """A parameter with its standard deviation, whatever the drops' own axes are."""
        return _mixed(self.fits, self.odds, name, owner)

    def interval(self, value: float, sigma: float) -> Interval:
        """A value with its 95 % interval."""
        return around(value, self.level * sigma)


def _mixed(fits: Sequence[FallFit], odds: Floats, name: str, owner: str) -> tuple[float, float]:
    """Mean and standard deviation of a parameter over fits of given odds."""
    value, sigma = np.array([(one.values[name][owner], one.sigmas[name][owner]) for one in fits]).T
    mean = float(odds @ value)
    return mean, float(np.sqrt(odds @ (sigma**2 + (value - mean) ** 2)))


def judge_falls(falls: Sequence[Fall], g_mps2: float, sizes: Sizes) -> Judged:
    """Fit every combination of causes and choose.

    Mass and diameter of a ball say how much air it displaces, and how much drag it may have.
    """
    count = sum(len(fall.time_s) for fall in falls)
    top, bottom = max(float(f.height_m.max()) for f in falls), min(float(f.height_m.min()) for f in falls)
    setting = Setting(Axis(0.5 * (top + bottom), 0.5 * (top - bottom)), g_mps2, sizes)  # an axis that all falls share
    noise = Noise(axis=_OWN_AXES[-1])
    first = fit_falls(falls, ("k_per_m",), setting, noise)  # from far away a distorted axis may stand for a strong drag
    for _ in range(3):  # residuals are correlated from sample to sample: how much one is worth sets what a prior weighs
        first = fit_falls(falls, _with_bulk(_RICHEST, falls, setting), setting, noise, near=first)
        # a height more than six standard deviations off is none of the ball's
        limit = 6.0 * max(mad_sigma(np.concatenate(first.left)), 0.02 * first.sigma_m)
        inside = [np.abs(left) < limit for left in first.left]
        falls = [replace(f, time_s=f.time_s[i], height_m=f.height_m[i]) for f, i in zip(falls, inside, strict=True)]
        left = [own[i] for own, i in zip(first.left, inside, strict=True)]
        spread = float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
        noise = replace(noise, sigma_m=max(first.sigma_m * spread / first.rms_m, 1e-9), worth=worth_of(left))
    fits, odds = _over_axes(falls, _OPEN, setting, noise, first)
    noise = replace(noise, axis=_OWN_AXES[int(odds.argmax())])
    near = fits[int(odds.argmax())]
    candidates = [_candidate(FREE_FALL, falls, setting, noise, None)]
    for causes in _TOGETHER:
        names = tuple(name for cause in causes for name in CAUSES[cause])
        candidates.append(_candidate(BounceModel("+".join(causes), names), falls, setting, noise, near))
    # beyond 1 m/s no ball that can be seen has a linear drag in air: a millimetre has Reynolds number 70
    fast = max(float(np.ptp(f.height_m) / np.ptp(f.time_s)) for f in falls) > 1.0
    verdict = Verdict(tuple(candidates), choose([c for c in candidates if not (fast and "c_per_s" in c.fit.names)]))
    best = verdict.candidate(verdict.best)
    tall = float(np.median([np.ptp(f.height_m) for f in falls]))
    doubts: tuple[str, ...] = ()
    if best.fit.rms_m > LARGEST_MISFIT * tall:
        doubts = (f"the best law leaves {best.fit.rms_m:.2f} m of falls of {tall:.1f} m",)
    gravity = None
    if len({f.ball for f in falls}) > 2:  # one ball's drag, its scale and the distortion take up any gravity
        free = _over_axes(falls, (*_OPEN, "g_mps2"), setting, noise, near)
        value, sigma = _mixed(*free, "g_mps2", "")
        bend = _mixed(*free, "bend", "")[0]
        # Nothing shows at which place of a distorted axis its scale is right: anywhere along it.
        gravity = value, float(np.hypot(sigma, value * 2.0 * abs(bend) / np.sqrt(3.0)))
    strays = count - sum(len(fall.time_s) for fall in falls)
    between = [_between(fall, best, shared, setting) for fall, shared in zip(falls, best.shared, strict=True)]
    bare = [
        np.empty(0) if shared is None else fit_falls([fall], (), setting, best.noise, shared, best.fit).left[0]
        for fall, shared in zip(falls, best.shared, strict=True)
    ]
    verdict = replace(verdict, doubts=doubts)
    return Judged(list(falls), setting, noise, verdict, between, bare, fits, odds, gravity, strays)


def _with_bulk(names: Sequence[str], falls: Sequence[Fall], setting: Setting) -> tuple[str, ...]:
    """Parameters with the air that balls of unknown size displace, where their drag is fitted."""
    is_open = "k_per_m" in names and any(fall.ball not in setting.sizes for fall in falls)
    return (*names, "bulk_m") if is_open else tuple(names)


def _over_axes(
    falls: Sequence[Fall], names: Sequence[str], setting: Setting, noise: Noise, near: FallFit | None
) -> tuple[list[FallFit], Floats]:
    """Fits for each size of the drops' own axes, and how likely each is."""
    fits = []
    names = _with_bulk(names, falls, setting)
    for axis in _OWN_AXES:
        used = names if axis else [name for name in names if name not in OWN_AXIS]
        fits.append(fit_falls(falls, used, setting, replace(noise, axis=axis), near=near))
    evidence = np.array([one.evidence for one in fits])
    odds = np.exp(evidence - evidence.max())
    return fits, odds / odds.sum()


def _candidate(
    model: BounceModel, falls: Sequence[Fall], setting: Setting, noise: Noise, near: FallFit | None
) -> FallCandidate:
    """A model with its error on each drop whose ball was dropped again, and how well the others foretell that drop.

    The score of a drop is the probability of its heights given the other drops, every parameter integrated out: what
    is fitted to the drop itself, its own axis, is so paid for by how much of its prior the drop rules out.
    """
    names = _with_bulk([n for n in model.parameters if noise.axis or n not in OWN_AXIS], falls, setting)
    if not set(OWN_AXIS) & set(names):  # what such a law leaves is its noise
        noise = replace(noise, sigma_m=max(fit_falls(falls, names, setting, noise, near=near).sigma_m, 1e-9))
    fit = fit_falls(falls, names, setting, noise, near=near)
    drops_of = Counter(fall.ball for fall in falls)
    own = tuple(name for name in names if name in (*OWN_AXIS, "below_m"))
    scores, shared = np.zeros(len(falls)), list[Values | None]([None] * len(falls))
    held_out = [np.empty(0)] * len(falls)
    for i, fall in enumerate(falls):
        if drops_of[fall.ball] < 2:
            continue
        others = fit_falls([*falls[:i], *falls[i + 1 :]], names, setting, noise, near=fit)
        scores[i] = fit.evidence - others.evidence
        shared[i] = {name: table for name, table in others.values.items() if name not in own}
        held_out[i] = fit_falls([fall], own, setting, noise, shared[i], fit).left[0]
    left = np.concatenate(held_out)
    rms = float(np.sqrt(np.mean(left**2))) if len(left) else float("nan")
    said = {
        name: [(value, LEVEL_SIGMAS * fit.sigmas[name][owner]) for owner, value in fit.values[name].items()]
        for name in fit.names
    }
    common = {name: numbers[0] for name, numbers in said.items() if "" in fit.values[name]}
    # Each cause is beyond zero for one ball or drop at least; a distortion of the axis is judged by drops not fitted.
    judged = [name for name in fit.names if name not in (*AXIS, *OWN_AXIS, "bulk_m")]
    significant = all(any(beyond_zero({name: numbers}) for numbers in said[name]) for name in judged)
    return FallCandidate(
        model, scores, fit.rms_m, rms, bool(len(left)), fit, common, significant,
        gains_add_up=True,  # a light ball needs drag where a heavy one does not
        noise=noise, own=own, shared=shared, held_out=held_out,
    )  # fmt: skip


def _between(fall: Fall, best: FallCandidate, shared: Values | None, setting: Setting) -> Floats:
    """What is left of inner eighths of a drop whose release and own axis come from the rest of it, m.

    Not of the first and the last eighth: an axis is not foretold beyond what was seen of it.
    """
    if shared is None:
        return np.empty(0)
    part, left = np.arange(len(fall.time_s)) * 8 // len(fall.time_s), np.zeros(len(fall.time_s))
    for held in (np.isin(part, (1, 5)), np.isin(part, (2, 6)), np.isin(part, (3,)), np.isin(part, (4,))):
        seen = replace(fall, time_s=fall.time_s[~held], height_m=fall.height_m[~held])
        values = {**shared, **fit_falls([seen], best.own, setting, best.noise, shared, best.fit).values}
        left[held] = fall.height_m[held] - heights_m(values, setting, [fall], [fall.time_s[held]])
    return left[(part > 0) & (part < 7)]


_IN_WORDS = {
    "quadratic_drag": "quadratic drag of the ball",
    "linear_drag": "linear drag of the ball",
    "axis_distortion": "distortion of the axis of heights, a part of it the same for all and a part of each drop's own",
    "release_speed": "release with a speed",
    "steady_wind": "steady wind along the fall",
}


def of_falls(judged: Judged) -> outcome.Outcome:
    """Result of falls whose law was chosen."""
    best, verdict, falls, axis = judged.best, judged.verdict, judged.falls, judged.setting.axis
    fit, is_bent = best.fit, "bend" in best.fit.names
    # `None` where errors are not in seconds, as those of bounces are
    models = [outcome.model_json(c, dict.fromkeys(c.fit.names, 1.0), 1.0, "m") for c in verdict.candidates]
    balls = [_ball(judged, ball) for ball in dict.fromkeys(f.ball for f in falls)]
    payload = outcome.payload_of("falls", [f.name for f in falls], [], verdict, outcome.UNKNOWN) | {
        "models": [one | {"rms_ms": None, "held_out_rms_ms": None} for one in models],
        "balls": balls,
        "drops": [
            {
                "file": fall.name,
                "ball": fall.ball,
                "samples": len(fall.time_s),
                "release_s": fit.values["release_s"][fall.name],
                "scale": around(
                    fit.values["own_scale"][fall.name], LEVEL_SIGMAS * fit.sigmas["own_scale"][fall.name]
                ) if "own_scale" in fit.names else None,
                "rms_m": _rms(fit.left, [i]),
                "held_out_rms_m": _rms(best.held_out, [i]),
                "held_out_uncalibrated_rms_m": _rms(judged.uncalibrated, [i]),
            }
            for i, fall in enumerate(falls)
        ],
        "g_mps2": None if judged.gravity is None else judged.interval(*judged.gravity),
        "axis": {
            "bend": judged.interval(*judged.estimate("bend")) if is_bent else None,
            "own": judged.noise.axis if is_bent else None,
            "middle_m": axis.middle_m,
            "reach_m": axis.reach_m,
        },
        "independent_samples_per_sample": judged.noise.worth,
    }  # fmt: skip
    measured = []
    if len(balls) == 1 and not verdict.doubts and balls[0]["drag"] == "measured":
        k = balls[0]["k_per_m"]
        numbers = round(k["value"], 8), round(outcome.sigma_of(k) or 0.0, 8)
        source = f"falls, {len(falls)} drop(s) ({falls[0].name}), {verdict.best}"
        measured = [MeasuredValue("declared.quadratic_drag.k_per_m", *numbers, source)]
    return outcome.Outcome(payload, _in_words(judged, payload), measured)


def _ball(judged: Judged, ball: str) -> dict[str, Any]:
    """What one ball's drops tell: drag, terminal speed, coefficient, error before and after on drops not fitted."""
    own = [i for i, fall in enumerate(judged.falls) if fall.ball == ball]
    plain, best, setting = judged.verdict.candidates[0], judged.best, judged.setting
    mass_kg, diameter_m = setting.sizes.get(ball, (None, None))
    entry: dict[str, Any] = {
        "ball": ball, "drops": len(own), "mass_kg": mass_kg, "diameter_m": diameter_m,
        "rms_m": {"before": _rms(plain.fit.left, own), "after": _rms(best.fit.left, own)},
        "held_out_rms_m": {
            "before": _rms(plain.held_out, own), "after": _rms(best.held_out, own),
            "after_between": _rms(judged.between, own), "after_uncalibrated": _rms(judged.uncalibrated, own),
        },
        "k_per_m": None, "drag": "cannot be told", "terminal_mps": None, "drag_coefficient": None,
    }  # fmt: skip
    if "k_per_m" not in best.fit.names:
        return entry
    k, sigma = judged.estimate("k_per_m", ball)
    unit = setting.drag_per_m(ball)
    # What the falls themselves say: what was known of spheres is taken out of the value and of its weight.
    weight, pull = 1.0 / sigma**2, k / sigma**2
    if unit is not None:
        weight, pull = weight - 1.0 / (SPHERE[1] * unit) ** 2, pull - SPHERE[0] / (SPHERE[1] ** 2 * unit)
    low, high = k - judged.level * sigma, k + judged.level * sigma
    entry["k_per_m"] = judged.interval(k, sigma)
    if is_measured := len(own) > 1 and weight > 0.0 and pull > judged.level * np.sqrt(weight):
        entry["drag"] = "measured"
        if low > 0.0:
            entry["terminal_mps"] = interval(*(float(np.sqrt(setting.g_mps2 / x)) for x in (k, high, low)))
    if unit is not None and diameter_m is not None:
        entry["drag_coefficient"] = interval(k / unit, max(low, 0.0) / unit, high / unit)
        fast = 2.0 * max(float(np.ptp(judged.falls[i].height_m) / np.ptp(judged.falls[i].time_s)) for i in own)
        entry["reynolds"] = AIR_KG_PER_M3 * fast * diameter_m / 1.8e-5  # over the viscosity of air, Pa s
        # beyond a Reynolds number of 2e5 a sphere's drag coefficient may fall to a fifth: none is known there
        if is_measured and entry["reynolds"] < 2e5:
            per = AIR_KG_PER_M3 / unit
            # below it the coefficient of a sphere is 0.4 to 0.6, smooth or rough
            entry["air_kg_per_m3"] = interval(*(x * per for x in (k / 0.5, max(low, 0.0) / 0.6, high / 0.4)))
    return entry


def _rms(left: Sequence[Floats], own: Sequence[int]) -> float | None:
    parts = [left[i] for i in own if len(left[i])]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) if parts else None


def _in_words(judged: Judged, payload: dict[str, Any]) -> list[str]:
    """The verdict for a person; a line for each ball."""
    best, verdict, balls = judged.best, judged.verdict, payload["balls"]
    words = [f"{len(judged.falls)} fall(s) of {len(balls)} ball(s), no bounce."]
    if judged.strays:
        words.append(f"{judged.strays} height(s) far from any fall were left out.")
    words += [f"Unexplained: {reason}." for reason in payload["unexplained_because"]]
    causes = "; ".join(_IN_WORDS[c] for c in best.model.name.split("+") if c in _IN_WORDS)
    words.append(f"{best.model.name}: {causes or 'nothing beyond free fall is beyond doubt'}")
    before, after = verdict.candidates[0].held_out_rms, best.held_out_rms
    is_own = any(name in best.fit.names for name in OWN_AXIS)
    if np.isfinite(after):
        own = "release and own axis are its own" if is_own else "release is its own"
        words.append(
            f"Error on drops not fitted (each by the other drops of its ball; its {own}): {100 * before:.0f} cm for "
            f"free fall, {100 * after:.0f} cm after; {100 * best.rms:.0f} cm on drops fitted."
        )
        if is_own:
            between, bare = (
                100 * (_rms(one, range(len(judged.falls))) or 0.0) for one in (judged.between, judged.uncalibrated)
            )
            words.append(
                f"Where its own axis comes from other stretches of it: {between:.0f} cm; where only the release is "
                f"fitted to a drop: {bare:.0f} cm after."
            )
    else:
        words.append("No ball was dropped twice: nothing beyond free fall can be borne out by another drop.")
    words += outcome.ties_in_words(payload)
    instead = best.model.name.replace("quadratic_drag", "linear_drag")
    linear = next((c for c in verdict.candidates if c.model.name == instead), best)
    if linear is not best and float(linear.scores.sum()) > float(best.scores.sum()):
        words.append("A linear drag fits as well, but no ball in air has one at such speeds (Stokes).")
    words += [_ball_in_words(one) for one in balls]
    axis, g = payload["axis"], payload["g_mps2"]
    if axis["bend"] is not None:
        words.append(
            f"axis of heights: bend {with_interval(axis['bend'])} of {axis['reach_m']:.0f} m, one for all: in its "
            f"middle heights are read wrong by so much; axes of drops differ by {100 * axis['own']:.0f} %"
        )
    if g is None:
        words.append("g cannot be told from fewer than three balls: the axis takes up any. It was taken as known.")
    else:
        words.append(f"g, free with the distortion of the axis: {with_interval(g)} m/s^2")
    errors = [(d["held_out_rms_m"], d["file"]) for d in payload["drops"] if d["held_out_rms_m"] is not None]
    usual = float(np.median([e for e, _ in errors])) if errors else 0.0
    words += [f"{name} does not follow: {100 * e:.0f} cm where {100 * usual:.0f} are usual" for e, name in errors
              if e > 3.0 * usual]  # fmt: skip
    return words


def _ball_in_words(one: dict[str, Any]) -> str:
    """One row of the table of balls."""
    held, fitted = one["held_out_rms_m"], one["rms_m"]
    kind, pair = ("not fitted", held) if held["after"] is not None else ("fitted", fitted)
    words = f"  {one['ball']}: {100 * pair['before']:.0f} -> {100 * pair['after']:.0f} cm ({kind})"
    if one["k_per_m"] is None or one["drag"] != "measured":
        high = one["k_per_m"]["high"] if one["k_per_m"] else None
        return f"{words}; drag cannot be told" + (f" (below {high:.3f} /m)" if high else "")
    words += f"; k {with_interval(one['k_per_m'])} /m"
    if one["terminal_mps"]:
        words += f", terminal speed {with_interval(one['terminal_mps'])} m/s"
    if one["drag_coefficient"]:
        words += f", drag coefficient {with_interval(one['drag_coefficient'])} at Reynolds {one['reynolds']:.0e}"
    if "air_kg_per_m3" in one:
        words += f", density of air {with_interval(one['air_kg_per_m3'])} kg/m^3"
    return words
