"""Results of a camera's drops, in SI units: the choice among the models, or the refusal of motion that is no drop.

Restitution and friction are ratios and need neither scale nor frame rate. Speeds, drag and gravity need both: with a
scale, gravity is measured and must come out as gravity; without one, gravity gives the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from analysis.drop import outcome, thresholds
from analysis.drop.film.camera_fit import CameraCandidate, CameraFit
from analysis.drop.film.trajectory import SHAPES
from analysis.drop.laws import Verdict, choose, gain_of
from daq.setup.errors import InputError
from kernels.arrays import Floats, Integers

_SIGNS = (("up", 1.0), ("down", -1.0))  # of friction, against gravity


@dataclass(frozen=True)
class Units:
    """Units of a film or a path, to turn frames and pixels into seconds and metres."""

    frame_s: float | None  # seconds a frame; None where it is not known
    scale_m: float | None  # metres a unit of height; None: taken from gravity
    g_mps2: float
    scale_uncertainty: float = 0.0  # relative, one standard deviation
    frame_rate_uncertainty: float = 0.0  # the same
    assumed_rate: bool = False  # the frame rate is the film's playback rate, which a person has not confirmed
    ball: float | None = None  # height of the ball, in the file's unit


def of_camera(
    names: Sequence[str],
    fit: CameraFit,
    units: Units,
    rng: np.random.Generator,
    stated: tuple[float, float] | None = None,
) -> outcome.Outcome:
    """Result of films or tracked positions.

    Raises `InputError` where the motion is no fall with bounces; where with scale and frame rate its acceleration is
    nowhere near gravity; where the fall is taller than any, as of a film in slow motion read at its playback rate.

    ``stated``: a height that a person gave and its standard uncertainty, m, to be checked.
    """
    refuse_other_motion(fit, names[0])
    verdict = judge_camera(fit)
    film = _Film(fit, verdict.candidate(verdict.best), units)
    gravity, quality = film.gravity(names[0]), film.quality()
    slow = film.playback(names[0])
    verdict = replace(verdict, doubts=(*verdict.doubts, *film.doubts(quality, gravity)))
    frame, seconds = film.seen.frame, film.frame_s if film.timed else 1.0
    impacts_s = (frame * film.frame_s).tolist() if film.timed else []
    flights = zip(fit.flights, film.shape.apex_frame, strict=True)
    payload = outcome.payload_of("camera", names, impacts_s, verdict, film.height()) | {
        "impacts_frames": frame.tolist(),
        "models": [film.model(one) for one in fit.candidates],
        "restitution": film.bounces(),
        "friction": film.friction(),
        "friction_up_down": film.friction_each_way(),
        "acceleration_mps2": film.accelerations(rng) if film.timed else None,
        "g_mps2": gravity,
        "scale_m_per_unit": {"value": film.scale if film.timed else None, "from_gravity": units.scale_m is None},
        "fit": quality,
        "flights": [
            {
                "file": flight.clip, "order": flight.order, "samples": len(flight.frame),
                "first_frame": float(flight.frame[0]), "last_frame": float(flight.frame[-1]),
                "apex_s" if film.timed else "apex_frame": float(apex) * seconds,
            }
            for flight, apex in flights
        ],
    }  # fmt: skip
    words = _in_words(payload, units, len(names)) + slow
    check = outcome.against_stated(payload["drop_height_m"], stated) if stated is not None else {}
    if stated is not None and "sigmas_off" in check:
        payload["stated_height_m"] = check
        words.append(f"stated height {stated[0]:.3f} m: the filmed fall is {check['sigmas_off']:+.1f} sigma from it")
    bounces = len(film.best.fit.predicted)
    source = f"drop test by camera, {len(names)} file(s), {bounces} bounces ({names[0]}), {verdict.best}"
    return outcome.Outcome(payload, words, [] if verdict.doubts else outcome.declared(film.best, film.to_si, source))


class _Film:
    """The fit of a camera's drops under its best model, with its units."""

    def __init__(self, fit: CameraFit, best: CameraCandidate, units: Units) -> None:
        self.fit, self.best, self.units = fit, best, units
        shape = best.model.shape
        self.shape, self.draws, self.seen = fit.shapes[shape], fit.values[shape], fit.impacts[shape]
        self.g = float(self.shape.values[0])  # unit / frame^2
        self.timed = units.frame_s is not None  # without a frame rate, nothing in seconds or metres is given
        # Seconds a frame and metres a unit; what is not known is what makes gravity gravity.
        self.frame_s = units.frame_s if units.frame_s is not None else float(np.sqrt(self.g / units.g_mps2))
        self.scale = units.scale_m if units.scale_m is not None else units.g_mps2 * self.frame_s**2 / self.g
        self.to_si = {"e0": 1.0, "mu": 1.0}  # factors of the parameters that can be given
        if self.timed:
            self.to_si |= {"e1_s_per_m": self.frame_s / self.scale, "k_per_m": 1.0 / self.scale}
        # Relative, of anything in m/s^2: time counts twice.
        self.unit_uncertainty = float(np.hypot(units.scale_uncertainty, 2.0 * units.frame_rate_uncertainty))
        self.fall = float(np.nanmax(fit.fall_height[shape][0], initial=0.0))  # unit

    def gravity(self, where: str) -> outcome.Interval | None:
        """Measured gravity where scale and frame rate are known; refused where it is not gravity."""
        units = self.units
        if units.frame_s is None or units.scale_m is None:
            return None
        value = self.g * (units.scale_m / units.frame_s**2)
        ratio = value / units.g_mps2
        if not thresholds.FAR_FROM_GRAVITY[0] < ratio < thresholds.FAR_FROM_GRAVITY[1]:
            fps = 1.0 / units.frame_s / np.sqrt(ratio)
            raise InputError(
                f"{where}: the ball falls at {value:.3g} m/s^2, {ratio:.3g} times gravity: the frame rate "
                f"{1 / units.frame_s:.4g} or the scale {units.scale_m:.4g} m is wrong; {fps:.4g} frames per second, or "
                f"a scale of {units.scale_m / ratio:.4g} m, would make it gravity"
            )
        # lenses are not even along the fall: no scale is known better than to 1e-3
        common = np.hypot(self.unit_uncertainty, 1e-3)
        sigma = value * float(np.hypot(self.draws[:, 0].std() / self.g, common))
        return outcome.around(value, thresholds.LEVEL_SIGMAS * sigma)

    def playback(self, where: str) -> list[str]:
        """A reminder that a film may play slower than it was taken; refused where its fall or ball is too large."""
        if not self.units.assumed_rate or not self.timed:
            return []
        fall, ball, fps = self.fall * self.scale, (self.units.ball or 0.0) * self.scale, 1.0 / self.frame_s
        if fall > thresholds.TALLEST_FALL_M or ball > thresholds.LARGEST_BALL_M:
            size = f" and a ball of {ball:.2g} m" if ball else ""
            raise InputError(
                f"{where}: at its playback rate of {fps:.4g} frames per second it would show a fall of {fall:.1f} m"
                f"{size}: it was filmed faster. Say --fps with the rate of the camera (or the file's own, if it is so)"
            )
        size = f", a ball {1e3 * ball:.0f} mm high," if ball else ""
        return [
            f"The {fps:.4g} frames a second are those at which the film plays. If that fall{size} or the speeds look "
            "too large, it was filmed faster: say --fps; restitution and friction stay as they are."
        ]

    def doubts(self, quality: dict[str, Any], g: outcome.Interval | None) -> list[str]:
        """Contradictions to the model, in words."""
        words = list(self.fit.moved)
        if self.fall > 0.0:
            uneven = uneven_floor(self.seen.clip, self.seen.floor, self.seen.floor_draws, self.fall)
            words += [uneven] if uneven else []
        if not quality["some_shape_fits"]:
            best = min(quality["rms"].values())
            words.append(
                f"no shape of flight fits: the best leaves {best:.2f} units rms where positions are good to "
                f"{quality['noise']:.2f} (a lens, a camera that moves, frames at uneven times)"
            )
        sigma = None if g is None else outcome.sigma_of(g)
        if g is None or sigma is None or g["value"] is None:
            return words
        wanted, sigma = self.units.g_mps2, max(sigma, 1e-9)
        off = g["value"] - wanted
        if abs(off) > max(thresholds.CONTRADICTION_SIGMAS * sigma, thresholds.SAME_GRAVITY * wanted):
            both, more = self.friction_each_way(), ""
            if "mu" in self.best.model.parameters and both is not None:
                up, down = (outcome.with_interval(both[way]) for way, _ in _SIGNS)
                more = f"; if both are right, friction differs: {up} g going up, {down} g coming down"
            words.append(
                f"gravity comes out as {g['value']:.3f} m/s^2, {off / sigma:+.1f} sigma from {wanted:.3f}: the scale "
                f"or the frame rate is wrong{more}"
            )
        return words

    def friction(self) -> outcome.Interval:
        """Coulomb friction over the weight, whatever model was chosen."""
        spread = float(self.fit.values["friction"][:, 1].std())
        return outcome.around(float(self.fit.shapes["friction"].values[1]), thresholds.LEVEL_SIGMAS * spread)

    def friction_each_way(self) -> dict[str, outcome.Interval] | None:
        """Friction going up and coming down, each by itself, by the gravity that is known; None without a scale."""
        if not self.timed or self.units.scale_m is None:
            return None
        factor = self.scale / self.frame_s**2 / self.units.g_mps2
        (g, f), draws = self.fit.shapes["friction"].values[:2], self.fit.values["friction"]
        out = {}
        for way, sign in _SIGNS:
            value = sign * (float(g) * factor * (1.0 + sign * float(f)) - 1.0)
            spread = (draws[:, 0] * factor * (1.0 + sign * draws[:, 1])).std()
            out[way] = outcome.around(value, thresholds.LEVEL_SIGMAS * float(np.hypot(spread, self.unit_uncertainty)))
        return out

    def accelerations(self, rng: np.random.Generator) -> dict[str, outcome.Interval]:
        """Downward acceleration while going up and while coming down."""
        (g, f), draws = self.fit.shapes["friction"].values[:2], self.fit.values["friction"]
        if self.units.scale_m is None:  # in units of the gravity assumed
            factor = self.units.g_mps2 / float(g)
            common = draws[:, 0].mean() / draws[:, 0]
        else:
            factor = self.scale / self.frame_s**2
            common = 1.0 + self.unit_uncertainty * rng.standard_normal(len(draws))
        return {
            way: outcome.of_draws(
                float(g * (1.0 + sign * f)) * factor, draws[:, 0] * (1.0 + sign * draws[:, 1]) * factor * common
            )
            for way, sign in _SIGNS
        }

    def model(self, one: CameraCandidate) -> dict[str, Any]:
        """A model for the JSON."""
        law, covariance = one.fit, self.fit.shapes[one.model.shape].covariance.tolist()
        entry: dict[str, Any] = outcome.model_json(one, self.to_si, 1e3 * self.frame_s if self.timed else np.nan) | {
            "restitution_scatter": law.scatter,
            "chi_square": {"value": law.chi_square, "freedom": law.freedom, "chance": law.chance},
            "covariance": {
                "of": list(SHAPES[one.model.shape]),
                "matrix": covariance,
                "unit": "the file's unit and frames",
            },
        }
        return entry

    def height(self) -> outcome.Interval:
        """Height from which the ball fell freely to its first impact."""
        units = self.units
        if not self.timed and units.scale_m is None:
            return outcome.UNKNOWN
        g_draws = self.draws[:, 0] / self.g
        shared = units.scale_uncertainty if units.scale_m is not None else 2.0 * units.frame_rate_uncertainty
        out = []
        falls, draws = self.fit.fall_height[self.best.model.shape]
        for value, own in zip(falls, draws.T, strict=True):
            sigma = float(np.std(own / (g_draws if units.scale_m is None else 1.0))) / max(float(value), 1e-12)
            reach, tall = thresholds.LEVEL_SIGMAS * float(np.hypot(sigma, shared)), value * self.scale
            out.append(outcome.interval(tall, tall * (1 - reach), tall * (1 + reach)))
        return outcome.pooled_height(out)

    def bounces(self) -> list[dict[str, Any]]:
        """Restitution of each impact, with its speeds where they are known."""
        seen, speed = self.seen, self.scale / self.frame_s
        out = []
        for i in np.flatnonzero(seen.bounced):
            entry: dict[str, Any] = {"file": int(seen.clip[i]), "impact_frame": float(seen.frame[i])}
            if self.timed:
                entry["impact_s"] = float(seen.frame[i]) * self.frame_s
                entry["speed_in_mps"] = float(seen.speed_in[i]) * speed
                entry["speed_out_mps"] = float(seen.speed_out[i]) * speed
            ratio = float(seen.speed_out[i] / seen.speed_in[i])
            entry["restitution"] = outcome.of_draws(ratio, seen.out_draws[:, i] / seen.in_draws[:, i])
            out.append(entry)
        return out

    def quality(self) -> dict[str, Any]:
        """Quality of each shape's fit: rms against the noise of single positions."""
        noise, rms = self.fit.noise, {name: shape.sigma for name, shape in self.fit.shapes.items()}
        span = max(float(np.ptp(flight.height)) for flight in self.fit.flights)
        limit = max(3.0 * noise, 1.5e-3 * span)
        return {
            "noise": noise,
            "rms": rms,
            "reduced_chi_square": {name: (value / noise) ** 2 for name, value in rms.items()},
            "parabola_fits": rms["parabola"] <= limit,
            "some_shape_fits": min(rms.values()) <= limit,
            "independent_samples_per_sample": self.fit.worth,
            "flights": len(self.fit.flights),
        }


def _in_words(payload: dict[str, Any], units: Units, files: int) -> list[str]:
    quality = payload["fit"]
    words = [f"{files} file(s), {len(payload['impacts_frames'])} impacts, {quality['flights']} flights"]
    words += outcome.describe_choice(payload)
    for bounce in payload["restitution"][: outcome.MOST_SAID]:
        at = f" at {bounce['speed_in_mps']:.3f} m/s" if "speed_in_mps" in bounce else ""
        words.append(f"restitution {outcome.in_digits(bounce['restitution'], 4)}{at}")
    if payload["drop_height_m"]["value"] is not None:
        words.append(f"fell {outcome.in_digits(payload['drop_height_m'], 4, ' m')} to the first impact")
    words.append(f"friction {outcome.in_digits(payload['friction'], 4, ' g')}")
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
        words.append(f"gravity {outcome.in_digits(payload['g_mps2'], 3, ' m/s^2')}")
    return words


def judge_camera(fit: CameraFit) -> Verdict[CameraCandidate]:
    """Choose among the models of ``fit``; a law of restitution that the bounces contradict is not chosen."""
    verdict = Verdict(fit.candidates, choose(fit.candidates))
    best = verdict.candidate(verdict.best)
    if not _is_contradicted(best):
        return verdict
    # laws that have been tested, and leave errors or an ordinary scatter
    held = [one for one in fit.candidates if one.significant and one.fit.freedom > 0]
    able = [one for one in held if one.fit.chance > thresholds.FOLLOWED_CHANCE or one.fit.is_steady]
    holding = next((one for one in able if one.model.shape == best.model.shape), None)
    if holding is not None:
        rivals = [one.model.name for one in able if one is not holding and not gain_of(holding, one)[1]]
        return Verdict(fit.candidates, (holding.model.name, *rivals))
    names = [one.model.name for one in fit.candidates if one is not best and not _is_contradicted(one)]
    ratio, sigma = fit.impacts[best.model.shape].restitution()
    shown = ", ".join(f"{e:.3f} +- {s:.3f}" for e, s in list(zip(ratio, sigma, strict=True))[:8])
    low, high = int(np.argmin(ratio)), int(np.argmax(ratio))
    distance = (ratio[high] - ratio[low]) / max(float(np.hypot(sigma[high], sigma[low])), 1e-9)
    few = "" if len(ratio) > 3 else f"; {len(ratio)} bounces cannot tell a dependence on speed from irregular bounces"
    doubt = (
        f"the restitution is not constant: {shown} (one standard deviation), up to {distance:.0f} sigma apart, and no "
        f"law here with fewer parameters than bounces follows it{few}"
    )
    return Verdict(fit.candidates, (best.model.name, *names), (doubt,))


def _is_contradicted(candidate: CameraCandidate) -> bool:
    """Whether the bounces differ by far more than their errors, and by more than a ball on a flat plate does."""
    law = candidate.fit
    return law.chance < thresholds.UNEVEN_CHANCE and not law.is_steady


def refuse_other_motion(fit: CameraFit, where: str) -> None:
    """Raise `InputError` where the motion is no fall with bounces: a hand, a pendulum, a ball that is thrown.

    Raises `InputError` for no rebound, one that gains energy, or flights that no law of free flight comes near.
    """
    ratios, sigmas = fit.impacts["parabola"].restitution()
    tall = float(np.median([np.ptp(flight.height) for flight in fit.flights]))
    misfit = min(shape.sigma for shape in fit.shapes.values()) / max(tall, 1e-12)
    if misfit > thresholds.LARGEST_MISFIT:
        raise InputError(
            f"{where}: what moves is no fall with bounces: the best curve of free flight misses it by "
            f"{100 * misfit:.0f} % of the height of its arcs; film one drop, nothing else moving, or choose its part "
            "with --region, --from and --until"
        )
    ratio, sigma = float(np.median(ratios)), float(np.median(sigmas))
    if ratio < max(thresholds.LEAST_REBOUND, 3.0 * sigma):
        raise InputError(f"{where}: no rebound: speed after over before the impact is {ratio:.3f} +- {sigma:.3f}")
    if ratio > thresholds.MOST_REBOUND:
        raise InputError(
            f"{where}: the speed after an impact is {ratio:.3f} times that before: no ball bounces on a plate at rest "
            "like this; is the film upside down, does the plate move, or is it a hand?"
        )


def uneven_floor(clip: Integers, floor: Floats, draws: Floats, fall: float) -> str | None:
    """A floor or camera that moved: impacts of one clip at heights that differ by far more than their errors.

    ``clip`` and ``floor`` (n,) are those of the impacts, with draws (m, n); ``fall`` is the height of the fall.
    """
    for number in np.unique(clip):
        own = (clip == number) & np.isfinite(floor)
        if own.sum() < 2:
            continue
        heights, sigma = floor[own], np.maximum(draws[:, own].std(axis=0), 1e-12)
        mean = float(np.average(heights, weights=sigma**-2.0))
        chance = float(stats.chi2.sf((((heights - mean) / sigma) ** 2).sum(), len(heights) - 1))
        step = float(np.ptp(heights))
        if chance < thresholds.UNEVEN_CHANCE and step > thresholds.LARGEST_STEP * fall:
            return (
                f"the impacts are at heights that differ by {100.0 * step / fall:.1f} % of the fall, far more than "
                "their errors: the camera or the floor moved"
            )
    return None
