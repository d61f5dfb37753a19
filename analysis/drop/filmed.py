"""Results of a camera's drops, in SI units.

Restitution and friction are ratios and need neither scale nor frame rate. Speeds, drag and gravity need both: with a
scale, gravity is measured and must come out as gravity; without one, gravity gives the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film.camera_fit import CameraCandidate, CameraFit
from analysis.drop.film.camera_verdict import judge_camera, refuse_other_motion, with_doubts
from analysis.drop.film.steadiness import floor_in_words
from analysis.drop.film.trajectory import SHAPES
from analysis.drop.outcome import (
    CONTRADICTION_SIGMAS,
    LEVEL_SIGMAS,
    Outcome,
    declared_as,
    describe_choice,
    interval,
    milliseconds,
    of_draws,
    pooled_height,
    with_interval,
)
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_FAR_FROM_G = (0.7, 1.4)
_SAME_G = 5e-3  # relative, that nobody's scale or frame rate is better than
_SCALE_FLOOR = 1e-3  # relative uncertainty of any scale: lenses are not even along the fall
_TALLEST_FALL_M, _LARGEST_BALL_M = 2.5, 0.3  # beyond which a film was played slower than it was taken


@dataclass(frozen=True)
class Units:
    """What turns frames and pixels into seconds and metres.

    Attributes
    ----------
    frame_s : float or None
        Seconds a frame; None where nobody said.
    frame_rate_uncertainty, scale_uncertainty : float
        Relative, one standard deviation.
    scale_m : float or None
        Metres a unit of height; None: taken from gravity.
    g_mps2 : float
    assumed_rate : bool
        The frame rate is the film's playback rate, which nobody confirmed.
    ball : float or None
        Height of the ball, in the file's unit.
    """

    frame_s: float | None
    scale_m: float | None
    g_mps2: float
    scale_uncertainty: float = 0.0
    frame_rate_uncertainty: float = 0.0
    assumed_rate: bool = False
    ball: float | None = None


def of_camera(names: Sequence[str], fit: CameraFit, units: Units, rng: np.random.Generator) -> Outcome:
    """Result of films or tracked positions.

    Raises
    ------
    InputError
        The motion is no fall with bounces; with scale and frame rate, its acceleration is nowhere near gravity; or
        the fall is taller than any, because a film in slow motion was read at its playback rate.
    """
    refuse_other_motion(fit, names[0])
    verdict = judge_camera(fit)
    candidate = verdict.best
    measured_g = _gravity(fit, candidate.shape, units, names[0])
    g_fit = float(fit.shapes[candidate.shape].values[0])
    frame_s = units.frame_s if units.frame_s is not None else float(np.sqrt(g_fit / units.g_mps2))
    scale = units.scale_m if units.scale_m is not None else units.g_mps2 * frame_s**2 / g_fit
    timed = units.frame_s is not None
    height = _height(fit, candidate, scale, units, timed)
    _refuse_slow_motion(names[0], fit, candidate, units, scale)
    quality = _quality(fit)
    verdict = with_doubts(verdict, _doubts(quality, measured_g, fit, candidate, units))
    seen = fit.impacts[candidate.shape]
    payload: dict[str, Any] = {
        "kind": "camera",
        "files": list(names),
        "impacts_s": (seen.frame * frame_s).tolist() if timed else [],
        "impacts_frames": seen.frame.tolist(),
        "models": [_model(r, fit, frame_s, scale, timed) for r in fit.candidates],
        "chosen": verdict.chosen,
        "best": candidate.model.name,
        "explained": not verdict.doubts,
        "unexplained_because": list(verdict.doubts),
        "tie_set": list(verdict.tie_set),
        "drop_height_m": height,
        "restitution": _bounces(fit, candidate, frame_s, scale, timed),
        "friction": _friction(fit),
        "friction_up_down": _one_sided(fit, units),
        "acceleration_mps2": _accelerations(fit, units, frame_s, scale, rng) if timed else None,
        "g_mps2": measured_g,
        "scale_m_per_unit": {"value": scale if timed else None, "from_gravity": units.scale_m is None},
        "fit": quality,
        "flights": _flights(fit, candidate, frame_s, scale, timed),
    }
    words = _in_words(payload, units, len(names))
    if units.assumed_rate and units.frame_s is not None:
        size = f", a ball {1e3 * scale * units.ball:.0f} mm high," if units.ball else ""
        words.append(
            f"The {1.0 / units.frame_s:.4g} frames a second are those at which the film plays. If that fall{size} or "
            "the speeds look too large, it was filmed faster: say --fps; restitution and friction stay as they are."
        )
    declared = [] if verdict.doubts else _declared(candidate, fit, frame_s, scale, timed, names)
    return Outcome(payload, words, declared)


def _refuse_slow_motion(where: str, fit: CameraFit, candidate: CameraCandidate, units: Units, scale: float) -> None:
    """A film whose playback rate would make the fall, or the ball, larger than any."""
    if not units.assumed_rate or units.frame_s is None:
        return
    fall = float(np.nanmax(fit.fall_height[candidate.shape][0], initial=0.0)) * scale
    ball = (units.ball or 0.0) * scale
    if fall > _TALLEST_FALL_M or ball > _LARGEST_BALL_M:
        size = f" and a ball of {ball:.2g} m" if units.ball else ""
        raise InputError(
            f"{where}: at its playback rate of {1.0 / units.frame_s:.4g} frames per second it would show a fall of "
            f"{fall:.1f} m{size}: it was filmed faster. Say --fps with the rate of the camera (or the file's own, if "
            "it is so)"
        )


def _doubts(
    quality: dict[str, Any], g: dict[str, float | None] | None, fit: CameraFit, candidate: CameraCandidate, units: Units
) -> list[str]:
    """What contradicts the model, in words."""
    words = list(fit.moved)
    seen, fall = fit.impacts[candidate.shape], float(np.nanmax(fit.fall_height[candidate.shape][0], initial=0.0))
    uneven = floor_in_words(seen.clip, seen.floor, seen.floor_draws, fall) if fall > 0.0 else None
    if uneven is not None:
        words.append(uneven)
    if not quality["some_shape_fits"]:
        best = min(quality["rms"].values())
        words.append(
            f"no shape of flight fits: the best leaves {best:.2f} units rms where positions are good to "
            f"{quality['noise']:.2f} (a lens, a camera that moves, frames at uneven times)"
        )
    if g is not None and g["low"] is not None and g["high"] is not None and g["value"] is not None:
        sigma = max((g["high"] - g["low"]) / (2 * LEVEL_SIGMAS), 1e-9)
        off = g["value"] - units.g_mps2
        if abs(off) > max(CONTRADICTION_SIGMAS * sigma, _SAME_G * units.g_mps2):
            more = ""
            both = _one_sided(fit, units)
            if "mu" in candidate.model.parameters and both is not None:
                more = (
                    f"; if both are right, friction differs: {with_interval(both['up'])} g going up, "
                    f"{with_interval(both['down'])} g coming down"
                )
            words.append(
                f"gravity comes out as {g['value']:.3f} m/s^2, {off / sigma:+.1f} sigma from {units.g_mps2:.3f}: the "
                f"scale or the frame rate is wrong{more}"
            )
    return words


def _one_sided(fit: CameraFit, units: Units) -> dict[str, dict[str, float | None]] | None:
    """Friction going up and coming down, each by itself, by the gravity that is known; None without a scale."""
    if units.frame_s is None or units.scale_m is None:
        return None
    g = fit.values["friction"][:, 0] * units.scale_m / units.frame_s**2 / units.g_mps2
    f = fit.values["friction"][:, 1]
    value = fit.shapes["friction"].values
    g0 = float(value[0]) * units.scale_m / units.frame_s**2 / units.g_mps2
    common = float(np.hypot(units.scale_uncertainty, 2.0 * units.frame_rate_uncertainty))
    out = {}
    for name, sign in (("up", 1.0), ("down", -1.0)):
        at = sign * (g0 * (1.0 + sign * float(value[1])) - 1.0)
        half = LEVEL_SIGMAS * float(np.hypot((g * (1.0 + sign * f)).std(), common))
        out[name] = interval(at, at - half, at + half)
    return out


def _flights(
    fit: CameraFit, candidate: CameraCandidate, frame_s: float, scale: float, timed: bool
) -> list[dict[str, Any]]:
    """Each flight's file, order, first and last frame, and apex."""
    shape = fit.shapes[candidate.shape]
    unit = frame_s if timed else 1.0
    return [
        {
            "file": flight.clip,
            "order": flight.order,
            "first_frame": float(flight.frame[0]),
            "last_frame": float(flight.frame[-1]),
            "samples": len(flight.frame),
            "apex_s" if timed else "apex_frame": float(shape.apex_frame[i]) * unit,
        }
        for i, flight in enumerate(fit.flights)
    ]


def _gravity(fit: CameraFit, shape_name: str, units: Units, where: str) -> dict[str, float | None] | None:
    """Measured gravity where scale and frame rate are known; refused where it is not gravity."""
    if units.frame_s is None or units.scale_m is None:
        return None
    factor = units.scale_m / units.frame_s**2
    shape = fit.shapes[shape_name]
    value = float(shape.values[0]) * factor
    ratio = value / units.g_mps2
    if not _FAR_FROM_G[0] < ratio < _FAR_FROM_G[1]:
        fps = 1.0 / units.frame_s / np.sqrt(ratio)
        raise InputError(
            f"{where}: the ball falls at {value:.3g} m/s^2, {ratio:.3g} times gravity: the frame rate "
            f"{1 / units.frame_s:.4g} or the scale {units.scale_m:.4g} m is wrong; {fps:.4g} frames per second, or a "
            f"scale of {units.scale_m / ratio:.4g} m, would make it gravity"
        )
    common = np.hypot(np.hypot(units.scale_uncertainty, _SCALE_FLOOR), 2.0 * units.frame_rate_uncertainty)
    sigma = value * float(np.hypot(fit.values[shape_name][:, 0].std() / shape.values[0], common))
    return interval(value, value - LEVEL_SIGMAS * sigma, value + LEVEL_SIGMAS * sigma)


def _si(name: str, value: Any, frame_s: float, scale: float) -> Any:
    """A parameter from file units."""
    return value * {"e0": 1.0, "e1_s_per_m": frame_s / scale, "k_per_m": 1.0 / scale, "mu": 1.0}[name]


def _parameters(candidate: CameraCandidate, fit: CameraFit) -> dict[str, tuple[float, float]]:
    """Values and half widths of a candidate in file units."""
    out = {"e0": (float(candidate.law.theta[0]), float(candidate.law.half_width[0]))}
    if "e1_s_per_m" in candidate.model.parameters:
        out["e1_s_per_m"] = (float(candidate.law.theta[1]), float(candidate.law.half_width[1]))
    for name, key in (("mu", "f"), ("k_per_m", "k")):
        if name in candidate.model.parameters:
            column = SHAPES[candidate.shape].index(key)
            draws = fit.values[candidate.shape][:, column]
            out[name] = (float(fit.shapes[candidate.shape].values[column]), LEVEL_SIGMAS * float(draws.std()))
    return out


def _model(candidate: CameraCandidate, fit: CameraFit, frame_s: float, scale: float, timed: bool) -> dict[str, Any]:
    parameters: dict[str, Any] = {}
    law = candidate.law
    for name, (value, half) in _parameters(candidate, fit).items():
        if not timed and name in ("e1_s_per_m", "k_per_m"):
            continue  # would need a speed or a length
        low = max(value - half, 0.0) if name in ("k_per_m", "e0") else value - half
        entry = interval(*(_si(name, v, frame_s, scale) for v in (value, low, value + half)))
        for key in ("mu_up", "mu_down") if name == "mu" else (name,):
            parameters[key] = entry
    factor = frame_s if timed else np.nan
    return {
        "name": candidate.model.name,
        "parameters": parameters,
        "rms_ms": milliseconds(_rms(candidate.residual_frames) * factor),
        "held_out_rms_ms": milliseconds(_rms(candidate.held_out_frames) * factor),
        "zero_excluded": candidate.significant,
        "restitution_scatter": law.scatter,
        "chi_square": {"value": law.chi_square, "freedom": law.freedom, "chance": law.chance},
        "covariance": {
            "of": [name for name in SHAPES[candidate.shape]],
            "matrix": fit.shapes[candidate.shape].covariance.tolist(),
            "unit": "the file's unit and frames",
        },
        "identifiable": bool(np.isfinite(law.half_width).all()),
    }


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else np.nan


def _height(
    fit: CameraFit, candidate: CameraCandidate, scale: float, units: Units, timed: bool
) -> dict[str, float | None]:
    """Height from which the ball fell freely to its first impact."""
    values, draws = fit.fall_height[candidate.shape]
    if not timed and units.scale_m is None:
        return interval(np.nan, np.nan, np.nan)
    g_draws = fit.values[candidate.shape][:, 0] / float(fit.shapes[candidate.shape].values[0])
    out = []
    for value, own in zip(values, draws.T, strict=True):
        sigma = float(np.std(own / (g_draws if units.scale_m is None else 1.0))) / max(float(value), 1e-12)
        shared = 2.0 * units.frame_rate_uncertainty if units.scale_m is None else units.scale_uncertainty
        reach = LEVEL_SIGMAS * float(np.hypot(sigma, shared))
        out.append(interval(value * scale, value * scale * (1 - reach), value * scale * (1 + reach)))
    return pooled_height(out)


def _bounces(
    fit: CameraFit, candidate: CameraCandidate, frame_s: float, scale: float, timed: bool
) -> list[dict[str, Any]]:
    seen = fit.impacts[candidate.shape]
    out = []
    for i in np.flatnonzero(seen.bounced):
        ratio = float(seen.speed_out[i] / seen.speed_in[i])
        entry: dict[str, Any] = {"file": int(seen.clip[i]), "impact_frame": float(seen.frame[i])}
        if timed:
            entry |= {
                "impact_s": float(seen.frame[i]) * frame_s,
                "speed_in_mps": float(seen.speed_in[i]) * scale / frame_s,
                "speed_out_mps": float(seen.speed_out[i]) * scale / frame_s,
            }
        entry["restitution"] = of_draws(ratio, seen.out_draws[:, i] / seen.in_draws[:, i])
        out.append(entry)
    return out


def _friction(fit: CameraFit) -> dict[str, float | None]:
    value = float(fit.shapes["friction"].values[1])
    half = LEVEL_SIGMAS * float(fit.values["friction"][:, 1].std())
    return interval(value, value - half, value + half)


def _accelerations(
    fit: CameraFit, units: Units, frame_s: float, scale: float, rng: np.random.Generator
) -> dict[str, dict[str, float | None]]:
    """Downward acceleration while going up and while coming down."""
    shape, draws = fit.shapes["friction"], fit.values["friction"]
    factor = scale / frame_s**2
    if units.scale_m is None:  # in units of the gravity assumed
        factor = units.g_mps2 / float(shape.values[0])
        common = np.ones(len(draws)) * draws[:, 0].mean() / draws[:, 0]
    else:
        relative = np.hypot(units.scale_uncertainty, 2.0 * units.frame_rate_uncertainty)
        common = 1.0 + relative * rng.standard_normal(len(draws))
    out = {}
    for name, sign in (("up", 1.0), ("down", -1.0)):
        value = float(shape.values[0] * (1.0 + sign * shape.values[1])) * factor
        out[name] = of_draws(value, draws[:, 0] * (1.0 + sign * draws[:, 1]) * factor * common)
    return out


def _quality(fit: CameraFit) -> dict[str, Any]:
    """How well each shape fits: rms against the noise of single positions."""
    span = max(float(np.ptp(flight.height)) for flight in fit.flights)
    rms = {name: shape.sigma for name, shape in fit.shapes.items()}
    limit = max(3.0 * fit.noise, 1.5e-3 * span)
    return {
        "noise": fit.noise,
        "rms": rms,
        "reduced_chi_square": {name: (value / fit.noise) ** 2 for name, value in rms.items()},
        "parabola_fits": rms["parabola"] <= limit,
        "some_shape_fits": min(rms.values()) <= limit,
        "independent_samples_per_sample": fit.worth,
        "flights": len(fit.flights),
    }


def _in_words(payload: dict[str, Any], units: Units, files: int) -> list[str]:
    quality, bounces = payload["fit"], payload["restitution"]
    words = [f"{files} file(s), {len(payload['impacts_frames'])} impacts, {quality['flights']} flights"]
    words += describe_choice(payload)
    for bounce in bounces[:12]:
        e, speed = bounce["restitution"], bounce.get("speed_in_mps")
        at = f" at {speed:.3f} m/s" if speed is not None else ""
        words.append(f"restitution {e['value']:.4f} ({e['low']:.4f} to {e['high']:.4f}){at}")
    tall = payload["drop_height_m"]
    if tall["value"] is not None:
        words.append(f"fell {tall['value']:.4f} m ({tall['low']:.4f} to {tall['high']:.4f}) to the first impact")
    f = payload["friction"]
    words.append(f"friction {f['value']:.4f} g ({f['low']:.4f} to {f['high']:.4f})")
    if not quality["parabola_fits"]:
        rms, noise = quality["rms"], quality["noise"]
        best = min(rms, key=lambda name: rms[name])
        words.append(
            f"A parabola does not fit: it leaves {rms['parabola']:.2f} units rms where positions are good to "
            f"{noise:.2f}; {best} leaves {rms[best]:.2f}."
            + ("" if quality["some_shape_fits"] else " No shape fits; trust none to its digits.")
        )
    if units.frame_s is None:
        words.append("No frame rate is known: times, speeds, drag and heights cannot be given; ratios can. Say --fps.")
    elif units.scale_m is None:
        words.append(f"No scale is known: gravity is taken as {units.g_mps2:.5f} m/s^2, not measured. Say --scale.")
    elif payload["g_mps2"] is not None:
        g = payload["g_mps2"]
        words.append(f"gravity {g['value']:.3f} m/s^2 ({g['low']:.3f} to {g['high']:.3f})")
    return words


def _declared(
    candidate: CameraCandidate, fit: CameraFit, frame_s: float, scale: float, timed: bool, names: Sequence[str]
) -> list[Any]:
    bounces = len(candidate.law.predicted)
    source = f"drop test by camera, {len(names)} file(s), {bounces} bounces ({names[0]}), {candidate.model.name}"
    out = []
    for name, (value, half) in _parameters(candidate, fit).items():
        if timed or name in ("e0", "mu"):
            own = _si(name, half / LEVEL_SIGMAS, frame_s, scale)
            out += declared_as(name, float(_si(name, value, frame_s, scale)), float(own), source)
    return out
