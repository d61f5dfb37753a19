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
from numpy.typing import NDArray

from analysis.drop.film.flights import Flight, jitter
from analysis.drop.laws.flightlaw import FlightLaw
from analysis.statistics import MAD_TO_SIGMA

Array = NDArray[np.float64]

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
_MOST_DRAG = 3.0
_HIGHEST = 10.0  # an apex, in ranges of height: a step of the fit may go further astray than any ball
_HUBER = 2.5
_ROUNDING = 1e-12  # of a normal matrix


@dataclass(frozen=True)
class Block:
    """Normal equations of one flight: shape parameters, apex time and apex height."""

    normal: Array  # (p + 2, p + 2)
    rhs: Array  # (p + 2,)
    squares: float
    count: int


@dataclass(frozen=True)
class Shape:
    """A joint fit.

    Attributes
    ----------
    name : str
        Of `SHAPES`.
    values : (p,) float64
        ``g`` (unit/frame^2), ``f``, ``k`` (1/unit), as the shape has them.
    apex_frame, apex_height : (flights,) float64
    covariance : (p, p) float64
        Of ``values``, scaled by the residuals.
    blocks : list of Block
    sigma : float
        Rms residual, unit.
    prior : (p,) float64
        Precision of the prior on each value, in the blocks' unit of chi-square.
    reach : float
        Height at which the picture's distortion is none, from the middle.
    """

    name: str
    values: Array
    apex_frame: Array
    apex_height: Array
    covariance: Array
    blocks: list[Block]
    sigma: float
    prior: Array
    reach: float

    def seen(self, height: Array) -> Array:
        """Where points at true ``height`` are seen."""
        c, d = self.values[-2:]
        near = np.clip(height, -_BEYOND * self.reach, _BEYOND * self.reach)
        return np.asarray(height + (c + d * near) * (near**2 - self.reach**2))

    @property
    def law(self) -> FlightLaw:
        """The flight law in the file's units."""
        return law_of(self.name, self.values)


def law_of(name: str, values: Array) -> FlightLaw:
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
    near: Array | None = None,
    unit: float = 1.0,
) -> Shape:
    """Fit one shape to all flights: Levenberg-Marquardt, each flight's apex eliminated (Schur complement).

    ``near``: parameters to start from, where a fit to nearly the same flights is known. ``unit``: the chi-square of
    these samples that counts as 1 against the prior, for residuals larger than ``noise`` or not independent.
    """
    span = max(float(np.ptp(f.height)) for f in flights)
    whole = float(max(f.height.max() for f in flights) - min(f.height.min() for f in flights))
    widths = {"c": _TILT / whole, "d": _LENS / whole**2}
    prior = np.array([unit / widths[key] ** 2 if key in widths else 0.0 for key in SHAPES[name]])
    start = {"g": acceleration, "f": 0.02, "k": 0.02 / span, "c": 0.0, "d": 0.0}
    values = np.array([start[p] for p in SHAPES[name]]) if near is None else near.copy()
    apex = np.array([_first_apex(f, acceleration) for f in flights])
    ends = np.array([[2 * f.frame[0] - f.frame[-1] - 2.0, 2 * f.frame[-1] - f.frame[0] + 2.0] for f in flights])
    damping, best = 1e-3, np.inf
    blocks = [_block(name, values, float(a[0]), float(a[1]), f, noise) for a, f in zip(apex, flights, strict=True)]
    for _ in range(60):
        moved, moved_apex = _step(values, apex, blocks, prior, damping, _limits(name, flights[0].reach))
        moved_apex[:, 0] = np.clip(moved_apex[:, 0], ends[:, 0], ends[:, 1])
        moved_apex[:, 1] = np.clip(moved_apex[:, 1], -_HIGHEST * whole, _HIGHEST * whole)
        pairs = zip(moved_apex, flights, strict=True)
        trial = [_block(name, moved, float(a[0]), float(a[1]), f, noise) for a, f in pairs]
        before = sum(b.squares for b in blocks) + float(prior @ values**2)
        after = sum(b.squares for b in trial) + float(prior @ moved**2)
        if after <= before * (1 + 1e-12):
            values, apex, blocks, damping = moved, moved_apex, trial, max(damping * 0.2, 1e-12)
            if best - after < 1e-6 * (1.0 + after) and damping < 1e-2:
                break
            best = after
        else:
            damping *= 8.0
            if damping > 1e10:
                break
    dof = max(sum(b.count for b in blocks) - len(values) - 2 * len(blocks), 1)
    spread = sum(b.squares for b in blocks) / dof
    schur = sum(_schur(b, len(values))[0] for b in blocks) + np.diag(prior)
    size = np.diag(sum(b.normal for b in blocks))[: len(values)] + prior
    covariance = _positive_inverse(schur, size) * max(spread, 1e-12)
    sigma = noise * float(np.sqrt(spread))
    return Shape(name, values, apex[:, 0], apex[:, 1], covariance, blocks, sigma, prior, flights[0].reach)


def _positive_inverse(normal: Array, size: Array) -> Array:
    """Inverse of a normal matrix whose small eigenvalues may be negative by rounding: those directions are left wide.

    ``size``: its diagonal before anything was eliminated.
    """
    scale = 1.0 / np.sqrt(np.maximum(size, 1e-300))
    values, vectors = np.linalg.eigh(normal * np.outer(scale, scale))
    vectors = vectors * scale[:, None]
    return np.asarray((vectors / np.maximum(values, _ROUNDING)) @ vectors.T, dtype=np.float64)


def _first_apex(flight: Flight, acceleration: float) -> tuple[float, float]:
    t = flight.frame - flight.frame.mean()
    if len(t) < 3:
        return float(flight.frame[0]), float(flight.height[0])
    c = np.polynomial.polynomial.polyfit(t, flight.height + 0.5 * acceleration * t**2, 1)
    at = c[1] / acceleration
    return float(flight.frame.mean() + at), float(c[0] + c[1] * at / 2.0)


def _block(name: str, values: Array, at: float, top: float, flight: Flight, noise: float) -> Block:
    since = flight.frame - at
    drop = law_of(name, values).drop_m(since)
    height = top - drop
    c, d = values[-2:]
    near = np.clip(height, -_BEYOND * flight.reach, _BEYOND * flight.reach)
    beyond = near**2 - flight.reach**2
    residual = (flight.height - height - (c + d * near) * beyond) / noise
    p = len(values)
    jacobian = np.zeros((len(since), p + 2))
    least = {"g": 1e-9, "f": 1e-4, "k": 100.0 / max(float(drop.max()), 1e-12)}  # a drag too small to be told is 1e-8
    for j in range(p - 2):
        moved = values.copy()
        step = 1e-6 * max(abs(values[j]), least[SHAPES[name][j]])
        moved[j] += step
        jacobian[:, j] = -(law_of(name, moved).drop_m(since) - drop) / step
    jacobian[:, p] = -law_of(name, values).velocity_mps(since)
    jacobian[:, p + 1] = 1.0
    jacobian *= (1.0 + 2.0 * c * near + d * (beyond + 2.0 * near**2))[:, None]
    jacobian[:, p - 2], jacobian[:, p - 1] = beyond, near * beyond
    jacobian /= noise
    size = np.abs(residual)
    loose = _HUBER * max(1.0, MAD_TO_SIGMA * float(np.median(size)))
    weight = np.minimum(1.0, loose / np.maximum(size, 1e-12))
    weighted = jacobian * weight[:, None]
    squares = np.where(size <= loose, size**2, 2 * loose * size - loose**2).sum()
    return Block(weighted.T @ jacobian, weighted.T @ residual, float(squares), len(since))


def _schur(block: Block, p: int, damping: float = 0.0) -> tuple[Array, Array, Array, Array]:
    """Normal matrix and right side of the shape with the apex eliminated, and what gives the apex back."""
    normal = block.normal + damping * np.diag(np.diag(block.normal))
    local = np.asarray(np.linalg.pinv(normal[p:, p:], rcond=1e-13, hermitian=True), dtype=np.float64)
    gain = normal[:p, p:] @ local
    return normal[:p, :p] - gain @ normal[p:, :p], block.rhs[:p] - gain @ block.rhs[p:], local, gain


def _limits(name: str, reach: float) -> tuple[Array, Array]:
    """Bounds of the parameters; drag at most so strong that a fall through ``reach`` is all at terminal speed."""
    low, high = np.array([_LIMITS[key] for key in SHAPES[name]]).T
    if "k" in SHAPES[name] and reach > 0.0:
        high[SHAPES[name].index("k")] = _MOST_DRAG / reach
    return low, high


def _step(
    values: Array, apex: Array, blocks: list[Block], prior: Array, damping: float, limits: tuple[Array, Array]
) -> tuple[Array, Array]:
    p = len(values)
    parts = [_schur(b, p, damping) for b in blocks]
    normal = sum(x[0] for x in parts) + np.diag(prior)
    right = sum(x[1] for x in parts) - prior * values
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    change = scale * np.linalg.lstsq(normal * scale * scale[:, None], right * scale, rcond=1e-12)[0]
    moved = np.clip(values + change, *limits)
    change = moved - values
    locals_ = [x[2] @ b.rhs[p:] - x[3].T @ change for x, b in zip(parts, blocks, strict=True)]
    return moved, apex + np.array(locals_)


def surprise(known: Shape, flight: Flight, noise: float, sigma: float, worth: float) -> float:
    """Minus the log likelihood of a flight under a shape fitted to other flights, less terms common to all shapes.

    The apex is the flight's own. The shape is known only as well as ``known.covariance`` says: it is integrated out
    (Woodbury), so a shape that the other flights hardly fix is not blamed for where its best value happens to lie.
    ``sigma`` is the error of a position, ``worth`` the independent samples a sample is worth.
    """
    block, p = _at_apex(known, flight, noise), len(known.values)
    unit = worth * noise**2 / sigma**2
    normal, right = (part * unit for part in _schur(block, p)[:2])
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


def draws_of(shape: Shape, rng: np.random.Generator, count: int, worth: float = 1.0) -> tuple[Array, Array, Array]:
    """Draws of (values, apex frames, apex heights), shapes (count, p), (count, flights), (count, flights).

    The shape's draws have the wider of the fit's covariance and a bootstrap over flights; ``worth`` is how many
    independent samples a sample is worth.
    """
    p, n = len(shape.values), len(shape.blocks)
    parts = [_schur(b, p) for b in shape.blocks]
    spread = max(shape.sigma, 1e-12) ** 2 / max(_noise_unit(shape), 1e-300) / worth
    boot = np.empty((count, p))
    for b in range(count):
        weight = np.bincount(rng.integers(n, size=n), minlength=n)
        normal = sum(w * x[0] for w, x in zip(weight, parts, strict=True)) + np.diag(shape.prior)
        right = sum(w * x[1] for w, x in zip(weight, parts, strict=True)) - shape.prior * shape.values
        unit = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        boot[b] = unit * np.linalg.lstsq(normal * np.outer(unit, unit), right * unit, rcond=1e-10)[0]
    wide = MAD_TO_SIGMA * np.median(np.abs(boot), axis=0) if n >= 4 else np.zeros(p)
    sigma = np.sqrt(np.diag(shape.covariance))
    stretch = np.maximum(1.0, np.minimum(wide / np.maximum(sigma, 1e-300), 5.0))
    unit = np.maximum(sigma, 1e-300)
    correlation = shape.covariance / np.outer(unit, unit)
    change = rng.multivariate_normal(np.zeros(p), correlation, size=count, method="svd") * unit * stretch
    values = np.clip(shape.values + change, *_limits(shape.name, shape.reach))
    apex = np.empty((2, count, n))
    for i, (_, _, local, gain) in enumerate(parts):
        own = rng.multivariate_normal(np.zeros(2), local * spread, size=count, method="svd")
        own -= (values - shape.values) @ gain
        apex[0, :, i], apex[1, :, i] = shape.apex_frame[i] + own[:, 0], shape.apex_height[i] + own[:, 1]
    return values, apex[0], apex[1]


def _noise_unit(shape: Shape) -> float:
    """The noise^2 that the blocks were divided by, recovered from sigma and the squares."""
    dof = max(sum(b.count for b in shape.blocks) - len(shape.values) - 2 * len(shape.blocks), 1)
    return shape.sigma**2 / max(sum(b.squares for b in shape.blocks) / dof, 1e-300)
