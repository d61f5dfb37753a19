"""Short formulas that a missing term may follow: each an expression of one quantity and one to three parameters.

The expression is Python, so that the formula that was fitted and the one in a kept effect's file are the same text.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from analysis.discovery.terms import Term
from kernels.arrays import Floats

Kind = Literal["value", "slope", "curvature", "width", "place", "power"]

SIZES = frozenset({"value", "slope", "curvature"})  # kinds in which an expression is linear
UNITS = {"_mps2": "m/s^2", "_mps": "m/s", "_rad": "rad", "_m": "m", "_s": "s"}  # by the ending of a quantity's name


@dataclass(frozen=True)
class Form:
    """A formula.

    Attributes
    ----------
    name
        For a table.
    expression
        Value of the term, of the quantity ``x`` and the parameters, as Python with numpy writes it.
    parameters
        Names with the kind of each, sizes first.
    signed
        True for one that differs from a simpler one only where ``x`` takes both signs.
    """

    name: str
    expression: str
    parameters: tuple[tuple[str, Kind], ...]
    signed: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(name for name, _ in self.parameters)

    @property
    def sizes(self) -> int:
        """Number of parameters in which the expression is linear."""
        return sum(kind in SIZES for _, kind in self.parameters)

    def at(self, x: Floats, values: Sequence[float] | Floats) -> Floats:
        """Value at ``x``; 0 where it is not known."""
        known = np.isfinite(x)
        y = _compiled(self.expression, self.names)(np.where(known, x, 1.0), *values)
        return np.asarray(np.where(known, np.nan_to_num(y), 0.0))

    def units(self, term: Term) -> tuple[str, ...]:
        """Units of the parameters for a term of the model, "1" where there is none."""
        y, x = term.unit, quantity_unit(term.of)
        over, squared = (f"{y}/({x})", f"{y}/({x})^2") if "/" in x else (f"{y}/{x}", f"{y}/{x}^2")
        if x == "1":
            over = squared = y
        named = {"value": y, "slope": over, "curvature": squared, "width": x, "place": x, "power": "1"}
        return tuple(named[kind] for _, kind in self.parameters)


def quantity_unit(name: str) -> str:
    """SI unit of a quantity, from the ending of its name; "1" where it has none."""
    return next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "1")


@functools.cache
def _compiled(expression: str, names: tuple[str, ...]) -> Callable[..., Floats]:
    made: Callable[..., Floats] = eval(f"lambda x, {', '.join(names)}: {expression}", {"np": np})
    return made


FORMS: tuple[Form, ...] = (
    Form("constant", "size", (("size", "value"),)),
    Form("proportional", "slope * x", (("slope", "slope"),)),
    Form("square", "bend * x**2", (("bend", "curvature"),)),
    Form("straight line", "size + slope * x", (("size", "value"), ("slope", "slope"))),
    Form("constant and square", "size + bend * x**2", (("size", "value"), ("bend", "curvature"))),
    Form("parabola", "slope * x + bend * x**2", (("slope", "slope"), ("bend", "curvature"))),
    Form("power", "size * (np.abs(x) / {span}) ** power", (("size", "value"), ("power", "power"))),
    Form("exponential decay", "size * np.exp(-x / width)", (("size", "value"), ("width", "width"))),
    Form("saturation", "size * (1.0 - np.exp(-x / width))", (("size", "value"), ("width", "width"))),
    Form("hyperbola", "size / (1.0 + np.abs(x) / width)", (("size", "value"), ("width", "width"))),
    Form("hyperbolic saturation", "size * x / (np.abs(x) + width)", (("size", "value"), ("width", "width"))),
    Form("threshold", "slope * np.maximum(x - edge, 0.0)", (("slope", "slope"), ("edge", "place"))),
    Form("step", "size * (x > edge)", (("size", "value"), ("edge", "place"))),
    Form("Lorentzian at zero", "size / (1.0 + (x / width) ** 2)", (("size", "value"), ("width", "width"))),
    Form("sine", "size * np.cos(x - centre)", (("size", "value"), ("centre", "place"))),
    Form("sign", "size * np.sign(x)", (("size", "value"),), True),
    Form("odd square", "bend * x * np.abs(x)", (("bend", "curvature"),), True),
    Form(
        "odd power", "size * np.sign(x) * (np.abs(x) / {span}) ** power", (("size", "value"), ("power", "power")), True,
    ),
    Form(
        "smooth step", "size / (1.0 + np.exp(np.minimum((edge - x) / width, 50.0)))",
        (("size", "value"), ("edge", "place"), ("width", "width")),
    ),
    Form(
        "Lorentzian", "size / (1.0 + ((x - centre) / width) ** 2)",
        (("size", "value"), ("centre", "place"), ("width", "width")),
    ),
    Form(
        "Gaussian", "size * np.exp(-(((x - centre) / width) ** 2))",
        (("size", "value"), ("centre", "place"), ("width", "width")),
    ),
)  # fmt: skip
"""All that are tried, short ones first; ``{span}`` is a round number near the largest ``x``."""


def forms_for(term: Term, span: tuple[float, float]) -> tuple[Form, ...]:
    """Forms that mean something for a term whose quantity goes over ``span``."""
    signed = span[0] < 0.0 < span[1]
    largest = f"{max(abs(x) for x in span):.1g}"
    out = []
    for form in FORMS:
        if (form.signed and not signed) or (form.name == "sine" and quantity_unit(term.of) != "rad"):
            continue
        out.append(Form(form.name, form.expression.replace("{span}", largest), form.parameters, form.signed))
    return tuple(out)
