"""Results of falls without a bounce: one law, a table of balls, what each fall can tell and what it cannot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from analysis.drop import outcome
from analysis.drop.falls.judge import FallCandidate, Judged
from analysis.drop.outcome import around, interval, with_interval
from kernels.arrays import Floats

AIR_KG_PER_M3 = 1.2
AIR_PA_S = 1.8e-5
_DRAG_CRISIS = 2e5  # Reynolds number beyond which a sphere's drag coefficient may fall to a fifth
_SPHERE = (0.4, 0.6)  # drag coefficient of a sphere below it, smooth or rough
_OUTLIER = 3.0  # errors on drops not fitted, over their median
_IN_WORDS = {
    "quadratic_drag": "quadratic drag of the ball",
    "linear_drag": "linear drag of the ball",
    "axis_distortion": "distortion of the axis of heights, the same for all",
    "axis_scale": "scale of each drop (its distance from the camera; buoyancy and a wrong clock look the same)",
    "release_speed": "release with a speed",
    "steady_wind": "steady wind along the fall",
}

Sizes = Mapping[str, tuple[float, float]]  # ball -> mass, kg, and diameter, m


def weight_shares(sizes: Sizes) -> dict[str, float]:
    """Acceleration of each ball at rest over gravity: buoyancy, and half of the displaced air that moves with it."""
    out = {}
    for ball, (mass_kg, diameter_m) in sizes.items():
        air = AIR_KG_PER_M3 * np.pi / 6.0 * diameter_m**3 / mass_kg
        out[ball] = float((1.0 - air) / (1.0 + 0.5 * air))
    return out


def of_falls(judged: Judged, sizes: Sizes) -> outcome.Outcome:
    """Result of falls.

    Parameters
    ----------
    judged
        The law that was chosen, with everything fitted.
    sizes
        Mass and diameter of balls, where known.
    """
    best, verdict, falls, axis = judged.best, judged.verdict, judged.falls, judged.setting.axis
    payload = outcome.payload_of("falls", [f.name for f in falls], [], verdict, outcome.UNKNOWN)
    balls = [_ball(judged, ball, sizes.get(ball)) for ball in dict.fromkeys(f.ball for f in falls)]
    scales = best.fit.values.get("scale", {})
    payload |= {
        "models": [_model(one) for one in verdict.candidates],
        "balls": balls,
        "drops": [
            {
                "file": fall.name,
                "ball": fall.ball,
                "samples": len(fall.time_s),
                "release_s": best.fit.values["release_s"][fall.name],
                "scale": around(scales[fall.name], best.half("scale", fall.name)) if scales else None,
                "rms_m": _rms(best.fit.left, [i]),
                "held_out_rms_m": _rms(best.held_out, [i]),
                "held_out_unscaled_rms_m": _rms(best.unscaled, [i]),
            }
            for i, fall in enumerate(falls)
        ],
        "g_mps2": None if judged.gravity is None else around(*judged.gravity),
        "axis": {
            "bend": around(best.fit.values["bend"][""], best.half("bend", "")) if "bend" in best.fit.names else None,
            "middle_m": axis.middle_m,
            "reach_m": axis.reach_m,
        },
        "independent_samples_per_sample": judged.worth,
    }
    measured = []
    if len(balls) == 1 and not verdict.doubts and balls[0]["drag"] == "measured":
        k = balls[0]["k_per_m"]
        sigma = outcome.sigma_of(k) or 0.0
        source = f"falls, {len(falls)} drop(s) ({falls[0].name}), {verdict.best}"
        measured = [outcome.Measured("quadratic_drag", "k_per_m", round(k["value"], 8), round(sigma, 8), source)]
    return outcome.Outcome(payload, _in_words(judged, payload), measured)


def _model(one: FallCandidate) -> dict[str, Any]:
    """A combination of causes for the JSON; what belongs to a ball or a drop is in ``balls`` and ``drops``."""
    common = [name for name in one.fit.names if "" in one.fit.values[name]]
    return {
        "name": one.model.name,
        "parameters": {name: around(one.fit.values[name][""], one.half(name, "")) for name in common},
        "rms_m": one.rms,
        "held_out_rms_m": one.held_out_rms if np.isfinite(one.held_out_rms) else None,
        "rms_ms": None,
        "held_out_rms_ms": None,
        "identifiable": one.identifiable,
        "zero_excluded": one.significant,
        "plausible": one.plausible,
    }


def _ball(judged: Judged, ball: str, size: tuple[float, float] | None) -> dict[str, Any]:
    """What one ball's drops tell: drag, terminal speed, coefficient, error before and after on drops not fitted."""
    own = [i for i, fall in enumerate(judged.falls) if fall.ball == ball]
    plain, best = judged.verdict.candidates[0], judged.best
    entry: dict[str, Any] = {
        "ball": ball,
        "drops": len(own),
        "rms_m": {"before": _rms(plain.fit.left, own), "after": _rms(best.fit.left, own)},
        "held_out_rms_m": {
            "before": _rms(plain.held_out, own),
            "after": _rms(best.held_out, own),
            "after_unscaled": _rms(best.unscaled, own),
        },
        "mass_kg": size[0] if size else None,
        "diameter_m": size[1] if size else None,
        "k_per_m": None, "drag": "cannot be told", "terminal_mps": None, "drag_coefficient": None,
    }  # fmt: skip
    if "k_per_m" not in best.fit.names:
        return entry
    k, low, high = judged.drag_of(ball)
    entry |= {"k_per_m": interval(k, low, high), "drag": "measured" if low > 0.0 and len(own) > 1 else "cannot be told"}
    if entry["drag"] == "measured":
        entry["terminal_mps"] = interval(*(float(np.sqrt(judged.setting.g_mps2 / x)) for x in (k, high, low)))
    if size is not None:
        mass, diameter = size
        per = mass / (0.5 * AIR_KG_PER_M3 * 0.25 * np.pi * diameter**2)
        entry["drag_coefficient"] = interval(k * per, max(low, 0.0) * per, high * per)
        fast = max(float(np.ptp(judged.falls[i].height_m) / np.ptp(judged.falls[i].time_s)) for i in own) * 2.0
        entry["reynolds"] = AIR_KG_PER_M3 * fast * diameter / AIR_PA_S
        if entry["drag"] == "measured" and entry["reynolds"] < _DRAG_CRISIS:  # beyond it no coefficient is known
            middle, ends = sum(_SPHERE) / 2.0, (low / _SPHERE[1], high / _SPHERE[0])
            entry["air_kg_per_m3"] = interval(*(x * per * AIR_KG_PER_M3 for x in (k / middle, *ends)))
    return entry


def _rms(left: Sequence[Floats], own: Sequence[int]) -> float | None:
    parts = [left[i] for i in own if len(left[i])]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) if parts else None


def _in_words(judged: Judged, payload: dict[str, Any]) -> list[str]:
    """The verdict for a person; a line for each ball."""
    best, verdict, balls = judged.best, judged.verdict, payload["balls"]
    words = [f"{len(judged.falls)} fall(s) of {len(balls)} ball(s), no bounce."]
    words += [f"Unexplained: {reason}." for reason in payload["unexplained_because"]]
    causes = "; ".join(_IN_WORDS[c] for c in best.model.name.split("+") if c in _IN_WORDS)
    words.append(f"{best.model.name}: {causes or 'nothing beyond free fall is beyond doubt'}")
    before, after = verdict.candidates[0].held_out_rms, best.held_out_rms
    if np.isfinite(after):
        own = "scale and release are its own" if "scale" in best.fit.names else "release is its own"
        words.append(
            f"Error on drops not fitted (each by the other drops of its ball; its {own}): {100 * before:.0f} cm for "
            f"free fall, {100 * after:.0f} cm after; {100 * best.rms:.0f} cm on drops fitted."
        )
        if "scale" in best.fit.names:
            unscaled = _rms(best.unscaled, range(len(judged.falls))) or 0.0
            words.append(f"Where a drop's scale is not fitted to it: {100 * unscaled:.0f} cm after.")
    else:
        words.append("No ball was dropped twice: nothing beyond free fall can be borne out by another drop.")
    words += outcome.ties_in_words(payload)
    instead = best.model.name.replace("quadratic_drag", "linear_drag")
    if not best.plausible:
        words.append("A scale is more than 15 % off: no distance from the camera makes that; clock or marks are wrong.")
    linear = next((c for c in verdict.candidates if c.model.name == instead), best)
    if linear is not best and linear.held_out_rms < 1.1 * best.held_out_rms:
        words.append("A linear drag fits as well, but no ball in air has one at such speeds (Stokes).")
    words += [_ball_in_words(one) for one in balls]
    bend, g = payload["axis"]["bend"], payload["g_mps2"]
    if bend is not None:
        words.append(
            f"axis of heights: bend {with_interval(bend)} of {judged.setting.axis.reach_m:.0f} m, one for all: in its "
            "middle heights are read wrong by so much"
        )
    if g is None:
        words.append("g cannot be told from fewer than three balls: the axis takes up any. It was taken as known.")
    else:
        words.append(f"g, free with the distortion of the axis: {with_interval(g)} m/s^2")
    errors = [(d["held_out_rms_m"], d["file"]) for d in payload["drops"] if d["held_out_rms_m"] is not None]
    usual = float(np.median([e for e, _ in errors])) if errors else 0.0
    words += [f"{name} does not follow: {100 * e:.0f} cm where {100 * usual:.0f} are usual" for e, name in errors
              if e > _OUTLIER * usual]  # fmt: skip
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
    words += f", terminal speed {with_interval(one['terminal_mps'])} m/s"
    if one["drag_coefficient"]:
        words += f", drag coefficient {with_interval(one['drag_coefficient'])} at Reynolds {one['reynolds']:.0e}"
    if "air_kg_per_m3" in one:
        words += f", density of air {with_interval(one['air_kg_per_m3'])} kg/m^3"
    return words
