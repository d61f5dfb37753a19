"""Camera drops: impacts, speeds and restitution from the fitted flights, and held-out scores of the models.

The shape of a flight (parabola, friction, drag) is scored on the positions of flights it was not fitted to, the law of
restitution on bounces it was not fitted to; a residual correlated from frame to frame counts for as many independent
samples as it is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film.flights import Clip, Flight, flights_of
from analysis.drop.film.restitution import RestitutionFit, fit_restitution
from analysis.drop.film.steadiness import in_words, wander_of
from analysis.drop.film.trajectory import SHAPES, Shape, draws_of, fit_shape, law_of, noise_of, surprise
from analysis.drop.laws.bouncelaw import CONSTANT, DRAG, FRICTION, SPEED, SPEED_DRAG, BounceModel
from analysis.drop.laws.flightlaw import FlightLaw
from daq.setup.errors import InputError

Array = NDArray[np.float64]

FRICTION_DRAG = BounceModel("coulomb_friction+quadratic_drag", ("e0", "mu", "k_per_m"))
SPEED_FRICTION = BounceModel("speed_dependent_restitution+coulomb_friction", ("e0", "e1_s_per_m", "mu"))
CAMERA_MODELS: tuple[tuple[BounceModel, str, bool], ...] = (
    (CONSTANT, "parabola", False),
    (SPEED, "parabola", True),
    (DRAG, "drag", False),
    (FRICTION, "friction", False),
    (SPEED_DRAG, "drag", True),
    (SPEED_FRICTION, "friction", True),
    (FRICTION_DRAG, "friction+drag", False),
)
_DRAWS = 300
_IMPACT_FRAMES = 0.8
_LEAST_CLEAR = 4
_MOST_WORTH = 0.5  # a tracker errs alike over several frames (the same pixels, the same edge), seen or not


@dataclass(frozen=True)
class Impacts:
    """Impacts of all clips under one shape, in the file's units (frames, pixels).

    Attributes
    ----------
    clip : (n,) int64
    frame : (n,) float64
        Impact times.
    speed_in, speed_out : (n,) float64
        NaN where the flight on that side was not resolved.
    floor : (n,) float64
        Height of the ball at the impact; NaN for an impact after which nothing is known.
    frame_draws, in_draws, out_draws, floor_draws : (m, n) float64
        The same for each draw of the fit.
    """

    clip: NDArray[np.int64]
    frame: Array
    speed_in: Array
    speed_out: Array
    floor: Array
    frame_draws: Array
    in_draws: Array
    out_draws: Array
    floor_draws: Array

    @property
    def bounced(self) -> NDArray[np.bool_]:
        """Impacts with a measured speed on both sides."""
        return np.isfinite(self.speed_in) & np.isfinite(self.speed_out)

    def flight_after(self) -> Array:
        """Frames until the next impact of the same clip; NaN for the last."""
        gap = np.append(np.diff(self.frame), np.nan)
        same = np.append(np.diff(self.clip) == 0, False)
        return np.where(same, gap, np.nan)


@dataclass(frozen=True)
class CameraCandidate:
    """One model: shape and law of restitution, with held-out scores (flights first, then bounces)."""

    model: BounceModel
    shape: str
    law: RestitutionFit
    residual_frames: Array
    held_out_frames: Array
    scores: Array
    significant: bool


@dataclass(frozen=True)
class CameraFit:
    """What the camera saw.

    Attributes
    ----------
    flights : list of Flight
    shapes : dict of Shape
        Each shape fitted to all flights.
    values : dict of (m, p) float64
        Draws of each shape's parameters.
    impacts : dict of Impacts
    candidates : tuple of CameraCandidate
    fall_height : dict of (clips,) float64 with draws (m, clips)
        Height of the fall to each clip's first impact, unit.
    noise : float
        Of single positions, from third differences.
    worth : float
        Independent samples per sample.
    moved : tuple of str
        What shows that a camera moved whose motion nothing measures, in words.
    """

    flights: list[Flight]
    shapes: dict[str, Shape]
    values: dict[str, Array]
    impacts: dict[str, Impacts]
    candidates: tuple[CameraCandidate, ...]
    fall_height: dict[str, tuple[Array, Array]]
    noise: float
    worth: float
    moved: tuple[str, ...] = ()


def fit_camera(clips: Sequence[Clip], rng: np.random.Generator) -> CameraFit:
    """Fit all shapes and all laws of restitution to the drops in ``clips`` together (one camera, one scale).

    Raises
    ------
    InputError
        No impact with a flight resolved on both sides.
    """
    flights = [flight for number, clip in enumerate(clips) for flight in flights_of(clip, number)]
    flights = _centred([f for f in flights if len(f.frame) >= 3])
    acceleration = float(np.median([clip.acceleration for clip in clips]))
    noise = noise_of(flights)
    flights = _clear_of_impacts(flights, fit_shape("friction", flights, acceleration, noise))
    richest = fit_shape("friction+drag", flights, acceleration, noise)
    worth = _worth(richest, flights)
    unit = (richest.sigma / noise) ** 2 / worth
    shapes = {name: fit_shape(name, flights, acceleration, noise, unit=unit) for name in SHAPES}
    shapes = {name: replace(s, covariance=s.covariance / worth) for name, s in shapes.items()}
    values, impacts, falls = {}, {}, {}
    for name, shape in shapes.items():
        values[name], at, top = draws_of(shape, rng, _DRAWS, worth)
        impacts[name], falls[name] = impacts_of(shape, flights, values[name], at, top)
    if not impacts["parabola"].bounced.any():
        raise InputError(f"{clips[0].name}: no impact with a measured speed on both sides; show the fall and a bounce")
    scores = {name: _position_scores(shape, flights, noise, worth) for name, shape in shapes.items()}
    for name, shape in shapes.items():
        if "f" in SHAPES[name] and shape.law.friction < 0.0:  # rods do not push: nothing gained
            scores[name] = scores["drag" if "k" in SHAPES[name] else "parabola"]
    candidates = tuple(_candidate(*candidate, shapes, values, impacts, scores) for candidate in CAMERA_MODELS)
    moved = [in_words(wander_of(c, [f for f in flights if f.clip == k])) for k, c in enumerate(clips)]
    said = tuple(f"{clip.name}: {words}" for clip, words in zip(clips, moved, strict=True) if words)
    return CameraFit(flights, shapes, values, impacts, candidates, falls, noise, worth, said)


def _centred(flights: list[Flight]) -> list[Flight]:
    """Heights counted from the middle of all heights; the scale is that of a ruler from their lowest to highest."""
    tops, floors = [float(f.height.max()) for f in flights], [float(f.height.min()) for f in flights]
    middle = 0.5 * (max(tops) + min(floors))
    reach = 0.5 * (max(tops) - min(floors))
    return [replace(flight, height=flight.height - middle, reach=reach) for flight in flights]


def _clear_of_impacts(flights: list[Flight], shape: Shape) -> list[Flight]:
    """Leave out samples whose exposure an impact may touch, now that it is known when the impacts were."""
    none = np.empty((0, len(flights)))
    seen, _ = impacts_of(shape, flights, np.empty((0, len(shape.values))), none, none)
    out = []
    for flight in flights:
        when = seen.frame[seen.clip == flight.clip]
        clear = np.abs(flight.frame[:, None] - when[None]).min(axis=1, initial=np.inf) > _IMPACT_FRAMES
        if clear.sum() >= _LEAST_CLEAR:
            flight = replace(flight, frame=flight.frame[clear], height=flight.height[clear])
        out.append(flight)
    return out


def _worth(shape: Shape, flights: Sequence[Flight]) -> float:
    """Independent samples per sample, from the lag-one correlation of the residuals within flights."""
    product = square = 0.0
    for i, flight in enumerate(flights):
        fallen = shape.law.drop_m(flight.frame - shape.apex_frame[i])
        residual = flight.height - shape.seen(shape.apex_height[i] - fallen)
        product += float((residual[1:] * residual[:-1]).sum())
        square += float((residual**2).sum())
    rho = min(max(product / max(square, 1e-300), 0.0), 0.95)
    return min((1.0 - rho) / (1.0 + rho), _MOST_WORTH)


def _position_scores(shape: Shape, flights: list[Flight], noise: float, worth: float) -> Array:
    """Held-out log likelihood of each flight's positions, the shape taken from the other flights."""
    sigma = max(shape.sigma, noise)
    unit = (sigma / noise) ** 2 / worth
    scores = np.empty(len(flights))
    for i, flight in enumerate(flights):
        others = flights[:i] + flights[i + 1 :]
        known = shape
        if len(others) >= 2:
            known = fit_shape(shape.name, others, shape.law.g_mps2, noise, shape.values, unit)
        scores[i] = -surprise(known, flight, noise, sigma, worth)
    return scores


def impacts_of(
    shape: Shape, flights: Sequence[Flight], values: Array, at: Array, top: Array
) -> tuple[Impacts, tuple[Array, Array]]:
    """Impacts where neighbouring flights meet, and one more where the last flight comes down to that floor."""
    laws = law_of(shape.name, np.vstack([shape.values, values]))
    frames, heights = np.vstack([shape.apex_frame, at]), np.vstack([shape.apex_height, top])
    rows: list[tuple[int, Array, Array, Array, Array]] = []
    unknown = np.full(len(frames), np.nan)
    fall = np.full((len(frames), max(f.clip for f in flights) + 1), np.nan)
    for i, flight in enumerate(flights):
        follows = i + 1 < len(flights) and flights[i + 1].clip == flight.clip
        if follows and flights[i + 1].order == flight.order + 1:
            when = _meet(laws, frames, heights, i, flight, flights[i + 1])
            down = _speed(laws, when - frames[:, i])
            if flight.order == 0:
                fall[:, flight.clip] = laws.drop_m(when - frames[:, i])
            level = heights[:, i] - laws.drop_m(when - frames[:, i])
            rows.append((flight.clip, when, down, _speed(laws, when - frames[:, i + 1]), level))
        elif flight.lands and rows and rows[-1][0] == flight.clip:
            floor = heights[:, i - 1] - laws.drop_m(rows[-1][1] - frames[:, i - 1])
            below = np.maximum(heights[:, i] - floor, 0.0)
            when = frames[:, i] + laws.fall_s(below)
            rows.append((flight.clip, when, _speed(laws, when - frames[:, i]), unknown, unknown))
    clip = np.array([row[0] for row in rows], dtype=np.int64)
    table = np.array([row[1:] for row in rows]).reshape(-1, 4, len(frames))
    first, rest = table[:, :, 0].T, table[:, :, 1:].transpose(1, 2, 0)
    found = Impacts(clip, first[0], first[1], first[2], first[3], rest[0], rest[1], rest[2], rest[3])
    return found, (fall[0], fall[1:])


def _meet(laws: FlightLaw, frames: Array, heights: Array, i: int, before: Flight, after: Flight) -> Array:
    """Where flight ``i`` coming down meets flight ``i + 1`` going up: Newton from the middle of the gap."""
    when = np.full(len(frames), 0.5 * (before.frame[-1] + after.frame[0]))
    for _ in range(20):
        gap = heights[:, i] - heights[:, i + 1]
        gap = gap - laws.drop_m(when - frames[:, i]) + laws.drop_m(when - frames[:, i + 1])
        closing = _speed(laws, when - frames[:, i]) + _speed(laws, when - frames[:, i + 1])
        when = when + np.clip(gap / np.maximum(closing, 1e-12), -3.0, 3.0)
    return when


def _speed(laws: FlightLaw, since: Array) -> Array:
    return np.asarray(np.abs(laws.velocity_mps(since)))


def _candidate(
    model: BounceModel,
    shape_name: str,
    with_speed: bool,
    shapes: dict[str, Shape],
    values: dict[str, Array],
    impacts: dict[str, Impacts],
    scores: dict[str, Array],
) -> CameraCandidate:
    """A law of restitution under a shape: how long it says the next flight lasts."""
    found, law = impacts[shape_name], shapes[shape_name].law
    index = np.flatnonzero(found.bounced)
    incoming = found.speed_in[index]
    ratio = found.speed_out[index] / incoming
    sigma = (found.out_draws[:, index] / found.in_draws[:, index]).std(axis=0)
    fit = fit_restitution(incoming, ratio, sigma, with_speed)
    flight = found.flight_after()[index]

    def miss(e: Array) -> Array:
        left = flight - law.duration_s(np.maximum(e, 0.01) * incoming)
        return np.asarray(left[np.isfinite(left)])

    both = np.concatenate([scores[shape_name], fit.scores])
    clear = not with_speed or abs(float(fit.theta[1])) > float(fit.half_width[1])
    for j, key in enumerate(SHAPES[shape_name]):
        if key in ("f", "k"):
            clear &= float(shapes[shape_name].values[j]) > 1.96 * float(values[shape_name][:, j].std())
    return CameraCandidate(model, shape_name, fit, miss(fit.predicted), miss(fit.held_out), both, clear)
