"""Terms beyond the library: the curves, their bases and what is said of them."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.beyond_words import in_words
from analysis.terms import EVENT_GRIDS, IN_FLIGHT, Curve, basis_of, event_term, knots_of, penalty_of


def test_a_basis_reproduces_every_straight_line_between_its_knots() -> None:
    """Hat functions add up to interpolation: a line's values at the knots give the line."""
    knots = np.array([0.0, 0.3, 1.0, 2.0])
    x = np.linspace(0.0, 2.0, 41)
    assert basis_of(x, knots) @ (3.0 - 2.0 * knots) == pytest.approx(3.0 - 2.0 * x)


def test_an_unknown_covariate_carries_no_term() -> None:
    """Where the covariate is not known the row is zero, not that of some knot."""
    assert not basis_of(np.array([np.nan]), np.array([0.0, 1.0])).any()


def test_the_penalty_is_blind_to_straight_lines_and_sees_bends() -> None:
    """Second differences: a line costs nothing, a kink does."""
    cost = penalty_of(6)
    line, kink = np.arange(6.0), np.array([0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    assert line @ cost @ line == pytest.approx(0.0)
    assert kink @ cost @ kink == pytest.approx(1.0)


def test_knots_of_a_covariate_with_two_values_are_these_two() -> None:
    """Every other flight gives two levels, not a dozen knots between them."""
    assert knots_of(np.array([0.0, 1.0, 1.0, 0.0, np.nan])) == pytest.approx([0.0, 1.0])


def test_a_curve_is_kept_within_its_bounds() -> None:
    """No negative friction and no restitution of one, whatever a step of the fit asks for."""
    for name in ("friction", "restitution"):
        term = event_term(name, "gamma")
        curve = Curve(term, np.array([0.0, 1.0]), np.zeros(2), np.zeros((1, 2))).moved(np.array([-1.0, 9.0]))
        assert curve.values == pytest.approx([term.low, term.high])


def test_an_unknown_term_is_refused_with_the_known_ones() -> None:
    """The message lists what may be asked for."""
    with pytest.raises(ValueError, match=", ".join(EVENT_GRIDS)):
        event_term("glue", "gamma")


def test_words_follow_the_curve() -> None:
    """A rise is called one between its ends, and a bump is placed at its top."""
    knots = np.linspace(0.0, 2e-3, 5)
    friction = next(t for t in IN_FLIGHT if t.name == "friction" and t.of == "height_m")
    rise = in_words(Curve(friction, knots, np.array([0.1, 0.2, 0.3, 0.4, 0.5]), np.zeros((1, 5))))
    assert rise.startswith("dry friction rises from 0.1 g to 0.5 g as height goes from 0 mm to 2 mm")
    bump = in_words(Curve(friction, knots, np.array([0.1, 0.1, 0.4, 0.1, 0.1]), np.zeros((1, 5))))
    assert "greatest, 0.4 g, where height is about 1 mm" in bump
