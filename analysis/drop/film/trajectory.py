"""All flights of a camera's drops fitted together: one gravity, one friction, one drag; an apex for each flight.

Positions are fitted in the file's own units (pixels, frames), so restitution and friction, which are ratios, owe
nothing to a scale or a frame rate. Friction shows as ``g (1 + f)`` up and ``g (1 - f)`` down. The picture may be
distorted: a point at ``h`` is seen at ``h + (c + d h)(h^2 - H^2)`` (a tilted camera, a lens), with a prior on ``c`` and
``d``; ``H`` reaches from the middle to the ends, so that the scale is that of a ruler along the whole fall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from analysis.drop.film.track import Flight, jitter
from analysis.drop.laws import FlightLaw
from analysis.statistics import mad_sigma
from kernels.arrays import Floats

SHAPES: dict[str, tuple[str, ...]] = {
    "parabola": ("g", "c", "d"),
    "friction": ("g", "f", "c", "d"),
    "drag": ("g", "k", "c", "d"),
    "friction+drag": ("g", "f", "k", "c", "d"),
}
_LIMITS = {"g": (1e-9, 1e9), "f": (-0.5, 0.9), "k": (0.0, np.inf), "c": (-np.inf, np.inf), "d": (-np.inf, np.inf)}


@dataclass(frozen=True)
class Seen:
    """One flight under a shape, at the apex that suits it best; the apex is eliminated from the slopes."""

    at: float  # frame of the apex
    top: float  # its height
    residual: Floats  # (n,) measured less seen over the noise; far ones count less (Huber)
    slopes: Floats  # (n, p) of what is seen by the shape's values, the apex following
    local: Floats  # (2, 2) covariance of the apex, in squares of the noise
    gain: Floats  # (2, p) by which the apex follows the values


@dataclass(frozen=True)
class Shape:
    """A joint fit."""

    name: str  # of `SHAPES`
    values: Floats  # (p,) ``g`` (unit/frame^2), ``f``, ``k`` (1/unit), as the shape has them
    covariance: Floats  # (p, p) of ``values``, scaled by the residuals
    seen: list[Seen]  # each flight
    noise: float  # by which residuals were divided
    sigma: float  # rms residual, unit
    prior: Floats  # (p,) precision of the prior on each value, in squares of the noise
    reach: float  # height at which the picture's distortion is none, from the middle

    @property
    def apex_frame(self) -> Floats:
        """Frame of each flight's apex, shape (flights,)."""
        return np.array([one.at for one in self.seen])

    def seen_at(self, flight: int, frame: Floats) -> Floats:
        """Height at which the ball of one of the flights is seen at ``frame`` (n,)."""
        height = self.seen[flight].top - self.law.drop_m(frame - self.seen[flight].at)
        return _seen_of(height, self.reach, self.values)[0]

    @property
    def law(self) -> FlightLaw:
        """The flight law in the file's units."""
        return law_of(self.name, self.values)


def law_of(name: str, values: Floats) -> FlightLaw:
    """Flight law of shape ``name`` at ``values`` (p,), or at each of (draws, p)."""
    named = dict(zip(SHAPES[name], np.moveaxis(values, -1, 0), strict=True))
    drag = np.maximum(named["k"], 1e-8) if "k" in named else 0.0  # 0 to a parabola's last digit, but still a drag
    return FlightLaw(named["g"], named.get("f", 0.0), drag)


def _seen_of(height: Floats, reach: float, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Where points at ``height`` (n,) are seen, the slope of it by height, and (n, 2) by the distortion's values."""
    c, d = values[-2:]
    near = np.clip(height, -1.5 * reach, 1.5 * reach)  # beyond nothing was seen: the distortion stays what it is
    beyond = near**2 - reach**2
    bent = 1.0 + 2.0 * c * near + d * (beyond + 2.0 * near**2)
    return height + (c + d * near) * beyond, bent, np.column_stack([beyond, near * beyond])


def noise_of(flights: Sequence[Flight]) -> float:
    """Noise of single positions, from within the flights."""
    thirds = [jitter(f.height) for f in flights if len(f.height) >= 8]
    return max(float(np.median(thirds)) if thirds else 0.0, 1e-9)


def fit_shape(
    name: str, flights: Sequence[Flight], acceleration: float, noise: float, near: Floats | None = None,
    unit: float = 1.0,
) -> Shape:  # fmt: skip
    """Fit one shape to all flights: least squares of its values, with each flight's apex the best for them.

    It starts from the values ``near``, of a fit to nearly the same flights. A chi-square of ``unit`` counts as 1
    against the prior: residuals may be larger than ``noise``, or not independent.
    """
    span, reach = max(float(np.ptp(f.height)) for f in flights), flights[0].reach
    whole = float(max(f.height.max() for f in flights) - min(f.height.min() for f in flights))
    # one standard deviation: a tilted camera changes the scale by 2 % from bottom to top, a lens by 0.5 % in the middle
    widths = {"c": 0.01 / whole, "d": 0.02 / whole**2}
    prior = np.array([unit / widths[key] ** 2 if key in widths else 0.0 for key in SHAPES[name]])
    start = {"g": acceleration, "f": 0.02, "k": 0.02 / span, "c": 0.0, "d": 0.0}
    low, high = _limits(name, reach)
    low[0], high[0] = acceleration / 4.0, acceleration * 4.0  # else a strong drag makes any gravity a straight line
    begin = np.array([start[key] for key in SHAPES[name]]) if near is None else near
    inside = np.where(np.isfinite(high) & np.isfinite(low), 1e-6 * (high - low), 0.0)
    begin = np.clip(begin, low + inside, high - inside)
    apexes, least = [_first_apex(flight, acceleration) for flight in flights], np.inf
    last: tuple[Floats, list[Seen]] = (np.full(len(begin), np.nan), [])

    def seen_under(values: Floats) -> list[Seen]:
        nonlocal apexes, least, last
        if np.array_equal(values, last[0]):  # the slopes, where the residuals have just been asked for
            return last[1]
        found = [_seen(name, values, apex, f, noise) for apex, f in zip(apexes, flights, strict=True)]
        squares = sum(float(one.residual @ one.residual) for one in found) + float(prior @ values**2)
        if squares <= least:  # the next ones are near these
            apexes, least = [(one.at, one.top) for one in found], squares
        last = (values.copy(), found)
        return found

    def left(values: Floats) -> Floats:
        return np.concatenate([*(one.residual for one in seen_under(values)), -np.sqrt(prior) * values])

    def slopes(values: Floats) -> Floats:
        return -np.concatenate([*(one.slopes for one in seen_under(values)), np.diag(np.sqrt(prior))])

    scale = np.array([{"g": acceleration, "f": 0.1, "k": 0.1 / span}.get(key) or widths[key] for key in SHAPES[name]])
    found = least_squares(left, begin, slopes, (low, high), x_scale=scale, ftol=1e-9, xtol=1e-9, max_nfev=60)
    values, seen = found.x, seen_under(found.x)
    count = sum(len(flight.frame) for flight in flights)
    spread = sum(float(one.residual @ one.residual) for one in seen) / max(count - len(values) - 2 * len(flights), 1)
    # Eigenvalues that are nothing but rounding are left wide.
    normal = sum(one.slopes.T @ one.slopes for one in seen) + np.diag(prior)
    own = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    size, vectors = np.linalg.eigh(normal * np.outer(own, own))
    vectors = vectors * own[:, None]
    covariance = (vectors / np.maximum(size, 1e-12)) @ vectors.T * max(spread, 1e-12)
    return Shape(name, values, covariance, seen, noise, noise * float(np.sqrt(spread)), prior, reach)


def _first_apex(flight: Flight, acceleration: float) -> tuple[float, float]:
    """Frame and height of a flight's apex, by a parabola of known acceleration."""
    t = flight.frame - flight.frame.mean()
    if len(t) < 3:
        return float(flight.frame[0]), float(flight.height[0])
    c = np.polynomial.polynomial.polyfit(t, flight.height + 0.5 * acceleration * t**2, 1)
    at = c[1] / acceleration
    return float(flight.frame.mean() + at), float(c[0] + c[1] * at / 2.0)


def _seen(name: str, values: Floats, apex: tuple[float, float], flight: Flight, noise: float) -> Seen:
    """A flight at its best apex, by Gauss-Newton from ``apex``."""
    law = law_of(name, values)

    def at_apex(at: float, top: float) -> tuple[Floats, Floats, Floats]:
        """Signed root of Huber's function of the residual, its derivative, and its slopes by the apex."""
        since = flight.frame - at
        seen, bent, _ = _seen_of(top - law.drop_m(since), flight.reach, values)
        residual = (flight.height - seen) / noise
        size = np.abs(residual)
        # Huber's weight from 2.5 standard deviations on
        loose = 2.5 * max(1.0, mad_sigma(size))
        root = np.where(size <= loose, size, np.sqrt(np.maximum(2.0 * loose * size - loose**2, loose**2)))
        factor = np.where(size <= loose, 1.0, loose / root.clip(1e-12))
        by_apex = np.column_stack([-law.velocity_mps(since), np.ones_like(since)]) * (bent * factor / noise)[:, None]
        return np.sign(residual) * root, factor, by_apex

    root, factor, by_apex = at_apex(*apex)
    for _ in range(12):
        change = np.linalg.lstsq(by_apex, root, rcond=1e-10)[0]
        moved = (apex[0] + float(change[0]), apex[1] + float(change[1]))
        there = at_apex(*moved)
        if not there[0] @ there[0] < root @ root * (1.0 - 1e-12):  # arrived; or a step too far, of few samples
            break
        apex, (root, factor, by_apex) = moved, there
    since = flight.frame - apex[0]
    drop = law.drop_m(since)
    _, bent, by_distortion = _seen_of(apex[1] - drop, flight.reach, values)
    slopes = np.empty((len(since), len(values)))
    slopes[:, -2:] = by_distortion
    least = {"g": 1e-9, "f": 1e-4, "k": 100.0 / max(float(drop.max()), 1e-12)}  # a drag too small to be seen is 1e-8
    for j, key in enumerate(SHAPES[name][:-2]):
        step = 1e-6 * max(abs(values[j]), least[key])
        moved_values = values + step * (np.arange(len(values)) == j)
        slopes[:, j] = -(law_of(name, moved_values).drop_m(since) - drop) / step * bent
    slopes *= (factor / noise)[:, None]
    back = np.linalg.pinv(by_apex, rcond=1e-10)
    return Seen(*apex, root, slopes - by_apex @ (back @ slopes), back @ back.T, -back @ slopes)


def _limits(name: str, reach: float) -> tuple[Floats, Floats]:
    """Bounds of the parameters."""
    low, high = np.array([_LIMITS[key] for key in SHAPES[name]]).T
    if "k" in SHAPES[name] and reach > 0.0:
        # with k of 3 over the reach the whole fall is at terminal speed: more cannot be seen
        high[SHAPES[name].index("k")] = 3.0 / reach
    return low, high


def surprise(known: Shape, flight: Flight, noise: float, sigma: float, worth: float) -> float:
    """Minus the log likelihood of a flight under a shape fitted to other flights, less terms common to all shapes.

    The apex is the flight's own. The shape is known only as well as ``known.covariance`` says: it is integrated out
    (Woodbury), so a shape that the other flights hardly fix is not blamed for where its best value happens to lie.
    ``sigma`` is the error of a position, ``worth`` the independent samples a sample is worth.
    """
    one = _seen(known.name, known.values, _first_apex(flight, known.law.g_mps2), flight, noise)
    unit = worth * noise**2 / sigma**2
    prior = known.covariance * (sigma / max(known.sigma, 1e-12)) ** 2 / worth
    scale = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    prior, slopes = prior / np.outer(scale, scale), one.slopes * scale
    normal, right = unit * slopes.T @ slopes, unit * slopes.T @ one.residual
    inner = np.eye(len(scale)) + prior @ normal
    freed = float(right @ np.linalg.solve(inner, prior @ right))
    spread = float(np.linalg.slogdet(inner)[1])
    squares = float(one.residual @ one.residual)
    return 0.5 * (squares * unit - freed + spread) + worth * len(one.residual) * float(np.log(sigma))


def draws_of(shape: Shape, rng: np.random.Generator, count: int, worth: float = 1.0) -> tuple[Floats, Floats, Floats]:
    """Draws of (values, apex frames, apex heights), shapes (count, p), (count, flights), (count, flights).

    The shape's draws have the wider of the fit's covariance and a bootstrap over flights; ``worth`` is how many
    independent samples a sample is worth.
    """
    p, n = len(shape.values), len(shape.seen)
    normals = np.array([one.slopes.T @ one.slopes for one in shape.seen])
    rights = np.array([one.slopes.T @ one.residual for one in shape.seen])
    boot = np.empty((count, p))
    for b in range(count):
        weight = np.bincount(rng.integers(n, size=n), minlength=n)
        normal = np.tensordot(weight, normals, 1) + np.diag(shape.prior)
        own = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))  # unknowns have different units
        right = (weight @ rights - shape.prior * shape.values) * own
        boot[b] = own * np.linalg.lstsq(normal * np.outer(own, own), right, rcond=1e-10)[0]
    wide = [mad_sigma(column) for column in boot.T] if n >= 4 else np.zeros(p)
    sigma = np.maximum(np.sqrt(np.diag(shape.covariance)), 1e-300)
    stretch = np.maximum(1.0, np.minimum(wide / sigma, 5.0))
    correlation = shape.covariance / np.outer(sigma, sigma)
    change = rng.multivariate_normal(np.zeros(p), correlation, size=count, method="svd") * sigma * stretch
    values = np.clip(shape.values + change, *_limits(shape.name, shape.reach))
    apex = np.empty((2, count, n))
    for i, one in enumerate(shape.seen):
        spread = (max(shape.sigma, 1e-12) / shape.noise) ** 2 / worth
        own = rng.multivariate_normal(np.array([one.at, one.top]), one.local * spread, size=count, method="svd")
        apex[:, :, i] = (own + (values - shape.values) @ one.gain.T).T
    return values, apex[0], apex[1]
