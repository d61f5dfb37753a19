"""Results of falls without a bounce: one law, a table of balls, what each fall can tell and what it cannot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.drop import outcome
from analysis.drop.falls.fit import AIR_KG_PER_M3, OWN_AXIS, SPHERE
from analysis.drop.falls.judge import Judged
from analysis.drop.outcome import around, interval, with_interval
from analysis.drop.thresholds import LEVEL_SIGMAS
from daq.setup.values import MeasuredValue
from kernels.arrays import Floats

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
