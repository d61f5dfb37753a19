"""Laws of a flight and of a bounce, and the choice among nested models.

A flight above a floor at rest has gravity, Coulomb friction and quadratic air drag in closed form; no time is stepped.
Going up the ball is slowed by ``g (1 + f)`` plus ``k v^2``; coming down it is driven by ``g (1 - f)`` less ``k v^2``
(Rayleigh drag; Coulomb 1785). All functions are vectorised, work in any consistent units, and go over into the parabola
as ``f`` and ``k`` go to zero. Decision 12.

A bounce says how long the next flight should last, given the one before. Each prediction starts from the measured
flight before it, so an irregular bounce spoils one residual and not the rest. Names are those of the effect library:
`restitution` (constant or falling with the impact speed, ``e = e0 - e1 u``), `quadratic_drag`, `coulomb_friction`.

Models are chosen by held-out log likelihood: the simplest that is not beaten, and those tied with it. Decisions 121 and
313.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from analysis.drop.thresholds import CHANCE_LOSS_NATS, HINT_NATS, LEAST_GAIN_NATS, TIE_NATS
from kernels.arrays import Floats, Integers

Numbers = Any  # a float or an array of them: everything here broadcasts


@dataclass(frozen=True)
class FlightLaw:
    """Gravity with friction and drag; each may be an array (one law for each draw of a fit), then all broadcast."""

    g_mps2: Numbers  # local gravity, m/s^2 (or any length per time squared)
    friction: Numbers = 0.0  # Coulomb friction over the weight, ``0 <= f < 1``: at 1 the ball would hang on its rod
    drag_per_m: Numbers = 0.0  # ``k`` of ``-k |v| v``, 1/m

    @cached_property
    def _k(self) -> Numbers:
        """The drag; where there is none, so little that what is left is a parabola to its last digits."""
        return np.where(np.abs(self.drag_per_m) < 1e-12, 1e-12, self.drag_per_m)

    @cached_property
    def up_mps2(self) -> Numbers:
        """Deceleration on the way up at zero speed."""
        return self.g_mps2 * (1.0 + self.friction)

    @cached_property
    def down_mps2(self) -> Numbers:
        """Acceleration on the way down at zero speed."""
        return self.g_mps2 * (1.0 - self.friction)

    def apex_m(self, speed_mps: Numbers) -> Numbers:
        """Height reached from take-off at ``speed_mps``."""
        v = np.asarray(speed_mps, dtype=np.float64)
        return np.log1p(self._k * v * v / self.up_mps2) / self._k / 2.0

    def landing_speed_mps(self, height_m: Numbers) -> Numbers:
        """Speed after a fall from rest through ``height_m``."""
        h = np.maximum(np.asarray(height_m, dtype=np.float64), 0.0)
        return np.sqrt(self.down_mps2 / self._k * -np.expm1(-2.0 * self._k * h))

    def fall_m(self, speed_mps: Numbers) -> Numbers:
        """Height of a fall from rest that ends at ``speed_mps`` (infinite at the terminal speed and beyond)."""
        v = np.asarray(speed_mps, dtype=np.float64)
        lost = self._k * v * v / self.down_mps2
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(lost < 1.0, -np.log1p(-lost) / (2.0 * self._k), np.inf)

    def rise_s(self, speed_mps: Numbers) -> Numbers:
        """Time from take-off to the apex."""
        v = np.asarray(speed_mps, dtype=np.float64)
        return np.arctan(v * np.sqrt(self._k / self.up_mps2)) / np.sqrt(self._k * self.up_mps2)

    def fall_s(self, height_m: Numbers) -> Numbers:
        """Time of a fall from rest through ``height_m``."""
        h = np.maximum(np.asarray(height_m, dtype=np.float64), 0.0)
        x = np.expm1(self._k * h)  # acosh(1 + x) without the cancellation of acosh near 1
        return np.log1p(x + np.sqrt(x * (x + 2.0))) / np.sqrt(self._k * self.down_mps2)

    def duration_s(self, speed_mps: Numbers) -> Numbers:
        """Flight time from take-off at ``speed_mps`` to the next landing."""
        return self.rise_s(speed_mps) + self.fall_s(self.apex_m(speed_mps))

    def return_speed_mps(self, speed_mps: Numbers) -> Numbers:
        """Speed at the next landing, of a flight that took off at ``speed_mps``."""
        return self.landing_speed_mps(self.apex_m(speed_mps))

    def takeoff_speed_mps(self, duration_s: Numbers) -> Numbers:
        """Take-off speed of a flight of ``duration_s``: Newton on `duration_s`, which grows with the speed."""
        t = np.asarray(duration_s, dtype=np.float64)
        v = t / (1.0 / self.up_mps2 + 1.0 / np.sqrt(self.up_mps2 * self.down_mps2))
        for _ in range(12):
            top = self.apex_m(v)
            u = np.maximum(self.landing_speed_mps(top), 1e-12)
            growth = 1.0 + self._k * v * v / self.up_mps2
            slope = (1.0 + v / u) / (self.up_mps2 * growth)
            moved = np.maximum(v + (t - self.rise_s(v) - self.fall_s(top)) / slope, 0.5 * v)
            settled = np.all(np.abs(moved - v) <= 1e-12 * v)
            v = moved
            if settled:
                break
        return v

    def drop_m(self, since_apex_s: Numbers) -> Numbers:
        """Distance below the apex ``since_apex_s`` after it (negative: before it); the drag may be below zero."""
        t, k = np.asarray(since_apex_s, dtype=np.float64), self._k
        along = np.where(t < 0.0, self.up_mps2, self.down_mps2)
        x = np.sqrt(np.maximum(np.abs(k) * along, 0.0)) * np.abs(t)  # no gravity below zero, as a step of a fit may try
        # log cosh where the ball is slowed, - log cos where it speeds up (to the pole, where no flight gets), both
        # without the cancellation near 0
        slowed = 0.5 * np.log1p(np.sinh(np.minimum(x, 300.0)) ** 2)
        way: Numbers = np.where((t >= 0.0) == (k > 0.0), slowed, -0.5 * np.log1p(-(np.sin(np.minimum(x, 1.5)) ** 2)))
        return way / np.abs(k)

    def velocity_mps(self, since_apex_s: Numbers) -> Numbers:
        """Upward velocity ``since_apex_s`` after the apex."""
        t, k = np.asarray(since_apex_s, dtype=np.float64), self._k
        rise = np.minimum(np.sqrt(k * self.up_mps2) * -np.minimum(t, 0.0), 1.5)
        fall = np.sqrt(k * self.down_mps2) * np.maximum(t, 0.0)
        up = np.sqrt(self.up_mps2 / k) * np.tan(rise)
        return np.where(t < 0.0, up, -np.sqrt(self.down_mps2 / k) * np.tanh(fall))


BOUNDS: dict[str, tuple[float, float]] = {
    "e0": (0.01, 1.5),
    "e1_s_per_m": (-1.0, 1.0),
    "k_per_m": (0.0, 5.0),
    "mu": (0.0, 0.9),
}
START: dict[str, float] = {"e0": 0.7, "e1_s_per_m": 0.0, "k_per_m": 0.02, "mu": 0.05}


@dataclass(frozen=True)
class BounceModel:
    """One candidate model: its name and its parameters, in order."""

    name: str
    parameters: tuple[str, ...]

    def nests(self, other: BounceModel) -> bool:
        """Whether ``other`` is this model with parameters left out."""
        return set(other.parameters) < set(self.parameters)

    @property
    def shape(self) -> str:
        """What bends a flight besides gravity."""
        named = {"mu": "friction", "k_per_m": "drag"}
        return "+".join(named[name] for name in self.parameters if name in named) or "parabola"

    def law(self, theta: Floats, g_mps2: float) -> FlightLaw:
        """Flight law at parameters ``theta`` (p,), or at each of (draws, p)."""
        value = self._named(theta)
        drag = np.maximum(value["k_per_m"], 1e-8) if "k_per_m" in value else 0.0  # a parabola to its last digit
        return FlightLaw(g_mps2, value.get("mu", 0.0), drag)

    def _named(self, theta: Floats) -> dict[str, Floats]:
        return dict(zip(self.parameters, np.moveaxis(np.asarray(theta), -1, 0), strict=True))

    def rebound_mps(self, theta: Floats, impact_mps: Floats) -> Floats:
        """Speed after an impact at ``impact_mps``."""
        value = self._named(theta)
        e = value["e0"] - value.get("e1_s_per_m", 0.0) * np.asarray(impact_mps)
        return np.maximum(e, 0.01) * impact_mps

    def next_flight_s(self, theta: Floats, flight_s: Floats, g_mps2: float) -> Floats:
        """Duration of the flight after one of ``flight_s``."""
        law = self.law(theta, g_mps2)
        impact = law.return_speed_mps(law.takeoff_speed_mps(flight_s))
        return np.asarray(law.duration_s(self.rebound_mps(theta, impact)))

    def first_flight_s(self, theta: Floats, height_m: Floats, g_mps2: float) -> Floats:
        """Duration of the flight after a fall from rest through ``height_m``."""
        law = self.law(theta, g_mps2)
        return np.asarray(law.duration_s(self.rebound_mps(theta, law.landing_speed_mps(height_m))))

    def drop_height_m(self, theta: Floats, flight_s: Floats, g_mps2: float, scatter: Floats) -> Floats:
        """Height of the drop whose first bounce lasted ``flight_s``; NaN where there is none.

        All arguments may be arrays over draws: parameters (draws, p), duration, and how far the restitution of that
        one bounce is from the law.
        """
        law, value = self.law(theta, g_mps2), self._named(theta)
        after = law.takeoff_speed_mps(flight_s)
        e0, e1 = value["e0"] + scatter, value.get("e1_s_per_m", 0.0)
        inside = e0 * e0 - 4.0 * e1 * after  # e0 u - e1 u^2 = after: the branch that goes over into after / e0
        with np.errstate(invalid="ignore", divide="ignore"):
            impact = np.where((e0 > 0.0) & (inside >= 0.0), 2.0 * after / (e0 + np.sqrt(inside)), np.nan)
            height = law.fall_m(impact)
        return np.where(np.isfinite(height), height, np.nan)


CONSTANT = BounceModel("constant_restitution", ("e0",))
SPEED = BounceModel("speed_dependent_restitution", ("e0", "e1_s_per_m"))
DRAG = BounceModel("quadratic_drag", ("e0", "k_per_m"))
FRICTION = BounceModel("coulomb_friction", ("e0", "mu"))
SPEED_DRAG = BounceModel("speed_dependent_restitution+quadratic_drag", ("e0", "e1_s_per_m", "k_per_m"))
SPEED_FRICTION = BounceModel("speed_dependent_restitution+coulomb_friction", ("e0", "e1_s_per_m", "mu"))
FRICTION_DRAG = BounceModel("coulomb_friction+quadratic_drag", ("e0", "mu", "k_per_m"))
MODELS = (CONSTANT, SPEED, DRAG, FRICTION, SPEED_DRAG)  # of impact times
OF_PATHS = (*MODELS, SPEED_FRICTION, FRICTION_DRAG)


UNEXPLAINED = "unexplained"
Estimates = dict[str, tuple[float, float]]  # value and half of the 95 % interval of each parameter
F = TypeVar("F")


@dataclass(frozen=True)
class Candidate(Generic[F]):
    """A model, fitted to impact times, a path or falls, and tried on what it was not fitted to."""

    model: BounceModel
    scores: Floats  # (units,) held-out log likelihood of each drop, flight or bounce
    # Root mean square error of flight durations (s or frames) or heights, in sample and held out; NaN where there are
    # none.
    rms: float
    held_out_rms: float
    identifiable: bool  # the data can tell the parameters
    fit: F
    estimates: Estimates
    significant: bool  # every parameter after ``e0`` is beyond zero, and one that the ball can have
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # of parameters, where there are any
    # Units are of different kinds, of which an effect may change some and leave the others: their gains add up.
    gains_add_up: bool = False


def beyond_zero(estimates: Estimates) -> bool:
    """Whether every interval after that of ``e0`` excludes zero; a drag or friction below zero is none."""
    added = {name: numbers for name, numbers in estimates.items() if name != "e0"}
    return all(v > half or (name in ("e1_s_per_m", "wind_mps") and -v > half) for name, (v, half) in added.items())


C = TypeVar("C", bound=Candidate[Any])


@dataclass(frozen=True)
class Verdict(Generic[C]):
    """The models judged."""

    candidates: tuple[C, ...]
    tie_set: tuple[str, ...]  # models that the data cannot distinguish, the best first
    doubts: tuple[str, ...] = ()  # what no model accounts for, in words
    # (drops,) irregular bounces of impact times that were left out
    left_out: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def best(self) -> str:
        """Name of the model that describes the data best."""
        return self.tie_set[0]

    @property
    def chosen(self) -> str:
        """The best model's name, or "unexplained" where there are doubts."""
        return UNEXPLAINED if self.doubts else self.best

    def candidate(self, name: str) -> C:
        """The model called ``name``."""
        return next(one for one in self.candidates if one.model.name == name)


def worth_of(residuals: Sequence[Floats]) -> float:
    """Independent samples per sample, from the lag-one correlation of what is left within each flight or fall.

    At most a half: a tracker, or a person who marks a ball, errs alike over several frames, seen or not.
    """
    product = sum(float(one[1:] @ one[:-1]) for one in residuals)
    rho = min(max(product / max(sum(float(one @ one) for one in residuals), 1e-300), 0.0), 0.95)
    return min((1.0 - rho) / (1.0 + rho), 0.5)


def gain_of(rival: Candidate[Any], than: Candidate[Any]) -> tuple[float, bool]:
    """Held-out gain of ``rival`` in nats, and whether it is beyond doubt.

    Beyond doubt: above `LEAST_GAIN_NATS`, and either above twice the standard error of the paired gains or shared by
    all units (a long flight weighs more than a short one, so their gains may differ widely and still all agree). Gains
    that add up are beyond doubt where they stay above `LEAST_GAIN_NATS` without the largest of them.
    """
    each = rival.scores - than.scores
    if len(each) < 2:
        return 0.0, False
    gain = float(each.sum())
    if rival.gains_add_up:
        return gain, gain - float(each.max()) > LEAST_GAIN_NATS
    doubt = 2.0 * float(each.std(ddof=1)) * float(np.sqrt(len(each)))
    agreed = bool(each.min() > -CHANCE_LOSS_NATS)
    return gain, gain > LEAST_GAIN_NATS and (gain > doubt or agreed)


def choose(models: Sequence[Candidate[Any]]) -> tuple[str, ...]:
    """Tie set, its first the simplest model that no other beats beyond doubt.

    Only models whose every added parameter excludes zero can be chosen, or beat another. A simpler model stays in the
    tie set unless it is beaten; a richer one joins it where it seems to help.
    """
    able = [m for m in models if m is models[0] or m.significant]
    standing = [m for m in able if not any(gain_of(rival, m)[1] for rival in able if rival is not m)] or [models[0]]
    fewest = min(len(m.model.parameters) for m in standing)
    best = max((m for m in standing if len(m.model.parameters) == fewest), key=lambda m: float(m.scores.sum()))
    tied: list[Candidate[Any]] = []
    for rival in sorted((m for m in models if m is not best), key=lambda m: len(m.model.parameters)):
        behind, beaten = gain_of(best, rival)
        if rival.model.nests(best.model):  # richer; a still richer one with the same effect says nothing new
            tie = behind < -HINT_NATS and not any(rival.model.nests(other.model) for other in tied)
        elif best.model.nests(rival.model):
            tie = not beaten
        else:
            helps = rival is models[0] or gain_of(rival, models[0])[0] > HINT_NATS
            tie = not (beaten and behind > TIE_NATS) and helps
        if tie:
            tied.append(rival)
    return (best.model.name, *(rival.model.name for rival in tied))
