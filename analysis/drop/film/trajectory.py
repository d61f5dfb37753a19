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

from analysis.drop.film.flights import Flight, jitter
from analysis.drop.laws.flight_law import FlightLaw
from analysis.statistics import mad_sigma
from kernels.arrays import Floats

SHAPES: dict[str, tuple[str, ...]] = {
    "parabola": ("g", "c", "d"),
    "friction": ("g", "f", "c", "d"),
    "drag": ("g", "k", "c", "d"),
    "friction+drag": ("g", "f", "k", "c", "d"),
}
_LIMITS = {"g": (1e-9, 1e9), "f": (-0.5, 0.9), "k": (0.0, np.inf), "c": (-np.inf, np.inf), "d": (-np.inf, np.inf)}
_TILT = 0.01  # standard deviation of c times the span of heights: the scale changes by 2 % from bottom to top
_LENS = 0.02  # of d times the square of the span: what is seen half way is off by a quarter of a per cent of the span
_BEYOND = 1.5  # of the reach, where the distortion stays what it is: nothing was seen there
_MOST_DRAG = 3.0  # so strong that a fall through the reach is all at terminal speed
_HIGHEST = 10.0  # an apex, in ranges of height: a step of the fit may go further astray than any ball
_HUBER = 2.5
_ROUNDING = 1e-12  # of a normal matrix


@dataclass(frozen=True)
class Block:
    """Normal equations of one flight: shape parameters, apex time and apex height."""

    normal: Floats  # (p + 2, p + 2)
    rhs: Floats  # (p + 2,)
    squares: float
    count: int

    def schur(self, damping: float = 0.0) -> tuple[Floats, Floats, Floats, Floats]:
        """Normal matrix and right side of the shape with the apex eliminated, and what gives the apex back."""
        p = len(self.rhs) - 2
        normal = self.normal + damping * np.diag(np.diag(self.normal))
        local = np.asarray(np.linalg.pinv(normal[p:, p:], rcond=1e-13, hermitian=True), dtype=np.float64)
        gain = normal[:p, p:] @ local
        return normal[:p, :p] - gain @ normal[p:, :p], self.rhs[:p] - gain @ self.rhs[p:], local, gain


@dataclass(frozen=True)
class Shape:
    """A joint fit."""

    name: str  # of `SHAPES`
    values: Floats  # (p,) ``g`` (unit/frame^2), ``f``, ``k`` (1/unit), as the shape has them
    # apex_frame, apex_height: (flights,)
    apex_frame: Floats
    apex_height: Floats
    covariance: Floats  # (p, p) of ``values``, scaled by the residuals
    blocks: list[Block]
    noise: float  # by which the blocks' residuals were divided
    sigma: float  # rms residual, unit
    prior: Floats  # (p,) precision of the prior on each value, in the blocks' unit of chi-square
    reach: float  # height at which the picture's distortion is none, from the middle

    def seen_at(self, flight: int, frame: Floats) -> Floats:
        """Height at which the ball of one of the flights is seen at ``frame`` (n,)."""
        height = self.apex_height[flight] - self.law.drop_m(frame - self.apex_frame[flight])
        c, d = self.values[-2:]
        near = np.clip(height, -_BEYOND * self.reach, _BEYOND * self.reach)
        return np.asarray(height + (c + d * near) * (near**2 - self.reach**2))

    @property
    def law(self) -> FlightLaw:
        """The flight law in the file's units."""
        return law_of(self.name, self.values)


def law_of(name: str, values: Floats) -> FlightLaw:
    """Flight law of shape ``name`` at ``values`` (p,), or at each of (draws, p)."""
    named = dict(zip(SHAPES[name], np.moveaxis(values, -1, 0), strict=True))
    drag = np.maximum(named["k"], 1e-8) if "k" in named else 0.0  # 0 to a parabola's last digit, but still a drag
    return FlightLaw(named["g"], named.get("f", 0.0), drag)


def noise_of(flights: Sequence[Flight]) -> float:
    """Noise of single positions, from within the flights."""
    thirds = [jitter(f.height) for f in flights if len(f.height) >= 8]
    return max(float(np.median(thirds)) if thirds else 0.0, 1e-9)


def fit_shape(
    name: str,
    flights: Sequence[Flight],
    acceleration: float,
    noise: float,
    near: Floats | None = None,
    unit: float = 1.0,
) -> Shape:
    """Fit one shape to all flights: Levenberg-Marquardt, each flight's apex eliminated (Schur complement).

    Flights are many and each has an apex of its own, and how far an error may go before it counts less (Huber) is a
    matter of each flight: no general solver takes both.

    Parameters
    ----------
    near
        Parameters to start from, where a fit to nearly the same flights is known.
    unit
        Chi-square that counts as 1 against the prior: residuals may be larger than ``noise``, or not independent.
    """
    span, reach = max(float(np.ptp(f.height)) for f in flights), flights[0].reach
    whole = float(max(f.height.max() for f in flights) - min(f.height.min() for f in flights))
    widths = {"c": _TILT / whole, "d": _LENS / whole**2}
    prior = np.array([unit / widths[key] ** 2 if key in widths else 0.0 for key in SHAPES[name]])
    start = {"g": acceleration, "f": 0.02, "k": 0.02 / span, "c": 0.0, "d": 0.0}
    values = np.array([start[p] for p in SHAPES[name]]) if near is None else near
    apex = np.array([_first_apex(f, acceleration) for f in flights])
    ends = np.array([[2 * f.frame[0] - f.frame[-1] - 2.0, 2 * f.frame[-1] - f.frame[0] + 2.0] for f in flights])

    def blocks_at(values: Floats, apex: Floats) -> tuple[list[Block], float]:
        blocks = [_block(name, values, a[0], a[1], f, noise) for a, f in zip(apex.tolist(), flights, strict=True)]
        return blocks, sum(b.squares for b in blocks) + float(prior @ values**2)

    damping, best = 1e-3, np.inf
    blocks, here = blocks_at(values, apex)
    for _ in range(60):
        moved, moved_apex = _step(values, apex, blocks, prior, damping, _limits(name, reach))
        moved_apex[:, 0] = np.clip(moved_apex[:, 0], ends[:, 0], ends[:, 1])
        moved_apex[:, 1] = np.clip(moved_apex[:, 1], -_HIGHEST * whole, _HIGHEST * whole)
        trial, there = blocks_at(moved, moved_apex)
        if there <= here * (1 + 1e-12):
            values, apex, blocks, here, damping = moved, moved_apex, trial, there, max(damping * 0.2, 1e-12)
            if best - there < 1e-6 * (1.0 + there) and damping < 1e-2:
                break
            best = there
        else:
            damping *= 8.0
        if damping > 1e10:
            break
    freedom = sum(b.count for b in blocks) - len(values) - 2 * len(blocks)
    spread = sum(b.squares for b in blocks) / max(freedom, 1)
    # The apexes' elimination leaves differences of large numbers: eigenvalues that are nothing but rounding, negative
    # ones among them, are left wide.
    normal = sum(b.schur()[0] for b in blocks) + np.diag(prior)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(sum(b.normal for b in blocks))[: len(values)] + prior, 1e-300))
    size, vectors = np.linalg.eigh(normal * np.outer(scale, scale))
    vectors = vectors * scale[:, None]
    covariance = (vectors / np.maximum(size, _ROUNDING)) @ vectors.T * max(spread, 1e-12)
    sigma = noise * float(np.sqrt(spread))
    return Shape(name, values, apex[:, 0], apex[:, 1], covariance, blocks, noise, sigma, prior, reach)


def _first_apex(flight: Flight, acceleration: float) -> tuple[float, float]:
    """Frame and height of a flight's apex, by a parabola of known acceleration."""
    t = flight.frame - flight.frame.mean()
    if len(t) < 3:
        return float(flight.frame[0]), float(flight.height[0])
    c = np.polynomial.polynomial.polyfit(t, flight.height + 0.5 * acceleration * t**2, 1)
    at = c[1] / acceleration
    return float(flight.frame.mean() + at), float(c[0] + c[1] * at / 2.0)


def _block(name: str, values: Floats, at: float, top: float, flight: Flight, noise: float) -> Block:
    """Normal equations of one flight with its apex at ``(at, top)``; far samples count less (Huber)."""
    since = flight.frame - at
    law = law_of(name, values)
    drop = law.drop_m(since)
    height = top - drop
    c, d = values[-2:]
    near = np.clip(height, -_BEYOND * flight.reach, _BEYOND * flight.reach)
    beyond = near**2 - flight.reach**2
    residual = (flight.height - height - (c + d * near) * beyond) / noise
    p = len(values)
    jacobian = np.zeros((len(since), p + 2))
    least = {"g": 1e-9, "f": 1e-4, "k": 100.0 / max(float(drop.max()), 1e-12)}  # a drag too small to be seen is 1e-8
    for j in range(p - 2):
        moved = values.copy()
        step = 1e-6 * max(abs(values[j]), least[SHAPES[name][j]])
        moved[j] += step
        jacobian[:, j] = -(law_of(name, moved).drop_m(since) - drop) / step
    jacobian[:, p] = -law.velocity_mps(since)
    jacobian[:, p + 1] = 1.0
    jacobian *= (1.0 + 2.0 * c * near + d * (beyond + 2.0 * near**2))[:, None]  # of the seen by the true height
    jacobian[:, p - 2], jacobian[:, p - 1] = beyond, near * beyond
    jacobian /= noise
    size = np.abs(residual)
    loose = _HUBER * max(1.0, mad_sigma(size))
    weighted = jacobian * np.minimum(1.0, loose / np.maximum(size, 1e-12))[:, None]
    squares = np.where(size <= loose, size**2, 2 * loose * size - loose**2).sum()
    return Block(weighted.T @ jacobian, weighted.T @ residual, float(squares), len(since))


def _limits(name: str, reach: float) -> tuple[Floats, Floats]:
    """Bounds of the parameters."""
    low, high = np.array([_LIMITS[key] for key in SHAPES[name]]).T
    if "k" in SHAPES[name] and reach > 0.0:
        high[SHAPES[name].index("k")] = _MOST_DRAG / reach
    return low, high


def _step(
    values: Floats, apex: Floats, blocks: list[Block], prior: Floats, damping: float, limits: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Values and apexes after one damped step."""
    parts = [b.schur(damping) for b in blocks]
    normal = sum(x[0] for x in parts) + np.diag(prior)
    change = _solved(normal, sum(x[1] for x in parts) - prior * values, 1e-12)
    moved = np.clip(values + change, *limits)
    p, change = len(values), moved - values
    return moved, apex + np.array([x[2] @ b.rhs[p:] - x[3].T @ change for x, b in zip(parts, blocks, strict=True)])


def _solved(normal: Floats, right: Floats, rcond: float) -> Floats:
    """Solution of normal equations whose unknowns have different units."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    solution = np.linalg.lstsq(normal * scale * scale[:, None], right * scale, rcond=rcond)[0]
    return np.asarray(scale * solution, dtype=np.float64)


def surprise(known: Shape, flight: Flight, noise: float, sigma: float, worth: float) -> float:
    """Minus the log likelihood of a flight under a shape fitted to other flights, less terms common to all shapes.

    The apex is the flight's own. The shape is known only as well as ``known.covariance`` says: it is integrated out
    (Woodbury), so a shape that the other flights hardly fix is not blamed for where its best value happens to lie.
    ``sigma`` is the error of a position, ``worth`` the independent samples a sample is worth.
    """
    block, p = _at_apex(known, flight, noise), len(known.values)
    unit = worth * noise**2 / sigma**2
    normal, right = (part * unit for part in block.schur()[:2])
    prior = known.covariance * (sigma / max(known.sigma, 1e-12)) ** 2 / worth
    scale = np.sqrt(np.maximum(np.diag(prior), 1e-300))
    prior, normal, right = prior / np.outer(scale, scale), normal * np.outer(scale, scale), right * scale
    inner = np.eye(p) + prior @ normal
    freed = float(right @ np.linalg.solve(inner, prior @ right))
    spread = float(np.linalg.slogdet(inner)[1])
    return 0.5 * (block.squares * unit - freed + spread) + worth * block.count * float(np.log(sigma))


def _at_apex(shape: Shape, flight: Flight, noise: float) -> Block:
    """Normal equations of one flight at its best apex under a given shape."""
    at, top = _first_apex(flight, shape.law.g_mps2)
    block = _block(shape.name, shape.values, at, top, flight, noise)
    p = len(shape.values)
    for _ in range(12):
        change = np.linalg.lstsq(block.normal[p:, p:], block.rhs[p:], rcond=None)[0]
        at, top = at + float(change[0]), top + float(change[1])
        moved = _block(shape.name, shape.values, at, top, flight, noise)
        if not moved.squares < block.squares:  # arrived; or a step too far, which a flight of few samples may take
            break
        block = moved
    return block


def draws_of(shape: Shape, rng: np.random.Generator, count: int, worth: float = 1.0) -> tuple[Floats, Floats, Floats]:
    """Draws of (values, apex frames, apex heights), shapes (count, p), (count, flights), (count, flights).

    The shape's draws have the wider of the fit's covariance and a bootstrap over flights; ``worth`` is how many
    independent samples a sample is worth.
    """
    p, n = len(shape.values), len(shape.blocks)
    parts = [b.schur() for b in shape.blocks]
    boot = np.empty((count, p))
    for b in range(count):
        weight = np.bincount(rng.integers(n, size=n), minlength=n)
        normal = sum(w * x[0] for w, x in zip(weight, parts, strict=True)) + np.diag(shape.prior)
        right = sum(w * x[1] for w, x in zip(weight, parts, strict=True)) - shape.prior * shape.values
        boot[b] = _solved(normal, right, 1e-10)
    wide = [mad_sigma(column) for column in boot.T] if n >= 4 else np.zeros(p)
    sigma = np.maximum(np.sqrt(np.diag(shape.covariance)), 1e-300)
    stretch = np.maximum(1.0, np.minimum(wide / sigma, 5.0))
    correlation = shape.covariance / np.outer(sigma, sigma)
    change = rng.multivariate_normal(np.zeros(p), correlation, size=count, method="svd") * sigma * stretch
    values = np.clip(shape.values + change, *_limits(shape.name, shape.reach))
    apex = np.empty((2, count, n))
    for i, (_, _, local, gain) in enumerate(parts):
        spread = (max(shape.sigma, 1e-12) / shape.noise) ** 2 / worth
        own = rng.multivariate_normal(np.zeros(2), local * spread, size=count, method="svd")
        own -= (values - shape.values) @ gain
        apex[:, :, i] = own.T + np.array([[shape.apex_frame[i]], [shape.apex_height[i]]])
    return values, apex[0], apex[1]
