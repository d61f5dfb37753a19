"""Terms beyond the library: the curves, their bases and what is said of them."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from analysis.discovery import discover as module
from analysis.discovery.discover import describe, discover
from analysis.discovery.terms import (
    IN_FLIGHT,
    Curve,
    basis_of,
    event_term,
    hat_functions,
    knots_of,
    penalty_of,
)
from kernels.arrays import Floats


@pytest.mark.parametrize("basis", [hat_functions, basis_of])
def test_a_basis_reproduces_every_straight_line_between_its_knots(basis: Callable[[Floats, Floats], Floats]) -> None:
    """Interpolation of whatever kind: a line's values at the knots give the line, constant beyond them."""
    knots = np.array([0.0, 0.3, 1.0, 2.0])
    x = np.linspace(0.0, 2.0, 41)
    assert basis(x, knots) @ (3.0 - 2.0 * knots) == pytest.approx(3.0 - 2.0 * x)
    assert basis(np.array([-1.0, 9.0]), knots) @ knots == pytest.approx([0.0, 2.0])


def test_a_smooth_curve_is_met_far_better_by_cubics_than_by_straight_pieces() -> None:
    """A hump on twelve knots: the reason for cubic pieces is a factor of ten and more."""
    knots, x = np.linspace(-2.0, 2.0, 12), np.linspace(-1.5, 1.5, 301)
    hump = np.exp(-(knots**2))
    straight, cubic = (np.abs(b(x, knots) @ hump - np.exp(-(x**2))).max() for b in (hat_functions, basis_of))
    assert cubic < 0.1 * straight


def test_an_unknown_covariate_carries_no_term() -> None:
    """Where the covariate is not known the row is zero, not that of some knot."""
    for knots in (np.array([0.0, 1.0]), np.array([0.0, 1.0, 2.0])):
        assert not basis_of(np.array([np.nan]), knots).any()


def test_the_penalty_is_the_bending_energy_of_the_spline() -> None:
    """A line costs nothing; any curve the integral of its squared second derivative, by brute force."""
    knots = np.array([0.0, 0.7, 1.0, 2.2, 3.0, 4.0])
    cost = penalty_of(tuple(knots.tolist())) / (5 / 4.0) ** -3
    assert (1.0 + 2.0 * knots) @ cost @ (1.0 + 2.0 * knots) == pytest.approx(0.0, abs=1e-9)
    values = np.array([0.0, 0.3, -0.2, 0.5, 0.5, 0.1])
    x = np.linspace(0.0, 4.0, 40_001)
    second = np.gradient(np.gradient(basis_of(x, knots) @ values, x), x)[2:-2]
    assert values @ cost @ values == pytest.approx(np.trapezoid(second**2, x[2:-2]), rel=1e-3)


def test_knots_of_a_covariate_with_two_values_are_these_two() -> None:
    """Every other flight gives two levels, not a dozen knots between them."""
    assert knots_of(np.array([0.0, 1.0, 1.0, 0.0, np.nan])) == pytest.approx([0.0, 1.0])


def test_a_curve_is_kept_within_its_bounds() -> None:
    """No negative friction and no restitution of one, whatever a step of the fit asks for."""
    for name in ("friction", "restitution"):
        term = event_term(name, "gamma")
        curve = Curve(term, np.array([0.0, 1.0]), np.zeros(2), np.zeros((1, 2))).moved(np.array([-1.0, 9.0]))
        assert curve.values == pytest.approx([term.low, term.high])


def test_words_follow_the_curve() -> None:
    """A rise is called one between its ends, and a bump is placed at its top."""
    knots = np.linspace(0.0, 2e-3, 5)
    friction = next(t for t in IN_FLIGHT if t.name == "friction" and t.of == "height_m")
    rise = describe(Curve(friction, knots, np.array([0.1, 0.2, 0.3, 0.4, 0.5]), np.zeros((1, 5))))
    assert rise.startswith("dry friction rises from 0.1 g to 0.5 g as height goes from 0 mm to 2 mm")
    bump = describe(Curve(friction, knots, np.array([0.1, 0.1, 0.4, 0.1, 0.1]), np.zeros((1, 5))))
    assert "greatest, 0.4 g, where height is about 1 mm" in bump


def test_no_formula_is_sought_where_every_curve_loses_to_what_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of an explanation none is worth fitting whose own curve foretells held-out steps worse by 12 nats."""
    curves = [SimpleNamespace(held_out=-88.0 + more) for more in (0.1, 4.0)]  # named effects have -100
    monkeypatch.setattr(module, "named_loss", lambda *_: np.full(10, -10.0))
    monkeypatch.setattr(module, "TermSearch", lambda *_, **__: None)
    monkeypatch.setattr(module, "_finalists", lambda *_: curves)
    model = SimpleNamespace(covariates=lambda _: {})
    explanation = SimpleNamespace(candidates=(), fitted=SimpleNamespace(values={}))
    fitter = SimpleNamespace(train=np.ones(10, dtype=np.bool_))
    assert discover(model, fitter, explanation, in_place=True) is None  # type: ignore[arg-type]
