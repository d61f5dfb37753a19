"""Falls of one camera: the law of a fall in closed form, and the fit of all together."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal
from scipy.optimize import least_squares

from analysis.drop.laws import FlightLaw
from kernels.arrays import Floats

_NUMBERED = re.compile(r"[\W_]*(drop|run|trial|fall|test|lancio|versuch)?[\W_]*\d+\W*$", re.IGNORECASE)


@dataclass(frozen=True)
class Fall:
    """One drop of one ball, heights counted upward."""

    name: str
    ball: str  # drops of one ball share its drag
    time_s: Floats  # (n,) as the file has them, even or not
    height_m: Floats  # (n,)


def is_fall(time: Floats, height: Floats) -> int:
    """+1 for a fall whose heights are counted upward, -1 where they are counted downward, 0 for any other motion.

    A fall goes one way, but for its noise and single strays, and is faster at its end than at its beginning.
    """
    if len(height) < 8 or np.any(np.diff(time) <= 0.0):
        return 0
    height = signal.medfilt(height, 3)
    height[[0, -1]] = height[[1, -2]]  # the filter takes zeros beyond the ends
    span = float(np.ptp(height))
    if span <= 0.0:
        return 0
    sign = 1 if height[0] > height[-1] else -1
    down = -sign * (height - height[0])
    behind = float((np.maximum.accumulate(down) - down).max())
    gone = down[-1] - down[0]
    third = len(down) // 3
    early, late = (np.polyfit(time[part], down[part], 1)[0] for part in (slice(0, third + 1), slice(-third - 1, None)))
    # in a fall that its noise disturbs a height goes up again by no more than a twentieth of the range
    falls = behind < 0.05 * span and gone > 0.9 * span and late > 1.3 * max(early, 0.0)
    return sign if falls else 0


def with_balls(falls: Sequence[Fall]) -> list[Fall]:
    """The falls, each with its ball's name: what its own name is without the number of the drop.

    ``NAME (SHEET, drop 1)`` of a workbook is a drop of the ball SHEET, ``tennis-2.csv`` one of the ball tennis, where
    there is more than one of it: else the number may belong to the ball.
    """
    inner = [m.group(1) if (m := re.search(r"\((.*)\)$", f.name)) else "" for f in falls]
    files = {f.name.split(" (")[0] for f in falls}
    names = []
    for fall, label in zip(falls, inner, strict=True):
        parts = [part.strip() for part in label.split(",")]
        stem = fall.name.split(" (")[0].rsplit(".", 1)[0]
        own = ", ".join(parts[:-1]) if len(parts) > 1 else _NUMBERED.sub("", label)
        names.append(f"{stem} {own}".strip() if len(files) > 1 or not own else own)
    bare = [_NUMBERED.sub("", name) or name for name in names]
    several, single = Counter(bare), Counter(names)
    balls = [b if several[b] > 1 and single[n] == 1 else n for n, b in zip(names, bare, strict=True)]
    return [replace(fall, ball=ball) for fall, ball in zip(falls, balls, strict=True)]


def fallen_m(since_s: Floats, g_mps2: Floats | float, k_per_m: Floats | float, c_per_s: Floats | float) -> Floats:
    """Way down since the ball was at rest in still air, m (n,); times before that are of a ball that rises.

    Quadratic drag ``k`` (ln cosh, Rayleigh) or linear drag ``c`` (Stokes), one for all or one a time. A drag below zero
    is no ball's; it goes on smoothly so that the interval of a drag can hold zero.
    """
    if np.any(c_per_s):
        x = c_per_s * since_s
        small = np.abs(x) < 1e-3
        safe = np.where(small, 1.0, x)
        share = np.where(small, 0.5 - x / 6.0, (safe + np.expm1(-safe)) / safe**2)
        return np.asarray(g_mps2 * since_s**2 * share)
    return np.asarray(FlightLaw(g_mps2, 0.0, k_per_m).drop_m(since_s))


@dataclass(frozen=True)
class Axis:
    """Axis of the heights, m: its middle and half of its length, over all falls of one camera."""

    middle_m: float
    reach_m: float

    def terms_m(self, height_m: Floats) -> Floats:
        """Errors of heights (n, 3) that a scale, a bend and a skew of one make.

        A bend is wrong by the reach in the middle and right at both ends: the scale changes by four times as much from
        the lower to the upper end, as where a camera is tilted. A skew is right at both ends and in the middle: a lens.
        """
        h = np.clip((height_m - self.middle_m) / self.reach_m, -1.5, 1.5)
        return np.asarray(self.reach_m * np.column_stack([h, h * h - 1.0, h**3 - h]))


# Every parameter and whose it is. A drop's release is always its own: its height and its time.
COMMON, BALL, DROP = "common", "ball", "drop"
OWNER = {
    "g_mps2": COMMON, "scale": COMMON, "bend": COMMON, "skew": COMMON, "wind_mps": COMMON,
    "k_per_m": BALL, "c_per_s": BALL, "bulk_m": BALL, "own_scale": DROP, "own_bend": DROP, "own_skew": DROP,
    "below_m": DROP, "top_m": DROP, "release_s": DROP,
}  # fmt: skip
AXIS, OWN_AXIS = ("scale", "bend", "skew"), ("own_scale", "own_bend", "own_skew")
# Standard deviations of priors about zero: a ruler is laid in a plane that the balls need not be in, a hand gives a
# speed of a metre or two a second, air under a bridge rises or sinks by half a metre a second. Each drop is a film that
# was calibrated by itself: what is its own axis's has `Noise.axis`.
PRIORS = {"scale": 0.05, "bend": 0.1, "skew": 0.05, "below_m": 0.2, "wind_mps": 0.5}
SPHERE = (0.5, 0.3)  # drag coefficient, smooth or rough, before the drag crisis or beyond it, with holes or without
AIR_KG_PER_M3 = 1.2

Sizes = Mapping[str, tuple[float, float]]  # ball -> mass, kg, and diameter, m
Values = Mapping[str, Mapping[str, float]]  # parameter -> owner -> value; the owner of what is common is ""


@dataclass(frozen=True)
class Setting:
    """What every fit of the same falls shares."""

    axis: Axis
    g_mps2: float
    sizes: Sizes

    def drag_per_m(self, ball: str) -> float | None:
        """Drag of a ball of known size with a drag coefficient of one, 1/m."""
        if ball not in self.sizes:
            return None
        mass_kg, diameter_m = self.sizes[ball]
        return 0.125 * AIR_KG_PER_M3 * np.pi * diameter_m**2 / mass_kg / (1.0 + 0.5 * self.air(ball))

    def air(self, ball: str) -> float:
        """Mass of the displaced air over that of the ball; NaN where its size is not known."""
        mass_kg, diameter_m = self.sizes.get(ball, (np.nan, np.nan))
        return AIR_KG_PER_M3 * np.pi / 6.0 * diameter_m**3 / mass_kg


@dataclass(frozen=True)
class Noise:
    """Errors of the heights."""

    sigma_m: float = 0.1  # of one height
    worth: float = 0.5  # independent samples per sample
    axis: float = 0.0  # standard deviation of scale, bend and skew of a drop's own axis


@dataclass(frozen=True)
class FallFit:
    """A joint fit."""

    names: tuple[str, ...]  # of the parameters beyond the releases
    values: dict[str, dict[str, float]]  # as `Values`
    sigmas: dict[str, dict[str, float]]  # standard deviations
    left: list[Floats]  # of each fall: read less predicted, m
    evidence: float  # logarithm of the probability of the heights, all parameters integrated out (Laplace)
    sigma_m: float  # rms residual over the degrees of freedom

    @property
    def rms_m(self) -> float:
        """Root mean square of all residuals, m."""
        return float(np.sqrt(np.mean(np.concatenate(self.left) ** 2)))


def owner_of(name: str, fall: Fall) -> str:
    """Whose value of a parameter a fall takes."""
    return {COMMON: "", BALL: fall.ball, DROP: fall.name}[OWNER[name]]


def heights_m(values: Values, setting: Setting, falls: Sequence[Fall], times_s: Sequence[Floats]) -> Floats:
    """Heights read for falls at times of each, one after the other; what ``values`` lacks is as in free fall."""
    counts = [len(times) for times in times_s]

    def value(name: str, usual: float = 0.0) -> Floats:
        own = values.get(name)
        if own is None:
            return np.asarray(usual)
        return np.repeat([own.get(owner_of(name, fall), usual) for fall in falls], counts)

    drag, wind = (value("k_per_m"), value("c_per_s")), value("wind_mps")
    air = np.repeat([setting.air(fall.ball) for fall in falls], counts)
    air = np.where(np.isnan(air), drag[0] * value("bulk_m"), air)
    g = value("g_mps2", setting.g_mps2) * ((1.0 - air) / (1.0 + 0.5 * air))  # buoyancy; half the air moves, too
    since, below = np.concatenate(times_s) - value("release_s"), value("below_m")
    before = wind / setting.g_mps2  # at rest in air that moves is as fallen in still air for a while
    fallen = fallen_m(np.maximum(since, 0.0) + before, g, *drag) - fallen_m(before, g, *drag) - wind * since.clip(0.0)
    # Held until it moves: at rest at the apex of its path, or so far below it as its first speed is worth.
    fallen = np.where(since > np.sqrt(2.0 * np.maximum(below, 0.0) / setting.g_mps2), fallen, below)
    height = value("top_m") - fallen
    for term, one, own in zip(setting.axis.terms_m(height).T, AXIS, OWN_AXIS, strict=True):
        height = height + term * (value(one) + value(own))
    return height


def fit_falls(
    falls: Sequence[Fall],
    names: Sequence[str],
    setting: Setting,
    noise: Noise,
    known: Values | None = None,
    near: FallFit | None = None,
) -> FallFit:
    """Least squares of all falls under the priors.

    ``names`` are parameters of `OWNER` to be fitted beyond each release, ``known`` values of further ones; the fit
    starts from ``near``.
    """
    fitted = (*names, "top_m", "release_s")
    slots = list(dict.fromkeys((name, owner_of(name, fall)) for name in fitted for fall in falls))
    bounds = np.cumsum([0, *(len(fall.time_s) for fall in falls)])
    read, times = np.concatenate([fall.height_m for fall in falls]), [fall.time_s for fall in falls]
    count, unit = int(bounds[-1]), noise.sigma_m / float(np.sqrt(noise.worth))
    usual, width = np.array([_prior(*slot, setting, noise) for slot in slots]).T
    judged = np.flatnonzero(np.isfinite(width))
    usual, width = usual[judged], width[judged]

    def left(vector: Floats) -> Floats:
        values = {**(known or {}), **_named(slots, vector)}
        return np.concatenate(
            [(read - heights_m(values, setting, falls, times)) / unit, (vector[judged] - usual) / width]
        )

    def slopes(vector: Floats) -> Floats:
        """Derivatives of `left`; all owners of one parameter are moved at once, for no sample knows two of them."""
        here, out = left(vector), np.zeros((count + len(judged), len(vector)))
        for name in fitted:
            own = [k for k, slot in enumerate(slots) if slot[0] == name]
            moved = vector.copy()
            moved[own] += 1e-6
            change = (left(moved) - here) / 1e-6
            for fall, start, stop in zip(falls, bounds[:-1], bounds[1:], strict=True):
                out[start:stop, slots.index((name, owner_of(name, fall)))] = change[start:stop]
        out[np.arange(len(judged)) + count, judged] = 1.0 / width
        return out

    # MINPACK uses one thread: of matrices as small as these, several only wait for each other.
    begin = _start(slots, falls, setting, near)
    found = least_squares(left, begin, jac=slopes, method="lm", x_scale="jac", max_nfev=60, ftol=1e-6)
    steep = slopes(found.x)
    normal = steep.T @ steep
    wide = np.sqrt(np.maximum(np.diag(np.linalg.pinv(normal)), 0.0))
    volume = float(np.log(width).sum()) + 0.5 * float(np.linalg.slogdet(normal)[1])
    evidence = -0.5 * float(found.fun @ found.fun) - volume - noise.worth * count * float(np.log(noise.sigma_m))
    residuals = [part * unit for part in np.split(found.fun[:count], bounds[1:-1])]
    squares = float(sum(part @ part for part in residuals))
    sigma = float(np.sqrt(squares / max(count - len(slots) + len(judged), 1)))
    return FallFit(tuple(names), _named(slots, found.x), _named(slots, wide), residuals, evidence, sigma)


def _named(slots: Sequence[tuple[str, str]], vector: Floats) -> dict[str, dict[str, float]]:
    """Parameter -> owner -> value."""
    out: dict[str, dict[str, float]] = {name: {} for name, _ in slots}
    for (name, owner), value in zip(slots, vector.tolist(), strict=True):
        out[name][owner] = value
    return out


def _prior(name: str, owner: str, setting: Setting, noise: Noise) -> tuple[float, float]:
    """What a parameter usually is, and its standard deviation: infinite where nothing is known."""
    if name == "k_per_m" and (unit := setting.drag_per_m(owner)) is not None:
        return SPHERE[0] * unit, SPHERE[1] * unit
    if name == "bulk_m":
        # the displaced air's mass over the ball's and its drag, m, where neither mass nor size is known: of a sphere
        # four thirds of the diameter over the drag coefficient, 0.1 m for table tennis and 1 m for a beach ball
        return 0.5, 0.5
    return 0.0, noise.axis if name in OWN_AXIS else PRIORS.get(name, np.inf)


def _start(slots: Sequence[tuple[str, str]], falls: Sequence[Fall], setting: Setting, near: FallFit | None) -> Floats:
    """Free fall from the first height, half way to terminal speed at its end; or what a fit to nearly the same has."""
    usual = {"g_mps2": setting.g_mps2}
    out = []
    for name, owner in slots:
        value = usual.get(name, 0.0)
        own = next(fall for fall in falls if owner in ("", fall.ball, fall.name))
        late = len(own.time_s) * 2 // 3
        speed = abs(float(np.polyfit(own.time_s[late:], own.height_m[late:], 1)[0]))
        if name == "top_m":
            value = float(own.height_m.max())
        elif name == "release_s":
            value = float(own.time_s[0])
        elif name in ("k_per_m", "c_per_s"):
            value = 0.5 * setting.g_mps2 / speed ** (2 if name == "k_per_m" else 1)
        out.append(near.values.get(name, {}).get(owner, value) if near is not None else value)
    return np.array(out)
