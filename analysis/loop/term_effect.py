"""A discovered term as a file of the library of effects: the formula with its parameters, or the curve as a table.

The file, `templates/effect.jinja`, has the form of the library's own, to be read and changed by whoever knows the rig.
"""

from __future__ import annotations

import datetime
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import SIZES, FittedForm, quantity_unit
from analysis.loop.result import AddedEffect, ClosedLoop
from analysis.residuals.prediction_errors import Errors
from daq.setup.errors import InputError
from kernels.arrays import Floats
from model.effects.registry import NOT_EFFECTS, registry
from model.effects.user_effects import check_name, effect_files

WIDTH = 116  # of a line of the file


class Hook(NamedTuple):
    """The hook that a term becomes."""

    words: str  # of the term
    name: str
    arguments: str  # as the file declares them
    of: Mapping[str, str]  # quantities of the term that are one of these arguments
    returns: str  # what it returns, in words
    value: str  # the same as Python, from ``y``, the formula or the curve
    most: float  # size of a term that can be


HOOKS = {
    "force": Hook(
        "a force", "force", "s: float, h: float, v: float, u: float, p: Row, k: int",
        {"height_m": "h", "velocity_mps": "v", "absolute_velocity_mps": "u", "since_takeoff_s": "s"},
        "Acceleration of the ball, m/s^2, positive up.", "{y}", 200.0,
    ),
    "friction": Hook(
        "dry friction", "dry_friction", "h: float, speed: float, direction: float, p: Row, k: int",
        {"height_m": "h", "speed_mps": "speed"}, "Friction as an acceleration, m/s^2.", "p[-1] * max({y}, 0.0)", 3.0,
    ),
    "threshold": Hook(
        "a take-off threshold", "takeoff_threshold", "dwell_s: float, p: Row, k: int", {"dwell_s": "dwell_s"},
        "Acceleration to be overcome at take-off, m/s^2.", "max({y}, 0.0)", 30.0,
    ),
    "restitution": Hook(
        "a restitution", "rebound", "v: float, p: Row, k: int", {"impact_mps": "v", "previous_impact_mps": "v"},
        "Contribution to the coefficient of restitution.", "min(max({y}, 0.0), 0.95)", 0.95,
    ),
}  # fmt: skip
SCALES = {"g": 0.02, "m/s^2": 0.2, "1": 0.02}  # sizes of a term at which it matters, by its unit
SUFFIX = {"m": "m", "s": "s", "m/s": "mps", "m/s^2": "mps2", "rad": "rad", "1": ""}


@dataclass(frozen=True)
class TermEffect:
    """A discovered term as an effect of the user's, and the loop closed again with it."""

    name: str  # of the effect
    file: str  # where it is written
    form: str  # name of its formula; empty where it is the curve
    verdict: str  # with the effect in the library
    words: str  # the same in one line
    effects: tuple[AddedEffect, ...]  # what was added then
    before: Errors  # errors on the held-out steps under the declared model
    after: Errors  # the same under the best hypothesis
    noise_floor_us: float


def check_new(name: str) -> None:
    """Refuse a name that no new effect can have.

    Raises `InputError` where it is no name, or the library has it already.
    """
    try:
        check_name(name)
    except ValueError as error:
        raise InputError(f"--keep-term: {error}") from error
    taken = {r.effect.name for r in registry()} | NOT_EFFECTS
    if name in taken - {path.stem for path in effect_files()}:
        raise InputError(f"--keep-term {name}: the library has an effect of that name; choose another")


def effect_source(loop: ClosedLoop, name: str) -> str:
    """Text of the file of an effect that is the loop's discovered term.

    Raises `InputError` where nothing was discovered, or the term was found in place of an effect that the profile
    declares.

    Parameters
    ----------
    loop
        A closed loop with a discovered term.
    name
        Of the effect.
    """
    found = loop.discovered
    if found is None:
        raise InputError(
            f"--keep-term {name}: nothing was discovered (verdict: {loop.verdict.replace('_', ' ')}), "
            "so there is no term to keep; call without it"
        )
    replaced = [
        r.effect.name
        for r in registry()
        if r.effect.substitutes_term == found.term and r.effect.name in loop.setup.declared
    ]
    if replaced:
        raise InputError(
            f"--keep-term {name}: the term was found in place of declared.{replaced[0]} and would act with it; "
            "take that out of the profile, close the loop with --profile, and keep the term then"
        )
    return _source(loop, found, name)


def _source(loop: ClosedLoop, found: Discovery, name: str) -> str:
    """The template, filled."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # only --keep-term needs it

    form, term = found.form, HOOKS[found.term]
    # only a force can be a friction of the time since the impact, and what is no argument of the hook is a parameter
    against = found.term == "friction" and found.within_flight and found.of == "since_impact_s"
    followed = "dwell_s" if against else "" if found.of in term.of else found.of
    names = ("size",) if form is None else form.parameters
    place, recordings = f"p[k + {len(names)}]", ", ".join(source.file for source in loop.sources)
    seen, unit, user = found.seen, quantity_unit(found.of), {path.stem for path in effect_files()}
    made = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"), undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    made.filters["wrapped"] = lambda text: textwrap.fill(" ".join(text.split()), WIDTH) + "\n"
    return made.get_template("effect.jinja").render(
        name=name, found=found, form=form, term=term, hook=HOOKS["force"] if against else term, against=against,
        before=loop.errors.before, recordings=recordings,
        today=datetime.date.today().isoformat(), names=names, followed=followed,
        parameters=[{"name": "size"}] if form is None else _parameters(found, form),
        fitted=() if form is None else list(zip(form.parameters, form.values, form.sigmas, strict=True)),
        followed_unit=quantity_unit(followed) if followed else "",
        usual=repr(0.0 if against or not len(seen) else float(f"{np.median(seen):.3g}")),
        x=f"s + {place}" if against else term.of.get(found.of, place),
        y="size * straight_between(x, KNOTS, VALUES)" if form is None else form.expression,
        x_words=found.covariate.words, x_unit=unit, x_in=f" in {unit}" if unit != "1" else "",
        alike=[pair for pair in found.similar_effects if pair[0] not in user], numbers=_numbers,
        reference=f"found by bench close-loop on {recordings}".replace("\\", "\\\\").replace('"', "'"),
    )  # fmt: skip


def _parameters(found: Discovery, form: FittedForm) -> list[dict[str, str]]:
    """The parameters of a formula as the file declares them."""
    low, high = float(found.curve.knots[0]), float(found.curve.knots[-1])
    reach, wide = max(abs(low), abs(high)), high - low
    words, of = found.covariate.words, SUFFIX[quantity_unit(found.of)]
    y = {"m/s^2": "mps2"}.get(found.curve.unit, "")
    # of each kind: meaning, suffixes of the name, and of a size what it is over, of others bounds and scale
    kinds: dict[str, tuple[str, tuple[str, ...], float | tuple[float, float, float]]] = {
        "value": ("size", (y,), 1.0),
        "slope": (f"change with {words}", (y, f"per_{of}" if of else ""), reach),
        "curvature": (f"change with the square of {words}", (y, f"per_{of}2" if of else ""), reach**2),
        "width": (f"{words} over which it changes", (of,), (0.01 * wide, 10.0 * wide, 0.1 * wide)),
        "place": (f"{words} at which it lies", (of,), (low - wide, high + wide, 0.1 * wide)),
        "power": (f"power of {words}", (), (0.1, 6.0, 0.3)),
    }
    positive = sum(kind in SIZES for kind in form.kinds) == 1 and found.term != "force"
    out = []
    for own, kind, unit, value in zip(form.parameters, form.kinds, form.units, form.values, strict=True):
        meaning, suffixes, size = kinds[kind]
        start, shape = repr(float(f"{value:.4g}")), ""
        if isinstance(size, float):
            most = max(HOOKS[found.term].most / size, 3.0 * abs(value))
            numbers = (0.0 if positive else -most, most, SCALES[found.curve.unit] / size)
        else:
            numbers, shape = size, f" null_value={start}, is_shape=True,"
        out.append({
            "name": "_".join([own, *(part for part in suffixes if part)]), "unit": unit, "start": start,
            "numbers": ", ".join(repr(float(f"{x:.3g}")) for x in numbers), "shape": shape, "meaning": meaning,
        })  # fmt: skip
    return out


def _numbers(values: Floats) -> str:
    return textwrap.fill(", ".join(f"{v:.6g}" for v in values), WIDTH, initial_indent="    ", subsequent_indent="    ")
