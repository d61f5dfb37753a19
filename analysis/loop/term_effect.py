"""A discovered term as a file of the library of effects: the formula with its parameters, or the curve as a table.

The file has the form of the library's own, to be read and changed by whoever knows the rig.
"""

from __future__ import annotations

import datetime
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import SIZES, FittedForm, quantity_unit
from analysis.loop.result import AddedEffect, ClosedLoop
from analysis.residuals.prediction_errors import Errors
from daq.setup.errors import InputError
from model.effects.registry import NOT_EFFECTS, registry
from model.effects.user_effects import check_name, effect_files

WIDTH = 116  # of a line of the file
HOOKS = {  # hook of each term, and of its quantities those that are an argument of the hook
    "force": ("force", {"height_m": "h", "velocity_mps": "v", "absolute_velocity_mps": "u", "since_takeoff_s": "s"}),
    "friction": ("dry_friction", {"height_m": "h", "speed_mps": "speed"}),
    "threshold": ("takeoff_threshold", {"dwell_s": "dwell_s"}),
    "restitution": ("rebound", {"impact_mps": "v", "previous_impact_mps": "v"}),
}
ARGUMENTS = {
    "force": "s: float, h: float, v: float, u: float, p: Row, k: int",
    "dry_friction": "h: float, speed: float, direction: float, p: Row, k: int",
    "takeoff_threshold": "dwell_s: float, p: Row, k: int",
    "rebound": "v: float, p: Row, k: int",
}
RETURNS = {
    "force": ("Acceleration of the ball, m/s^2, positive up.", "{y}"),
    "dry_friction": ("Friction as an acceleration, m/s^2.", "p[-1] * max({y}, 0.0)"),
    "takeoff_threshold": ("Acceleration to be overcome at take-off, m/s^2.", "max({y}, 0.0)"),
    "rebound": ("Contribution to the coefficient of restitution.", "min(max({y}, 0.0), 0.95)"),
}
AGAINST_MOTION = """    if h <= 0.0 and v == 0.0:  # at rest on the plate it holds the ball down
        return float(-max({y}, 0.0))
    return float(-max({y}, 0.0) * v / np.hypot(v, 0.01))  # turns over 0.01 m/s, so that the integrator can follow
"""
WORDS = {"force": "Force", "friction": "Dry friction", "threshold": "Take-off threshold", "restitution": "Restitution"}
SCALES = {"g": 0.02, "m/s^2": 0.2, "1": 0.02}  # sizes of a term at which it matters, by its unit
MOST = {"force": 200.0, "friction": 3.0, "threshold": 30.0, "restitution": 0.95}  # size of a term that can be
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
    return _Writer(loop, found, name).text()


@dataclass(frozen=True)
class _Writer:
    """Writer of one file."""

    loop: ClosedLoop
    found: Discovery
    name: str

    @property
    def against_motion(self) -> bool:
        """Whether it is a friction that only a force can be: one of the time since the impact."""
        return self.found.term == "friction" and self.found.within_flight and self.found.of == "since_impact_s"

    @property
    def hook(self) -> str:
        return "force" if self.against_motion else HOOKS[self.found.term][0]

    def text(self) -> str:
        """The whole file."""
        f, form = self.found, self.found.form
        parameters = self._formula_parameters(form) if form is not None else [SIZE]
        followed = self._followed()
        if followed:
            parameters.append(self._covariate(followed))
        fitted = ["size"]
        if form is not None:
            fitted = [self._named(*pair) for pair in zip(form.parameters, form.kinds, strict=True)]
        table = "" if form is not None else _array("KNOTS", f.curve.knots) + _array("VALUES", f.curve.values) + "\n"
        y = "size * straight_between(x, KNOTS, VALUES)" if form is None else form.expression
        installed = [(n, c) for n, c in f.similar_effects if n not in {path.stem for path in effect_files()}]
        alike = "".join(f'        "{n}": "similar where this was found (correlation {c:.2f})",\n' for n, c in installed)
        needs_np = "np." in y + table or self.against_motion
        return "".join(
            [
                self._docstring(form),
                "\nfrom __future__ import annotations\n\n",
                "import numpy as np\n\n" if needs_np else "",
                "from kernels import njit\n",
                "from model.effects.base import Effect, Parameter, Row\n",
                "from model.effects.curves import straight_between\n" if form is None else "",
                "\n",
                table,
                "EFFECT = Effect(\n",
                f'    name="{self.name}",\n',
                f"    summary={_quoted(self._summary())},\n",
                "    parameters=(\n",
                *parameters,
                "    ),\n",
                f"    variants=(({', '.join(f'{chr(34)}{n}{chr(34)}' for n in fitted)},),),\n",
                f"    confused_with={{\n{alike}    }},\n" if alike else "",
                f"    reference={_quoted('found by bench close-loop on ' + self._recordings())},\n",
                ")\n\n\n",
                self._hook_text(form, y, followed),
            ]
        )

    # -- words -------------------------------------------------------------------------------------------------------
    def _recordings(self) -> str:
        return ", ".join(source.file for source in self.loop.sources)

    def _summary(self) -> str:
        word = {"force": "a force", "friction": "dry friction", "threshold": "a take-off threshold"}
        return f"{word.get(self.found.term, 'a restitution')} that depends on the {self.found.covariate.words}"

    def _docstring(self, form: FittedForm | None) -> str:
        f, before = self.found, self.loop.errors.before
        unit = quantity_unit(f.of)
        lines = [
            f"{WORDS[f.term]} that depends on the {f.covariate.words}: {'a formula' if form else 'a measured curve'}.",
            "",
        ]
        lines += textwrap.wrap(
            f"Found by bench close-loop on {self._recordings()}, {datetime.date.today().isoformat()}: {f.description}. "
            f"On held-out steps landings were missed by {before.landing_rms_us:.0f} us rms "
            f"({before.landing_nmad_us:.0f} us robust) without it, {f.after.landing_rms_us:.0f} us "
            f"({f.after.landing_nmad_us:.0f} us) with the curve; noise {f.noise_floor_us:.0f} us. "
            "No effect of the library did as well.",
            WIDTH,
        )
        x = f"x is the {f.covariate.words}{f' in {unit}' if unit != '1' else ''}, the value in {f.curve.unit}"
        if form is not None:
            rows = zip(form.parameters, form.values, form.sigmas, strict=True)
            fitted = ", ".join(f"{n} = {v:.4g} +- {s:.2g}" for n, v, s in rows)
            words = f"{form.name.capitalize()}: {form.expression}, where {x}; {fitted}. "
            words += f"Loss on held-out steps over the curve's: {form.loss:.1f} +- {form.error:.1f} nats."
            lines += ["", *textwrap.wrap(words, WIDTH)]
        else:
            lines += ["", *textwrap.wrap(f"Straight between the knots, constant beyond them, where {x}.", WIDTH)]
        if f.tied_covariates:
            lines += ["", *textwrap.wrap(f"Did as well there: {', '.join(f.tied_covariates)}.", WIDTH)]
        return '"""' + "\n".join(lines) + '\n"""\n'

    # -- parameters --------------------------------------------------------------------------------------------------
    def _formula_parameters(self, form: FittedForm) -> list[str]:
        f = self.found
        low, high = float(f.curve.knots[0]), float(f.curve.knots[-1])
        reach, wide = max(abs(low), abs(high)), high - low
        x = f.covariate.words
        meaning = {
            "value": "size", "slope": f"change with {x}", "curvature": f"change with the square of {x}",
            "width": f"{x} over which it changes", "place": f"{x} at which it lies", "power": f"power of {x}",
        }  # fmt: skip
        over = {"value": 1.0, "slope": reach, "curvature": reach**2}
        positive = sum(kind in SIZES for kind in form.kinds) == 1 and f.term != "force"
        out = []
        for own, kind, unit, value in zip(form.parameters, form.kinds, form.units, form.values, strict=True):
            found = float(f"{value:.4g}")
            name = self._named(own, kind)
            if kind in SIZES:
                most = max(MOST[f.term] / over[kind], 3.0 * abs(value))
                scale, ends = SCALES[f.curve.unit] / over[kind], (0.0 if positive else -most, most)
            else:
                ends, scale = {
                    "width": ((0.01 * wide, 10.0 * wide), 0.1 * wide),
                    "place": ((low - wide, high + wide), 0.1 * wide),
                    "power": ((0.1, 6.0), 0.3),
                }[kind]
            shape = "" if kind in SIZES else f" null_value={found!r}, is_shape=True,"
            numbers = ", ".join(_short(x) for x in (*ends, scale))
            out.append(
                f'        Parameter(\n            "{name}", "{unit}", {numbers},{shape}\n'
                f'            start_grid=({found!r},), meaning="{meaning[kind]}",\n        ),\n'
            )
        return out

    def _named(self, own: str, kind: str) -> str:
        """Name of a parameter with its unit's suffix."""
        y, x = {"m/s^2": "mps2"}.get(self.found.curve.unit, ""), SUFFIX[quantity_unit(self.found.of)]
        parts = {"value": [y], "width": [x], "place": [x], "power": []}.get(kind)
        if parts is None:
            power = "2" if kind == "curvature" else ""
            parts = [y, f"per_{x}{power}" if x else ""]
        return "_".join([own, *(part for part in parts if part)])

    def _followed(self) -> str:
        """Covariate that is no argument of the hook: a parameter stands for it."""
        if self.against_motion:
            return "dwell_s"
        return "" if self.found.of in HOOKS[self.found.term][1] else self.found.of

    def _covariate(self, name: str) -> str:
        unit, seen = quantity_unit(name), self.found.seen
        usual = 0.0 if self.against_motion or not len(seen) else float(f"{np.median(seen):.3g}")
        words = "time in contact before" if self.against_motion else self.found.covariate.words
        return (
            f'        Parameter(\n            "{name}", "{unit}", -1e9, 1e9, 1.0, null_value={usual!r},\n'
            f'            is_shape=True, covariate="{name}", meaning="{words} of each flight; else this",\n        ),\n'
        )

    # -- the hook ----------------------------------------------------------------------------------------------------
    def _hook_text(self, form: FittedForm | None, y: str, followed: str) -> str:
        names = ["size"] if form is None else list(form.parameters)
        unit = quantity_unit(self.found.of)
        place = f"p[k + {len(names)}]"
        x = HOOKS[self.found.term][1].get(self.found.of, place)
        if self.against_motion:
            x = f"s + {place}"
        comment = f"{self.found.covariate.words}{f', {unit}' if unit != '1' else ''}"
        lines = [
            '@njit(error_model="numpy")',
            f"def {self.hook}({ARGUMENTS[self.hook]}) -> float:",
            f'    """{RETURNS[self.hook][0]}"""',
            f"    x = {x}  # {comment}",
        ]
        if followed:
            lines += ["    if x != x:  # not known of this flight", "        return 0.0"]
        lines += [f"    {n} = p[k{f' + {i}' if i else ''}]" for i, n in enumerate(names)]
        text = "\n".join(lines) + "\n"
        if self.against_motion:
            return text + AGAINST_MOTION.format(y=y)
        return text + f"    return float({RETURNS[self.hook][1].format(y=y)})\n"


SIZE = (
    '        Parameter("size", "1", 0.0, 20.0, 0.05, start_grid=(1.0,), meaning="times the curve as it was found"),\n'
)


def _short(value: float) -> str:
    return repr(float(f"{value:.3g}"))


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', "'") + '"'


def _array(name: str, values: Sequence[float] | np.ndarray) -> str:
    """A table of numbers as Python."""
    body = textwrap.fill(", ".join(f"{v:.6g}" for v in values), WIDTH, initial_indent="    ", subsequent_indent="    ")
    return f"{name} = np.array([\n{body},\n])  # fmt: skip\n"
