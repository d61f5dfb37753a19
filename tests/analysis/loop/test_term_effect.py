"""A discovered term as a file: it runs, has the values found, and is refused where it cannot be one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from analysis.discovery.symbolic import FORMS, Form, forms_for
from analysis.discovery.terms import IN_FLIGHT, event_terms
from analysis.loop.result import ClosedLoop
from analysis.loop.term_effect import check_new, effect_source
from daq.setup.errors import InputError
from model.effects import user_effects
from model.effects.registry import _checked
from tests.loops import found_by

TERMS = [*IN_FLIGHT, *(t for name in ("force", "friction", "threshold", "restitution") for t in event_terms(name))]
X = np.linspace(0.01, 0.5, 9)
ARGUMENTS = {
    "force": ("s", "h", "v", "u"), "dry_friction": ("h", "speed", "dir"), "takeoff_threshold": ("dwell_s",),
    "rebound": ("v",),
}  # fmt: skip


def module_of(text: str, folder: Path) -> ModuleType:
    """The file read as an effect of the user's."""
    (folder / "odd_rod.py").write_text(text, encoding="utf-8")
    return user_effects.load(folder / "odd_rod.py")


@pytest.mark.parametrize("term", TERMS, ids=lambda t: f"{t.name}-{t.of}")
def test_every_term_can_be_kept(term: SimpleNamespace, closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """Curve and formula of every term and quantity: the hook, uncompiled, gives the value at the quantity."""
    for form in (None, FORMS[3]):
        loop = found_by(closed_loop, term.name, term.of, form, term.unit)
        effect, hooks = _checked(module_of(effect_source(loop, "odd_rod"), tmp_path))
        (hook, compiled), size = next(iter(hooks.items())), 1 if form is None else 2
        row = np.array([*((1.0,) if form is None else (0.3, 0.2)), 0.25, 1.0])
        arguments = [0.25] * len(ARGUMENTS[hook])
        against = term.of == "since_impact_s"
        if against:
            row[size] = 0.0
        value = compiled.py_func(*arguments, row, 0)
        y = 0.35 if form is None else 0.3 + 0.2 * 0.25
        expected = -y * 0.25 / np.hypot(0.25, 0.01) if against else y
        assert value == pytest.approx(expected)
        followed = [q for q in effect.parameters if q.covariate]
        assert len(effect.parameters) == size + len(followed)
        assert effect.variants == (tuple(q.name for q in effect.parameters if not q.covariate),)
        if followed and not against:
            row[size] = np.nan
            assert compiled.py_func(*arguments, row, 0) == 0.0


@pytest.mark.parametrize("form", forms_for(TERMS[1], (-0.2, 0.5)), ids=lambda f: f.name)
def test_the_formula_of_a_file_is_the_one_that_was_fitted(form: Form, closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """Every form, compiled from its file: the values that the search computed."""
    loop = found_by(closed_loop, "force", "velocity_mps", form, "m/s^2")
    effect, hooks = _checked(module_of(effect_source(loop, "odd_rod"), tmp_path))
    values = (0.3, 0.2, 0.1)[: len(form.parameters)]
    row = np.array([*values, 9.8])
    x = np.array([-0.15, 0.05, 0.3])
    got = [hooks["force"](0.0, 0.0, float(v), 0.0, row, 0) for v in x]
    assert got == pytest.approx(form.at(x, values).tolist())
    assert all(q.low <= v <= q.high for q, v in zip(effect.parameters, values, strict=True))


def test_what_cannot_be_kept_is_refused(closed_loop: ClosedLoop) -> None:
    """No term, an effect of the library or no name at all: what was wanted, in one line."""
    with pytest.raises(InputError, match="nothing was discovered"):
        effect_source(replace(closed_loop, discovered=None), "odd_rod")
    for name, words in (("adhesion", "choose another"), ("registry", "choose another"), ("Two words", "small letters")):
        with pytest.raises(InputError, match=words):
            check_new(name)
    check_new("odd_rod")
