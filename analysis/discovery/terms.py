"""Missing terms as splines of one covariate, and the forward model augmented with them.

A term enters the same one-step-ahead prediction as any named effect: as one value for each flight, or as a force or a
restitution within it. Its curve is a natural cubic spline by its values at knots, constant beyond them; a straight line
has no bending energy.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from analysis.linear_algebra import solve
from analysis.residuals.covariates import COVARIATES
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.values import ParameterId, Values
from daq.setup.values import STANDARD_GRAVITY_MPS2
from kernels.arrays import Bools, Floats
from model.effects.curves import KNOTS
from model.effects.registry import offsets, registry

ENDS = (0.01, 0.99)  # quantiles at which a covariate's first and last knot lie


def knots_of(x: Floats) -> Floats:
    """Knots between evenly spaced ones and quantiles of ``x``; its own values where there are few."""
    known, most = x[np.isfinite(x)], 12
    seen = np.unique(known)
    if len(seen) <= most:
        return np.asarray(seen, dtype=np.float64)
    first, last = np.quantile(known, ENDS)
    even = np.linspace(first, last, most)
    dense = np.quantile(known, np.linspace(ENDS[0], ENDS[1], most))
    return np.asarray(np.unique(0.5 * (even + dense)))


def hat_functions(x: Floats, knots: Floats) -> Floats:
    """Hat functions of the knots at ``x``, (n, k); 0 where ``x`` is not known."""
    if len(knots) == 1:
        return np.isfinite(x).astype(np.float64)[:, None]
    out = np.column_stack([np.interp(np.nan_to_num(x), knots, row) for row in np.eye(len(knots))])
    return out * np.isfinite(x)[:, None]


def basis_of(x: Floats, knots: Floats) -> Floats:
    """Natural cubic splines that are 1 at one knot and 0 at the others, (n, k); 0 where ``x`` is not known."""
    if len(knots) < 3:
        return hat_functions(x, knots)
    inside = np.clip(np.nan_to_num(x), knots[0], knots[-1])
    out = np.asarray(CubicSpline(knots, np.eye(len(knots)), bc_type="natural")(inside))
    return out * np.isfinite(x)[:, None]


@functools.lru_cache(maxsize=256)
def penalty_of(places: tuple[float, ...]) -> Floats:
    """Integral of the squared second derivative by the values at knots, (k, k), mean spacing taken for one.

    Green and Silverman, Nonparametric Regression and Generalized Linear Models (1994), equation 2.4: Q R^-1 Q^T.
    """
    k, knots = len(places), np.array(places)
    if k < 3:
        return np.zeros((k, k))
    h = np.diff(knots) * (k - 1) / (knots[-1] - knots[0])
    q, r = np.zeros((k, k - 2)), np.zeros((k - 2, k - 2))
    for j in range(k - 2):
        q[j : j + 3, j] = 1.0 / h[j], -1.0 / h[j] - 1.0 / h[j + 1], 1.0 / h[j + 1]
        r[j, j] = (h[j] + h[j + 1]) / 3.0
        if j:
            r[j - 1, j] = r[j, j - 1] = h[j] / 6.0
    return np.asarray(q @ solve(r, q.T))


FIRST_KNOTS, MOST_INSIDE = 12, 23  # knots of a term within the flight, at first and at most
FIRST_VALUE = "c0"  # first of the values at the knots, in the effects that carry a curve


@dataclass(frozen=True)
class Term:
    """A term that may be missing."""

    name: str  # ``force``, ``friction``, ``threshold`` or ``restitution``
    of: str  # covariate: a name of `analysis.residuals.covariates.COVARIATES`, or a quantity within the flight.
    unit: str  # as printed for a person
    words: str  # the same
    low: float  # least value
    high: float  # largest value
    nudge: float  # for finite differences
    # parameters that it sets: one value for each flight. Empty for a term within the flight.
    columns: tuple[ParameterId, ...] = ()
    effect: str = ""  # for a term within the flight: the effect that carries it, with its fixed parameters
    fixed: tuple[tuple[str, float], ...] = ()

    @property
    def against_motion(self) -> bool:
        """Whether it is carried by a force against the motion, in m/s^2."""
        return ("against", 1.0) in self.fixed


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

EVENT_GRIDS: dict[str, Floats] = {
    "force": np.sinh(np.linspace(-4.0, 4.0, 19)) / np.sinh(4.0) * 5.0,
    "friction": np.concatenate([[0.0], np.geomspace(0.004, 1.2, 14)]),
    "threshold": np.concatenate([[0.0], np.geomspace(0.05, 15.0, 13)]),
    "restitution": np.concatenate([[0.0], np.geomspace(0.004, 0.15, 18), np.linspace(0.19, 0.92, 14)]),
}


EVENT_VALUES: dict[str, tuple[str, str, float, float, float]] = {  # unit, words, bounds, finite difference
    "force": ("m/s^2", "a downward pull", -8.0, 8.0, 0.02),
    "friction": ("g", "dry friction", 0.0, 2.0, 0.002),
    "threshold": ("m/s^2", "the take-off threshold", 0.0, 30.0, 0.02),
    "restitution": ("1", "restitution", 0.0, 0.95, 0.003),
}
FLIGHT_VALUES: dict[str, tuple[str, float, float]] = {  # words, bounds
    "force": ("a force", -200.0, 200.0),
    "friction": ("dry friction", 0.0, 20.0),
    "restitution": ("restitution", 0.0, 0.95),
}


def event_term(name: str, of: str) -> Term:
    """A term with one value for each flight, and the parameters that take it."""
    effects = [r.effect for r in registry()]
    columns = tuple((e.name, q.name) for e in effects for q in e.parameters if q.carries_term == name)
    return Term(name, of, *EVENT_VALUES[name], columns)


def _within_flight() -> Iterator[Term]:
    """Terms within the flight, from the effects that carry them."""
    for e in (r.effect for r in registry()):
        for curve in e.curves:
            words, low, high = FLIGHT_VALUES[curve.term]
            unit, fixed = e.parameter(FIRST_VALUE).unit, tuple(curve.fixed.items())
            nudge = 0.03 if unit == "m/s^2" else 0.003  # finite difference
            yield Term(curve.term, curve.of, unit, words, low, high, nudge, (), e.name, fixed)


IN_FLIGHT: tuple[Term, ...] = tuple(_within_flight())


@dataclass(frozen=True)
class Curve:
    """A term with its knots (k,), its values there (k,) and a basis (k columns) that makes a table of it.

    The rows of the table are the flights, of a term that has one value for each; else the points of the effect that
    carries it, evenly between the outer knots.
    """

    term: Term
    knots: Floats
    values: Floats
    basis: Floats
    roughness: float = 0.05

    @classmethod
    def even(cls, term: Term, span: tuple[float, float], k: int = FIRST_KNOTS) -> Curve:
        """A term within the flight, nothing as yet, with ``k`` even knots."""
        knots = np.linspace(span[0], span[1], k)
        return cls(term, knots, np.zeros(k), basis_of(np.linspace(span[0], span[1], KNOTS), knots))

    def moved(self, values: Floats) -> Curve:
        """The same with other values, within bounds."""
        return Curve(self.term, self.knots, np.clip(values, self.term.low, self.term.high), self.basis, self.roughness)

    def stepped(self, step: Floats) -> Curve:
        """The same after a step of its values, within bounds."""
        return self.moved(self.values + step)

    @property
    def total_curvature(self) -> float:
        """Total change of slope over the mean slope: 0 for a straight line, 4 for a hump."""
        span = float(np.ptp(self.values))
        if len(self.values) < 3 or span == 0.0:
            return 0.0
        place = np.linspace(self.knots[0], self.knots[-1], len(self.knots))
        turns = np.abs(np.diff(self.at(place), 2)).sum() * (len(place) - 1)
        return float(turns / span)

    def finer(self) -> Curve:
        """The same term within the flight with one knot more between any two, up to `MOST_INSIDE`."""
        k = 2 * len(self.knots) - 1
        if self.term.columns or k > MOST_INSIDE:
            return self
        finer = Curve.even(self.term, (float(self.knots[0]), float(self.knots[-1])), k)
        return finer.moved(self.at(finer.knots))

    def without_covariate(self, n: int) -> Curve:
        """The same term at its median value for all ``n`` flights."""
        # within the flight a friction is carried as a force in m/s^2, for each flight in units of g
        middle = float(np.median(self.values)) / (STANDARD_GRAVITY_MPS2 if self.term.against_motion else 1.0)
        sign = -1.0 if self.term.name == "force" and not self.term.columns else 1.0
        term = event_term(self.term.name, self.term.of)
        return Curve(term, np.zeros(1), np.array([sign * middle]), np.ones((n, 1)))

    def at(self, x: Floats) -> Floats:
        """Value of the term where the covariate is ``x``."""
        return np.asarray(np.clip(basis_of(x, self.knots) @ self.values, self.term.low, self.term.high))

    @property
    def table(self) -> Floats:
        """Value of the term in each row of the basis."""
        return np.asarray(np.clip(self.basis @ self.values, self.term.low, self.term.high))

    def penalty(self) -> tuple[Floats, Floats]:
        """Penalty of bending, weighted for a curve of this spread, as a quadratic form (k, k); and the values.

        With more knots than usual each may bend less.
        """
        values, least = self.values, 10.0 * self.term.nudge
        rough = self.roughness * min(1.0, (FIRST_KNOTS - 1) / max(len(values) - 1, 1))
        size = max(float(np.ptp(values)), 0.3 * float(np.max(np.abs(values), initial=0.0)), least)
        return penalty_of(tuple(self.knots.tolist())) / (rough * size) ** 2, values

    @property
    def points(self) -> Floats:
        """Where the curve is reported: its knots where these are few, else evenly between the outer ones."""
        return self.knots if len(self.knots) < 3 else np.linspace(self.knots[0], self.knots[-1], 45)


def label(term: Term) -> tuple[str, str, float]:
    """Name of the covariate of a term, the unit in which it is printed, and the factor to it from SI."""
    if not term.columns:
        return IN_FLIGHT_WORDS[term.of]
    known = COVARIATES[term.of]
    words = AT_THE_IMPACT.get(term.of, known.words) if term.name == "restitution" else known.words
    return words, known.unit, known.scale


def event_terms(name: str) -> tuple[Term, ...]:
    """Terms of one kind, one for each covariate known when the flight begins; of a rebound, known at the impact."""
    late = ("dwell_s", "takeoff_phase_rad", "plate_speed_at_takeoff_mps", "flights_since_rest")
    names = [k for k, c in COVARIATES.items() if c.ahead and not (name == "restitution" and k in late)]
    return tuple(event_term(name, k) for k in names)


def ranges_of(tables: Mapping[str, Floats], judged: Bools) -> dict[str, tuple[float, float]]:
    """Ranges of the quantities within a flight, by name; NaN for what is known of no flight."""

    def most(name: str) -> float:
        # the largest one in a hundred would stretch the knots over where there is almost nothing
        known = tables[name][judged & np.isfinite(tables[name])]
        return float(np.quantile(known, 0.99)) if len(known) else np.nan

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


class AugmentedModel(ForwardModel):
    """A forward model with further terms; ``without`` is the one without them.

    ``dwell_s`` is the time from impact to take-off of each flight, (n,), for what depends on the time since the impact.
    """

    def __init__(self, model: ForwardModel, curves: Sequence[Curve], dwell_s: Floats) -> None:
        super().__init__(model.observations, model.declared, like=model)
        self.without, self.declared_covariates = model, model.declared_covariates
        self.curves, self.dwell_s = tuple(curves), np.nan_to_num(dwell_s)

    def rows(self, values: Values) -> Floats:
        """Parameters of each event with the terms in, (P + 1,) where they are the same for all, else (n, P + 1)."""
        out = super().rows(values)
        if out.ndim == 1 and any(c.term.columns or c.term.of == "since_impact_s" for c in self.curves):
            out = np.repeat(out[None, :], len(self.observations), axis=0)
        for curve in self.curves:
            _put(out, curve, self.dwell_s)
        return out


def _put(out: Floats, curve: Curve, dwell_s: Floats) -> None:
    """Set the parameters that carry a curve; a friction or restitution takes the place of a constant one."""
    term, place = curve.term, offsets()
    # with its constant left in, only the sum of both would be known
    for e in (r.effect for r in registry() if r.effect.substitutes_term == term.name):
        for q in e.parameters:
            out[..., place[e.name, q.name]] = 0.0
    if term.columns:
        for key in term.columns:
            out[:, place[key]] += curve.table
        return
    for name, number in term.fixed:
        out[..., place[term.effect, name]] = number
    if term.of == "since_impact_s":
        out[:, place[term.effect, "lag_s"]] = dwell_s
    out[..., place[term.effect, "start"]] = curve.knots[0]
    out[..., place[term.effect, "spacing"]] = (curve.knots[-1] - curve.knots[0]) / (KNOTS - 1)
    first = place[term.effect, FIRST_VALUE]
    out[..., first : first + KNOTS] = curve.table
