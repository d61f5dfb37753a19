"""Camera drops: impacts, speeds and restitution from the fitted flights, and held-out scores of the models.

The shape of a flight (parabola, friction, drag) is scored on the positions of flights it was not fitted to, the law of
restitution on bounces it was not fitted to; a residual correlated from frame to frame counts for as many independent
samples as it is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, stats

from analysis.drop.film.track import LEAST_SAMPLES, Clip, Flight, flights_of, jitter
from analysis.drop.film.trajectory import SHAPES, Shape, draws_of, fit_shape, law_of, noise_of, surprise
from analysis.drop.laws import OF_PATHS, BounceModel, Candidate, Estimates, FlightLaw, beyond_zero, worth_of
from analysis.drop.thresholds import LARGEST_SCATTER, LEVEL_SIGMAS
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers


@dataclass(frozen=True)
class Impacts:
    """Impacts of all clips under one shape, in the file's units (frames, pixels)."""

    clip: Integers  # (n,)
    frame: Floats  # (n,) impact times
    speed_in: Floats  # NaN where the flight on that side was not resolved, (n,)
    speed_out: Floats  # the same, (n,)
    floor: Floats  # (n,) height of the ball at the impact; NaN for an impact after which nothing is known
    in_draws: Floats  # ``speed_in`` for each draw of the fit, (m, n)
    out_draws: Floats  # of ``speed_out``, (m, n)
    floor_draws: Floats  # of ``floor``, (m, n)

    @property
    def bounced(self) -> Bools:
        """Impacts with a measured speed on both sides."""
        return np.isfinite(self.speed_in) & np.isfinite(self.speed_out)

    def restitution(self) -> tuple[Floats, Floats]:
        """Restitution of each impact that has speeds on both sides, and its standard deviation."""
        index = np.flatnonzero(self.bounced)
        sigma = (self.out_draws[:, index] / self.in_draws[:, index]).std(axis=0)
        return self.speed_out[index] / self.speed_in[index], sigma


@dataclass(frozen=True)
class RestitutionFit:
    """``e = e0 - e1 u``, or constant."""

    theta: Floats  # ``e0`` (and ``e1`` per unit speed), (p,)
    half_width: Floats  # half of the 95 % interval, (p,)
    scatter: float  # standard deviation of the restitution from bounce to bounce, beyond the measuring error
    predicted: Floats  # restitution of each bounce from all, (n,)
    held_out: Floats  # from the other bounces, (n,); NaN where there are too few
    scores: Floats  # (n,) held-out log likelihood of each bounce; 0 where there are too few to hold any out
    chi_square: float = 0.0  # of the bounces against nothing but their measuring errors
    freedom: int = 0  # bounces less parameters

    @property
    def is_steady(self) -> bool:
        """Whether the restitution scatters from bounce to bounce by no more than that of a ball on a flat plate."""
        return self.scatter / max(abs(float(self.theta[0])), 0.02) <= LARGEST_SCATTER

    @property
    def chance(self) -> float:
        """Probability of a chi-square as large, were the measuring errors all there is (1 without freedom)."""
        return float(stats.chi2.sf(self.chi_square, self.freedom)) if self.freedom > 0 else 1.0


# A shape of flight and a law of restitution, in the file's units; not identifiable where bounces are too few for it.
CameraCandidate = Candidate[RestitutionFit]


@dataclass(frozen=True)
class CameraFit:
    """Everything fitted to a camera's drops."""

    flights: list[Flight]
    shapes: dict[str, Shape]  # each shape fitted to all flights
    values: dict[str, Floats]  # (m, p) draws of each shape's parameters
    impacts: dict[str, Impacts]
    candidates: tuple[CameraCandidate, ...]
    fall_height: dict[str, tuple[Floats, Floats]]  # (clips,) and draws (m, clips), to the first impact, unit
    noise: float  # of single positions, from third differences
    worth: float  # independent samples per sample
    moved: tuple[str, ...] = ()  # signs that a camera moved whose motion nothing measures, in words


def fit_camera(clips: Sequence[Clip], rng: np.random.Generator) -> CameraFit:
    """Fit all shapes and all laws of restitution to the drops in ``clips`` together (one camera, one scale).

    Raises `InputError` where there is no impact with a flight resolved on both sides.
    """
    flights = [f for number, clip in enumerate(clips) for f in flights_of(clip, number) if len(f.frame) >= 3]
    # Heights count from the middle of all; the scale is that of a ruler from their lowest to their highest.
    top, bottom = max(float(f.height.max()) for f in flights), min(float(f.height.min()) for f in flights)
    middle, reach = 0.5 * (top + bottom), 0.5 * (top - bottom)
    flights = [replace(f, height=f.height - middle, reach=reach) for f in flights]
    acceleration = float(np.median([clip.acceleration for clip in clips]))
    noise = noise_of(flights)
    flights = _clear_of_impacts(flights, fit_shape("friction", flights, acceleration, noise))
    richest = fit_shape("friction+drag", flights, acceleration, noise)
    worth = worth_of([f.height - richest.seen_at(i, f.frame) for i, f in enumerate(flights)])
    unit = (richest.sigma / noise) ** 2 / worth
    shapes = {name: fit_shape(name, flights, acceleration, noise, unit=unit) for name in SHAPES}
    shapes = {name: replace(s, covariance=s.covariance / worth) for name, s in shapes.items()}
    values, impacts, falls = {}, {}, {}
    for name, shape in shapes.items():
        values[name], at, top_draws = draws_of(shape, rng, 300, worth)
        impacts[name], falls[name] = impacts_of(shape, flights, values[name], at, top_draws)
    if not impacts["parabola"].bounced.any():
        raise InputError(f"{clips[0].name}: no impact with a measured speed on both sides; show the fall and a bounce")
    scores = {name: _position_scores(shape, flights, noise, worth) for name, shape in shapes.items()}
    for name, shape in shapes.items():
        if "f" in SHAPES[name] and shape.law.friction < 0.0:  # rods do not push: nothing gained
            scores[name] = scores["drag" if "k" in SHAPES[name] else "parabola"]
    by_shape = {name: (shapes[name], values[name], impacts[name], scores[name]) for name in SHAPES}
    candidates = tuple(_candidate(model, *by_shape[model.shape]) for model in OF_PATHS)
    moved = [camera_moved(c, [f for f in flights if f.clip == k]) for k, c in enumerate(clips)]
    said = tuple(f"{clip.name}: {words}" for clip, words in zip(clips, moved, strict=True) if words)
    return CameraFit(flights, shapes, values, impacts, candidates, falls, noise, worth, said)


def camera_moved(clip: Clip, flights: Sequence[Flight]) -> str | None:
    """A camera that moved, where the ball wanders sideways far beyond its jitter: no fall accelerates sideways.

    None also where other things in the film show that the camera stood still, or nothing is known of the ball's place
    across.
    """
    if clip.watched or clip.across is None:
        return None
    squares, noise = [np.empty(0)], []
    for flight in flights:
        inside = (clip.frame >= flight.frame[0]) & (clip.frame <= flight.frame[-1])
        frame, across = clip.frame[inside], clip.across[inside]
        if len(frame) >= LEAST_SAMPLES + 2:
            left = across - np.polynomial.Polynomial.fit(frame, across, 1)(frame)
            squares.append(left**2 * len(frame) / (len(frame) - 2))
            noise.append(jitter(across))
    if not noise:
        return None
    wander, usual = float(np.sqrt(np.concatenate(squares).mean())), float(np.median(noise))
    # less than three times the usual jitter, or than 0.15 px, is no wander
    if wander < max(0.15, 3.0 * usual):
        return None
    return (
        f"the ball wanders sideways by {wander:.2f} px within its flights, where places are good to {usual:.2f}: the "
        "camera moved, and nothing in the picture shows by how much; fix the camera, or let a floor or something with "
        "texture be seen"
    )


def _clear_of_impacts(flights: list[Flight], shape: Shape) -> list[Flight]:
    """Leave out samples whose exposure an impact may touch, now that it is known when the impacts were."""
    none = np.empty((0, len(flights)))
    seen, _ = impacts_of(shape, flights, np.empty((0, len(shape.values))), none, none)
    out = []
    for flight in flights:
        when = seen.frame[seen.clip == flight.clip]
        # within 0.8 frames of an impact an exposure may show both flights
        clear = np.abs(flight.frame[:, None] - when[None]).min(axis=1, initial=np.inf) > 0.8
        if clear.sum() >= 4:  # samples of a flight outside
            flight = replace(flight, frame=flight.frame[clear], height=flight.height[clear])
        out.append(flight)
    return out


def _position_scores(shape: Shape, flights: list[Flight], noise: float, worth: float) -> Floats:
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
    shape: Shape, flights: Sequence[Flight], values: Floats, at: Floats, top: Floats
) -> tuple[Impacts, tuple[Floats, Floats]]:
    """Impacts where neighbouring flights meet, and one more where the last flight comes down to that floor; and the
    heights of the falls.

    ``values`` (m, p), ``at`` and ``top`` (m, flights): draws of the shape, of the apexes' times and of their heights.
    """
    laws = law_of(shape.name, np.vstack([shape.values, values]))
    frames, heights = np.vstack([shape.apex_frame, at]), np.vstack([[one.top for one in shape.seen], top])
    rows: list[tuple[int, Floats, Floats, Floats, Floats]] = []
    unknown = np.full(len(frames), np.nan)
    fall = np.full((len(frames), max(f.clip for f in flights) + 1), np.nan)
    for i, flight in enumerate(flights):
        follows = i + 1 < len(flights) and flights[i + 1].clip == flight.clip
        if follows and flights[i + 1].order == flight.order + 1:
            # where the flight coming down meets the one going up: Newton from the middle of the gap
            when = np.full(len(frames), 0.5 * (flight.frame[-1] + flights[i + 1].frame[0]))
            for _ in range(20):
                gap = heights[:, i] - heights[:, i + 1]
                gap = gap - laws.drop_m(when - frames[:, i]) + laws.drop_m(when - frames[:, i + 1])
                closing = _speed(laws, when - frames[:, i]) + _speed(laws, when - frames[:, i + 1])
                when = when + np.clip(gap / np.maximum(closing, 1e-12), -3.0, 3.0)
            down = _speed(laws, when - frames[:, i])
            fallen = laws.drop_m(when - frames[:, i])
            if flight.order == 0:
                fall[:, flight.clip] = fallen
            rows.append((flight.clip, when, down, _speed(laws, when - frames[:, i + 1]), heights[:, i] - fallen))
        elif flight.lands and rows and rows[-1][0] == flight.clip:
            floor = heights[:, i - 1] - laws.drop_m(rows[-1][1] - frames[:, i - 1])
            when = frames[:, i] + laws.fall_s(np.maximum(heights[:, i] - floor, 0.0))
            rows.append((flight.clip, when, _speed(laws, when - frames[:, i]), unknown, unknown))
    clip = np.array([row[0] for row in rows], dtype=np.int64)
    table = np.array([row[1:] for row in rows]).reshape(-1, 4, len(frames))
    return Impacts(clip, *table[:, :, 0].T, *table[:, 1:, 1:].transpose(1, 2, 0)), (fall[0], fall[1:])


def _speed(laws: FlightLaw, since: Floats) -> Floats:
    return np.asarray(np.abs(laws.velocity_mps(since)))


def _candidate(model: BounceModel, shape: Shape, values: Floats, found: Impacts, scores: Floats) -> CameraCandidate:
    """A law of restitution under a shape: how long it says the next flight lasts."""
    index = np.flatnonzero(found.bounced)
    incoming = found.speed_in[index]
    law = fit_restitution(incoming, *found.restitution(), with_speed="e1_s_per_m" in model.parameters)
    last = np.append(np.diff(found.clip) != 0, True)  # of its clip: no flight after it
    flight = np.where(last, np.nan, np.append(np.diff(found.frame), np.nan))[index]

    def rms(e: Floats) -> float:
        left = flight - shape.law.duration_s(np.maximum(e, 0.01) * incoming)
        left = left[np.isfinite(left)]
        return float(np.sqrt((left**2).mean())) if len(left) else float("nan")

    pairs = zip(law.theta.tolist(), law.half_width.tolist(), strict=True)
    said: Estimates = dict(zip(("e0", "e1_s_per_m"), pairs, strict=False))
    for name, key in (("mu", "f"), ("k_per_m", "k")):
        if key in SHAPES[shape.name]:
            column = SHAPES[shape.name].index(key)
            said[name] = (float(shape.values[column]), LEVEL_SIGMAS * float(values[:, column].std()))
    both, known = np.concatenate([scores, law.scores]), bool(np.isfinite(law.half_width).all())
    limits = {"e0": (0.0, np.inf), "k_per_m": (0.0, np.inf)}
    errors = rms(law.predicted), rms(law.held_out)
    return Candidate(model, both, *errors, known, law, said, beyond_zero(said), limits)


def fit_restitution(speed: Floats, ratio: Floats, sigma: Floats, with_speed: bool) -> RestitutionFit:
    """Fit ``ratio`` (n,) at impact speeds ``speed`` (n,), each with measuring error ``sigma`` (n,).

    Each bounce has a restitution a little its own, too, estimated from the scatter by moments (DerSimonian and Laird
    1986).
    """
    n = len(ratio)
    if with_speed and n < 3:
        constant = fit_restitution(speed, ratio, sigma, with_speed=False)
        theta, width = np.append(constant.theta, 0.0), np.append(constant.half_width, np.inf)
        return RestitutionFit(theta, width, constant.scatter, constant.predicted, constant.held_out, constant.scores)
    basis = np.column_stack([np.ones(n), -speed]) if with_speed else np.ones((n, 1))
    freedom = n - basis.shape[1]
    theta, covariance, scatter = _weighted(basis, ratio, sigma)
    held_out, scores = np.full(n, np.nan), np.zeros(n)
    if n >= 3 + basis.shape[1] - 1:
        for i in range(n):
            others = np.arange(n) != i
            part, spread, own = _weighted(basis[others], ratio[others], sigma[others])
            held_out[i] = basis[i] @ part
            total = sigma[i] ** 2 + max(own, scatter) ** 2 + basis[i] @ spread @ basis[i]
            scores[i] = stats.t.logpdf(ratio[i], max(freedom - 1, 1), held_out[i], np.sqrt(total))
    weight = 1.0 / np.maximum(sigma, 1e-9)  # without extra scatter
    rows = basis * weight[:, None]
    left = weight * ratio - rows @ np.linalg.lstsq(rows, weight * ratio)[0]
    wide = float(stats.t.ppf(0.975, freedom)) if freedom >= 1 and scatter > 0.0 else LEVEL_SIGMAS
    half = wide * np.sqrt(np.diag(covariance))
    return RestitutionFit(theta, half, scatter, basis @ theta, held_out, scores, float(left @ left), freedom)


def _weighted(basis: Floats, ratio: Floats, sigma: Floats) -> tuple[Floats, Floats, float]:
    """Weighted least squares with a common extra scatter that brings chi-square to its degrees of freedom."""
    freedom = basis.shape[0] - basis.shape[1]
    floor = max(1e-6, 1e-3 * float(np.median(sigma)))

    def fitted(scatter: float) -> tuple[Floats, Floats, float]:
        weight = 1.0 / (sigma**2 + scatter**2 + floor**2)
        covariance = np.asarray(np.linalg.pinv((basis * weight[:, None]).T @ basis, hermitian=True), dtype=np.float64)
        theta = covariance @ (basis.T @ (weight * ratio))
        return theta, covariance, float((weight * (ratio - basis @ theta) ** 2).sum()) - freedom

    scatter = 0.0
    if freedom > 0 and fitted(0.0)[2] > 0.0:
        scatter = float(optimize.brentq(lambda s: fitted(s)[2], 0.0, 10.0 * float(np.ptp(ratio)) + floor, xtol=1e-9))
    theta, covariance, _ = fitted(scatter)
    return theta, covariance, scatter
