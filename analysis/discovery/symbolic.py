"""Short formulas that a missing term may follow, and the search for one that does as well as a discovered curve.

A formula is an expression of one quantity and one to three parameters, in Python, so that the formula that was fitted
and the one in the file of an effect that it becomes are the same text. Each starts where it comes nearest to the curve,
and is then fitted to the events themselves, by the likelihood that the curve was fitted by. It is judged, as the curve
is, on steps that its fit did not see.

References
----------
M. Schmidt and H. Lipson, Science 324, 81 (2009): laws as the shortest formulas that data allow.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.attribution.choice import LogScoreDifference, penalised_best, tied
from analysis.attribution.fit import Fitted, Fitter, of_same_events
from analysis.attribution.hypothesis import Hypothesis
from analysis.discovery.fit import Problem, StackedResiduals, descend
from analysis.discovery.search import RefinedTerm, plate_loss
from analysis.discovery.terms import AugmentedModel, Curve, Term, hat_functions
from analysis.linear_algebra import lstsq, pinv
from analysis.residuals.noise.whitening import Whitener
from analysis.thresholds import ANOTHER_EVENT_S, Thresholds
from kernels.arrays import Floats
from model.effects.curves import KNOTS

Kind = Literal["value", "slope", "curvature", "width", "place", "power"]

KINDS: dict[str, Kind] = {  # what a parameter of a formula may be called, sizes first
    "size": "value", "slope": "slope", "bend": "curvature", "edge": "place", "centre": "place", "width": "width",
    "power": "power",
}  # fmt: skip
SIZES = frozenset({"value", "slope", "curvature"})  # kinds in which an expression is linear
UNITS = {"_mps2": "m/s^2", "_mps": "m/s", "_rad": "rad", "_m": "m", "_s": "s"}  # by the ending of a quantity's name


@dataclass(frozen=True)
class Form:
    """A formula."""

    name: str  # for a table
    expression: str  # value of the term, of the quantity ``x`` and the parameters, as Python with numpy writes it
    signed: bool = False  # True for one that differs from a simpler one only where ``x`` takes both signs

    @functools.cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, sizes first: those of `KINDS` in the expression."""
        return tuple(name for name in KINDS if re.search(rf"\b{name}\b", self.expression))

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """Kind of each parameter."""
        return tuple(KINDS[name] for name in self.parameters)

    @property
    def sizes(self) -> int:
        """Number of parameters in which the expression is linear."""
        return sum(kind in SIZES for kind in self.kinds)

    def at(self, x: Floats, values: Sequence[float] | Floats) -> Floats:
        """Value at ``x``; 0 where it is not known."""
        known = np.isfinite(x)
        y = _compiled(self.expression, self.parameters)(np.where(known, x, 1.0), *values)
        return np.asarray(np.where(known, np.nan_to_num(y), 0.0))

    def units(self, term: Term) -> tuple[str, ...]:
        """Units of the parameters for a term of the model, "1" where there is none."""
        y, x = term.unit, quantity_unit(term.of)
        over, squared = (f"{y}/({x})", f"{y}/({x})^2") if "/" in x else (f"{y}/{x}", f"{y}/{x}^2")
        if x == "1":
            over = squared = y
        named = {"value": y, "slope": over, "curvature": squared, "width": x, "place": x, "power": "1"}
        return tuple(named[kind] for kind in self.kinds)


def quantity_unit(name: str) -> str:
    """SI unit of a quantity, from the ending of its name; "1" where it has none."""
    return next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "1")


@functools.cache
def _compiled(expression: str, names: tuple[str, ...]) -> Callable[..., Floats]:
    made: Callable[..., Floats] = eval(f"lambda x, {', '.join(names)}: {expression}", {"np": np})
    return made


FORMS: tuple[Form, ...] = (
    Form("constant", "size"),
    Form("proportional", "slope * x"),
    Form("square", "bend * x**2"),
    Form("straight line", "size + slope * x"),
    Form("constant and square", "size + bend * x**2"),
    Form("parabola", "slope * x + bend * x**2"),
    Form("power", "size * (np.abs(x) / {span}) ** power"),
    Form("exponential decay", "size * np.exp(-x / width)"),
    Form("saturation", "size * (1.0 - np.exp(-x / width))"),
    Form("hyperbola", "size / (1.0 + np.abs(x) / width)"),
    Form("hyperbolic saturation", "size * x / (np.abs(x) + width)"),
    Form("threshold", "slope * np.maximum(x - edge, 0.0)"),
    Form("step", "size * (x > edge)"),
    Form("Lorentzian at zero", "size / (1.0 + (x / width) ** 2)"),
    Form("sine", "size * np.cos(x - centre)"),
    Form("sign", "size * np.sign(x)", True),
    Form("odd square", "bend * x * np.abs(x)", True),
    Form("odd power", "size * np.sign(x) * (np.abs(x) / {span}) ** power", True),
    Form("smooth step", "size / (1.0 + np.exp(np.minimum((edge - x) / width, 50.0)))"),
    Form("Lorentzian", "size / (1.0 + ((x - centre) / width) ** 2)"),
    Form("Gaussian", "size * np.exp(-(((x - centre) / width) ** 2))"),
)
"""All that are tried, short ones first; ``{span}`` is a round number near the largest ``x``."""


def forms_for(term: Term, span: tuple[float, float]) -> tuple[Form, ...]:
    """Forms that mean something for a term whose quantity goes over ``span``."""
    signed, angle = span[0] < 0.0 < span[1], quantity_unit(term.of) == "rad"
    largest = f"{max(abs(x) for x in span):.1g}"
    able = [form for form in FORMS if (signed or not form.signed) and (angle or form.name != "sine")]
    return tuple(replace(form, expression=form.expression.replace("{span}", largest)) for form in able)


@functools.cache
def _nearest_lines() -> Floats:
    """Values at `KNOTS` places of the broken line nearest to a function, from its values at eight times as many."""
    fine = np.linspace(0.0, 1.0, 8 * (KNOTS - 1) + 1)
    return np.asarray(pinv(hat_functions(fine, np.linspace(0.0, 1.0, KNOTS)), rcond=1e-12))


def curve_of(
    term: Term, span: tuple[float, float], tables: Mapping[str, Floats], at: Callable[[Floats], Floats]
) -> Curve:
    """A term whose values are a function ``at`` of its covariate: of every flight in ``tables``, or over ``span``."""
    if term.columns:
        return Curve(term, np.array(span), np.ones(1), at(tables[term.of])[:, None])
    # a function goes on beyond the knots, which leave out the farthest flights: by a quarter of the range
    beyond = 0.25 * (span[1] - span[0])
    first, last = span[0] - (beyond if span[0] < 0.0 else 0.0), span[1] + beyond
    # of the broken lines the nearest: one through the function's own values would shift a kink between two of them
    lines = _nearest_lines()
    y = lines @ at(np.linspace(first, last, lines.shape[1]))
    return Curve(term, np.array([first, last]), np.ones(1), y[:, None])


NUDGE = 1e-3  # finite difference, of a parameter's unit


@dataclass(frozen=True)
class FittedForm:
    """A formula fitted in place of a discovered curve."""

    name: str  # of `Form`
    expression: str  # the same; ``x`` is the covariate in SI units
    parameters: tuple[str, ...]  # names
    kinds: tuple[str, ...]  # of each parameter
    units: tuple[str, ...]  # of each parameter
    values: tuple[float, ...]  # as fitted, SI
    sigmas: tuple[float, ...]  # their standard deviations
    loss: float  # held-out loss over that of the curve, nats; negative: better
    error: float  # its standard error
    as_good: bool  # whether held-out steps do not tell it from the curve, or prefer it

    def at(self, x: Floats) -> Floats:
        """Value where the covariate is ``x``, SI; a force points up."""
        return Form(self.name, self.expression).at(x, self.values)


@dataclass(frozen=True)
class Forms:
    """Formulas fitted in place of a curve."""

    best: RefinedTerm  # the curve
    tried: tuple[FittedForm, ...]  # those judged on held-out steps, least penalised loss first
    suggested: str  # of those as good as the curve, the name of the one of least penalised loss; empty where none is
    explanation: Hypothesis  # everything fitted with the suggested one, or with the curve
    scatter: float  # as that of the curve
    penalised: float  # held-out loss of the suggested one, with what its parameters cost; infinite where none is


def search_forms(best: RefinedTerm, tables: Mapping[str, Floats], limits: Thresholds) -> Forms:
    """Formulas fitted in place of a curve, the two best of them together with everything else.

    A curve that only nears the law biases the calibrations that were fitted with it. ``tables`` are covariates of every
    flight.
    """

    def penalised(x: _Fit) -> float:  # a parameter costs what it costs among named effects
        return x.loss + limits.tie_nats * len(x.values)

    fits = _FormFits(best, tables)
    near = sorted(((form, *fits.nearest(form)) for form in forms_for(best.curve.term, fits.span)), key=lambda p: p[2])
    # the eight forms nearest to the curve, and all of one parameter
    chosen = [p for i, p in enumerate(near) if i < 8 or len(p[0].parameters) == 1]
    # the six best of them are judged on held-out steps
    fitted = sorted((fits.fit(form, start, fits.others) for form, start, _ in chosen), key=penalised)[:6]
    fitted[:2] = [fits.with_all_else(p) for p in fitted[:2]]
    held = [fits.held_out(p) for p in fitted]
    judged = [fits.explanation(p, r) for p, r in zip(fitted, held, strict=True)]
    spline, train = best.per_step, fits.train
    leads = [LogScoreDifference.of(x.per_step, spline, train) for x in judged]
    good = [tied(spline, x.per_step, train, limits) for x in judged]
    forms = [fits.result(p, lead.gain, lead.error, ok) for p, lead, ok in zip(fitted, leads, good, strict=True)]
    costs = limits.tie_nats * np.array([len(p.values) for p in fitted])
    order = np.argsort([p.gain for p in leads] + costs)
    tried, able = tuple(forms[i] for i in order), [i for i in order if good[i]]
    if not able:
        return Forms(best, tried, "", best.explanation, best.scatter, np.inf)
    losses = [judged[i].per_step for i in able]
    top = min(losses, key=lambda loss: float(loss[train].sum()))
    i = able[penalised_best(top, losses, costs[able].tolist(), train)]
    lost = float(judged[i].per_step[train].sum() + costs[i])
    return Forms(best, tried, forms[i].name, judged[i], fits.stack.scatter(held[i]), lost)


@dataclass(frozen=True)
class _Fit:
    """A form at its fitted values, with residuals, their slopes in the parameters' units, and the training loss."""

    form: Form
    values: Floats
    others: Fitted  # everything else
    r: Floats
    slopes: Floats
    loss: float


class _FormFits:
    """Fits of forms in place of one curve."""

    def __init__(self, best: RefinedTerm, tables: Mapping[str, Floats]) -> None:
        self.curve, self.band, self.augmented, self.named = best.curve, best.band, best.model, best.explanation
        self.tables = tables
        self.train, self.others = best.explanation.fitter.train, best.explanation.fitted
        self.stack = StackedResiduals.of(best.model, self.others.values, self.train)
        self.span = (float(best.curve.knots[0]), float(best.curve.knots[-1]))

    # -- a form near the curve ---------------------------------------------------------------------------------------
    def nearest(self, form: Form) -> tuple[Floats, float]:
        """Values at which a form comes nearest to the curve, and its squared distance over the curve's band."""
        x = self.curve.points
        y = self.curve.at(x)
        # no point of the curve counts as known better than to 2 % of its spread
        weight = 1.0 / np.hypot(self.band, 0.02 * max(float(np.ptp(y)), float(np.max(np.abs(y))), 1e-12))
        best: tuple[Floats, float] = np.zeros(len(form.parameters)), np.inf
        for shape in itertools.product(*(self.kinds[kind][2] for kind in form.kinds if kind not in SIZES)):
            columns = np.column_stack([form.at(x, (*unit, *shape)) for unit in np.eye(form.sizes)])
            size = lstsq(columns * weight[:, None], y * weight, rcond=None)[0]
            far = float(np.mean(((columns @ size - y) * weight) ** 2))
            if far < best[1]:
                best = np.array([*size, *shape]), far
        return best

    @functools.cached_property
    def kinds(self) -> dict[str, tuple[float, tuple[float, float], Floats]]:
        """Of each kind of parameter one unit of its coordinate, its bounds, and the values that are tried."""
        low, high = self.span
        wide, reach = high - low, max(abs(low), abs(high))
        y = max(float(np.max(np.abs(self.curve.values))), 10.0 * self.curve.term.nudge)
        free, none = (-np.inf, np.inf), np.empty(0)
        return {
            "value": (y, free, none),
            "slope": (y / reach, free, none),
            "curvature": (y / reach**2, free, none),
            "width": (wide, (0.01 * wide, 10.0 * wide), wide * np.geomspace(0.03, 3.0, 12)),
            "place": (wide, (low - wide, high + wide), np.linspace(low, high, 24)[:-1]),
            "power": (1.0, (0.1, 6.0), np.array([0.25, 0.5, 0.75, 1.5, 2.0, 3.0])),
        }

    def _units(self, form: Form) -> Floats:
        """Size of each parameter that is one unit of its coordinate."""
        return np.array([self.kinds[kind][0] for kind in form.kinds])

    def _within(self, form: Form, values: Floats) -> Floats:
        """Values within what their kinds allow."""
        low, high = np.array([self.kinds[kind][1] for kind in form.kinds]).T
        return np.clip(values, low, high)

    # -- a form fitted to the events ---------------------------------------------------------------------------------
    def model(self, form: Form, values: Floats) -> AugmentedModel:
        """The forward model with the form in place of the curve."""
        curve = curve_of(self.curve.term, self.span, self.tables, lambda x: form.at(x, values))
        return AugmentedModel(self.augmented.without, [curve], self.augmented.dwell_s)

    def fit(self, form: Form, start: Floats, others: Fitted) -> _Fit:
        """Gauss-Newton on the robust loss of the training steps, everything else as it is in ``others``."""
        unit = self._units(form)

        def residuals(values: Floats) -> Floats:
            return self.stack.residuals(self.model(form, values), others.values)

        def slopes(values: Floats, r: Floats) -> Floats:  # by the parameters in their units, (k, parameters)
            out = np.empty((len(r), len(values)))
            for i, step in enumerate(NUDGE * np.diag(unit)):
                change = residuals(values + step) - r
                change[np.abs(change) > ANOTHER_EVENT_S] = 0.0
                out[:, i] = change / NUDGE
            return out

        problem = Problem[Floats](
            residuals, slopes, lambda values, step: self._within(form, values + step * unit)
        )  # fmt: skip
        # robust widths narrow from pass to pass, so that the first passes are not ruled by outliers
        values, r = descend(problem, self._within(form, start), self.stack, (0.8, 0.65, 0.5, 0.5, 0.5))
        return _Fit(form, values, others, r, slopes(values, r), self.stack.loss(r))

    def with_all_else(self, p: _Fit) -> _Fit:
        """The form and everything else fitted in turn."""
        for _ in range(2):
            model, others = self.model(p.form, p.values), p.others
            fitter = Fitter(model, self.named.fitter.priors, self.train)
            others = fitter.fit(Whitener.of(model, others.values), self.named.free, others.values, others.slopes)
            p = self.fit(p.form, p.values, others)
        return p

    def held_out(self, p: _Fit) -> Floats:
        """Stacked residuals, each step's with the values that the others give."""
        unit = self._units(p.form)

        def after(step: Floats) -> Floats:
            other = self.model(p.form, self._within(p.form, p.values + step * unit))
            return self.stack.residuals(other, p.others.values)

        return self.stack.held_out(p.r, p.slopes, after)[0]

    def explanation(self, p: _Fit, held: Floats) -> Hypothesis:
        """The named effects with the form; ``held`` are its held-out residuals."""
        model = self.model(p.form, p.values)
        losses = {"events": self.stack.by_step(held), "plate": plate_loss(model, p.others.values)}
        fitted = replace(p.others, fitter=Fitter(model, self.named.fitter.priors, self.train))
        return Hypothesis(self.named.candidates, fitted, self.named.whitener, losses)

    def result(self, p: _Fit, loss: float, error: float, as_good: bool) -> FittedForm:
        """A fitted form as names and numbers."""
        unit, whitener = self._units(p.form), p.others.state.whitener

        def bare(values: Floats) -> Floats:
            return whitener.stacked(self.model(p.form, values).residuals(p.others.values))

        here, steps = bare(p.values), NUDGE * np.diag(unit)
        slopes = [of_same_events(bare(p.values + step) - here, whitener) / NUDGE for step in steps]
        sigmas = np.sqrt(np.maximum(np.diag(p.others.covariance_of(np.column_stack(slopes))), 0.0)) * unit
        up = -1.0 if self.curve.term.name == "force" and self.curve.term.columns else 1.0  # fitted as a pull
        sign = np.array([up if kind in SIZES else 1.0 for kind in p.form.kinds])
        form = p.form
        return FittedForm(
            form.name, form.expression, form.parameters, form.kinds,
            form.units(self.curve.term), tuple((sign * p.values).tolist()), tuple(sigmas.tolist()), loss, error,
            as_good,
        )  # fmt: skip
