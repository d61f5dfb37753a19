"""Missing terms as splines: what they act on, what they may depend on, and the world with one of them in it.

The rule kept here: a term is piecewise linear between knots and constant beyond them; it enters the same
one-event-ahead prediction as any named effect, either as a number of each flight or as a force within it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.covariates import COVARIATES
from analysis.likelihood import Key, Values, World
from model.effects import offsets
from model.effects.smooth_force import KNOTS

Array = NDArray[np.float64]

MOST_KNOTS = 12  # of a term with one value for each flight
SOFT, STIFF = 0.1, 0.02  # how far second differences may go, relative to the spread of the curve
FIRST_KNOTS = 12  # of a term within the flight, at first


@dataclass(frozen=True)
class Term:
    """Something that may be missing.

    Attributes
    ----------
    name
        ``force``, ``friction``, ``threshold`` or ``restitution``.
    of
        Covariate it depends on: a name of `analysis.covariates.COVARIATES`, or a quantity within the flight.
    unit, words
        As printed for a person.
    low, high
        Bounds of its value.
    nudge
        For finite differences.
    columns
        Parameters that it sets: one value for each flight. Empty for a term within the flight.
    effect
        For a term within the flight: the effect that carries it, with its fixed parameters.
    """

    name: str
    of: str
    unit: str
    words: str
    low: float
    high: float
    nudge: float
    columns: tuple[Key, ...] = ()
    effect: str = ""
    fixed: tuple[tuple[str, float], ...] = ()

    @property
    def against_motion(self) -> bool:
        """Whether it is carried by a force that follows the motion's sign, in m/s^2."""
        return ("against", 1.0) in self.fixed


FRICTION = (("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down"))
REPLACED: dict[str, tuple[Key, ...]] = {
    "friction": FRICTION,
    "restitution": (("restitution", "e0"), ("restitution", "e1_s_per_m")),
    "threshold": (("adhesion", "a_mps2"), ("adhesion", "dwell_s")),
}
IN_FLIGHT_WORDS = {
    "height_m": ("height", "mm", 1e3),
    "speed_mps": ("velocity", "m/s", 1.0),
    "velocity_mps": ("velocity", "m/s", 1.0),
    "absolute_velocity_mps": ("absolute velocity", "m/s", 1.0),
    "since_takeoff_s": ("time since take-off", "ms", 1e3),
    "since_impact_s": ("time since impact", "ms", 1e3),
    "impact_mps": ("impact speed", "m/s", 1.0),
}
AT_THE_IMPACT = {"previous_flight_s": "flight time", "earlier_flight_s": "previous flight"}

EVENT_GRIDS: dict[str, Array] = {
    "force": np.sinh(np.linspace(-4.0, 4.0, 19)) / np.sinh(4.0) * 5.0,
    "friction": np.concatenate([[0.0], np.geomspace(0.004, 1.2, 14)]),
    "threshold": np.concatenate([[0.0], np.geomspace(0.05, 15.0, 13)]),
    "restitution": np.concatenate([[0.0], np.geomspace(0.004, 0.15, 18), np.linspace(0.19, 0.92, 14)]),
}


def event_term(name: str, of: str) -> Term:
    """A term with one value for each flight."""
    if name == "force":
        return Term(name, of, "m/s^2", "a downward pull", -8.0, 8.0, 0.02, (("local_gravity", "excess_mps2"),))
    if name == "friction":
        return Term(name, of, "g", "dry friction", 0.0, 2.0, 0.002, FRICTION)
    if name == "threshold":
        return Term(name, of, "m/s^2", "the take-off threshold", 0.0, 30.0, 0.02, (("adhesion", "a_mps2"),))
    if name == "restitution":
        return Term(name, of, "1", "restitution", 0.0, 0.95, 0.003, (("restitution", "e0"),))
    raise ValueError(f"no term is called {name!r}; known are {', '.join(EVENT_GRIDS)}")


def _within(name: str, of: str, effect: str, place: float, against: bool = False) -> Term:
    fixed = {"of": place} | ({"against": 1.0} if against else {})
    unit, nudge = ("g", 0.003) if effect == "smooth_friction" else ("m/s^2", 0.03)
    low, words = (0.0, "dry friction") if name == "friction" else (-20.0, "a force")
    return Term(name, of, unit, words, low, 20.0, nudge, (), effect, tuple(fixed.items()))


IN_FLIGHT: tuple[Term, ...] = (
    _within("friction", "height_m", "smooth_friction", 1.0),
    _within("friction", "speed_mps", "smooth_friction", 2.0),
    _within("friction", "since_impact_s", "smooth_force", 5.0, against=True),
    _within("force", "height_m", "smooth_force", 1.0),
    _within("force", "velocity_mps", "smooth_force", 2.0),
    _within("force", "absolute_velocity_mps", "smooth_force", 3.0),
    _within("force", "since_takeoff_s", "smooth_force", 4.0),
    Term("restitution", "impact_mps", "1", "restitution", 0.0, 0.95, 0.003, (), "smooth_restitution"),
)


@dataclass(frozen=True)
class Curve:
    """A term with its knots (k,), values there (k,) and, for each flight, where on the curve it lies (k columns)."""

    term: Term
    knots: Array
    values: Array
    basis: Array
    roughness: float = SOFT

    @classmethod
    def even(cls, term: Term, span: tuple[float, float], n: int) -> Curve:
        """A term within the flight, nothing as yet, with even knots; ``n`` flights."""
        return cls(term, np.linspace(*span, FIRST_KNOTS), np.zeros(FIRST_KNOTS), np.zeros((n, FIRST_KNOTS)))

    def moved(self, values: Array) -> Curve:
        """The same with other values, kept within bounds."""
        return Curve(self.term, self.knots, np.clip(values, self.term.low, self.term.high), self.basis, self.roughness)

    @property
    def bend(self) -> float:
        """How much the curve turns, over its mean slope: 0 for a straight line, 4 for a hump."""
        span = float(np.ptp(self.values))
        if len(self.values) < 3 or span == 0.0:
            return 0.0
        place = np.linspace(self.knots[0], self.knots[-1], len(self.knots))
        turns = np.abs(np.diff(self.at(place), 2)).sum() * (len(place) - 1)
        return float(turns / span)

    def with_roughness(self, roughness: float) -> Curve:
        """The same that may bend more or less: what few flights hold up is, in a stiff one, held up by the rest."""
        return Curve(self.term, self.knots, self.values, self.basis, roughness)

    def finer(self) -> Curve:
        """The same within the flight with a knot more between any two, as many as can be: a bend may be sharp."""
        k = 2 * len(self.knots) - 1
        if self.term.columns or k > KNOTS:
            return self
        knots = np.linspace(self.knots[0], self.knots[-1], k)
        return Curve(self.term, knots, self.at(knots), np.zeros((len(self.basis), k)))

    def flat(self) -> Curve:
        """The same term without its covariate, at its middle."""
        middle = float(np.median(self.values)) / (9.81 if self.term.against_motion else 1.0)
        sign = -1.0 if self.term.name == "force" and not self.term.columns else 1.0
        term = event_term(self.term.name, self.term.of)
        return Curve(term, np.zeros(1), np.array([sign * middle]), np.ones((len(self.basis), 1)))

    def at(self, x: Array) -> Array:
        """Value of the term where the covariate is ``x``."""
        return np.asarray(np.interp(x, self.knots, self.values))


def spoken(term: Term) -> tuple[str, str, float]:
    """Words for what a term depends on, the unit in which a person reads it, and the factor to it from SI."""
    if not term.columns:
        return IN_FLIGHT_WORDS[term.of]
    known = COVARIATES[term.of]
    words = AT_THE_IMPACT.get(term.of, known.words) if term.name == "restitution" else known.words
    return words, known.unit, known.scale


def event_terms(name: str) -> tuple[Term, ...]:
    """The terms of one kind, one for each covariate that is known in time; a rebound knows nothing of the take-off."""
    late = ("dwell_s", "takeoff_phase_rad", "plate_speed_at_takeoff_mps", "flights_since_rest")
    names = [k for k, c in COVARIATES.items() if c.ahead and not (name == "restitution" and k in late)]
    return tuple(event_term(name, k) for k in names)


def ranges_of(tables: Mapping[str, Array], judged: NDArray[np.bool_]) -> dict[str, tuple[float, float]]:
    """Where the quantities within a flight lie, by name."""

    def most(name: str) -> float:
        return float(np.nanquantile(tables[name][judged], 0.99))

    hit, lasts = most("impact_mps"), most("flight_s")
    fastest = max(most("plate_speed_at_takeoff_mps"), 0.5 * hit)
    return {
        "height_m": (0.0, most("height_m")),
        "speed_mps": (0.0, hit),
        "velocity_mps": (-hit, 0.6 * hit),
        "absolute_velocity_mps": (-hit, fastest),
        "since_takeoff_s": (0.0, lasts),
        "since_impact_s": (0.0, lasts + most("dwell_s")),
        "impact_mps": (0.0, hit),
    }


def knots_of(x: Array, most: int = MOST_KNOTS) -> Array:
    """Knots at quantiles of ``x``, fewer where it takes few values."""
    seen = np.unique(x[np.isfinite(x)])
    if len(seen) <= most:
        return np.asarray(seen, dtype=np.float64)
    low, high = np.quantile(x[np.isfinite(x)], (0.01, 0.99))
    even = np.linspace(low, high, most)
    dense = np.quantile(x[np.isfinite(x)], np.linspace(0.01, 0.99, most))
    return np.asarray(np.unique(0.5 * (even + dense)))


def basis_of(x: Array, knots: Array) -> Array:
    """Hat functions at the knots, (n, k); 0 where ``x`` is not known."""
    if len(knots) == 1:
        return np.isfinite(x).astype(np.float64)[:, None]
    eye = np.eye(len(knots))
    out = np.column_stack([np.interp(np.nan_to_num(x), knots, row) for row in eye])
    return out * np.isfinite(x)[:, None]


def penalty_of(k: int) -> Array:
    """Sum of squared second differences, (k, k)."""
    if k < 3:
        return np.zeros((k, k))
    d = np.diff(np.eye(k), 2, axis=0)
    return np.asarray(d.T @ d)


class Spliced(World):
    """A world whose predictions hold a term more.

    Parameters
    ----------
    world
        The world without it.
    curves
        The terms.
    dwell_s
        Time from impact to take-off of each flight, (n,), for what depends on the time since the impact.

    Attributes
    ----------
    without : World
        The world without the terms.
    """

    def __init__(self, world: World, curves: Sequence[Curve], dwell_s: Array) -> None:
        base: dict[str, dict[str, float]] = {}
        for (name, key), value in world.base.items():
            base.setdefault(name, {})[key] = value
        super().__init__(world.evidence, base)
        self.without = world
        self.curves, self.dwell_s = tuple(curves), np.nan_to_num(dwell_s)

    def rows(self, values: Values) -> Array:
        """Parameters of each event with the terms in, (n, P + 1)."""
        plain = super().rows(values)
        out = np.array(np.broadcast_to(plain, (len(self.evidence), plain.shape[-1])))
        for curve in self.curves:
            _put(out, curve, self.dwell_s)
        return out


def _put(out: Array, curve: Curve, dwell_s: Array) -> None:
    """Set the parameters that carry a curve; a friction or restitution takes the place of a constant one."""
    term, place = curve.term, offsets()
    for key in REPLACED.get(term.name, ()):
        out[:, place[key]] = 0.0
    if term.columns:
        for key in term.columns:
            out[:, place[key]] += curve.basis @ curve.values
        return
    for name, number in term.fixed:
        out[:, place[term.effect, name]] = number
    if term.of == "since_impact_s":
        out[:, place[term.effect, "lag_s"]] = dwell_s
    out[:, place[term.effect, "start"]] = curve.knots[0]
    out[:, place[term.effect, "spacing"]] = curve.knots[1] - curve.knots[0]
    for i in range(KNOTS):
        out[:, place[term.effect, f"c{i}"]] = curve.values[min(i, len(curve.values) - 1)]
