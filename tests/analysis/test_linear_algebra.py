"""Linear algebra that refuses what is not finite, in the project's own words."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import analysis
from analysis import linear_algebra
from analysis.linear_algebra import NotFiniteError

ROUTINES = ("cholesky", "eigh", "inv", "lstsq", "pinv", "slogdet", "solve", "svd")
BESIDE = ("drop", "events")  # rooms that a fit of the loop does not reach


@pytest.mark.parametrize("routine", ROUTINES)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_never_reaches_lapack(routine: str, bad: float, capfd: pytest.CaptureFixture[str]) -> None:
    """Each routine ends in one error, and nothing is printed."""
    matrix = np.eye(3)
    matrix[1, 2] = bad
    more = (np.ones(3),) if routine in ("lstsq", "solve") else ()
    call: Callable[..., Any] = getattr(linear_algebra, routine)
    with pytest.raises(NotFiniteError, match="not finite"):
        call(matrix, *more)
    assert capfd.readouterr() == ("", "")


def test_equations_without_a_solution_are_the_same_error() -> None:
    """A singular matrix is told in the project's own words."""
    with pytest.raises(NotFiniteError, match="no solution"):
        linear_algebra.solve(np.zeros((2, 2)), np.ones(2))


def test_the_loop_solves_no_equations_elsewhere() -> None:
    """No room that a verdict passes through calls these routines of NumPy by itself."""
    direct = re.compile(rf"np\.linalg\.({'|'.join(ROUTINES)})\(")
    root = Path(analysis.__file__).parent
    found = [p for p in root.rglob("*.py") if direct.search(p.read_text(encoding="utf-8"))]
    assert {p.relative_to(root).parts[0] for p in found} <= set(BESIDE)


def test_what_is_known_far_worse_than_another_unknown_is_not_known_for_certain() -> None:
    """The inverse of normal equations whose diagonal spans twenty powers of ten is the one by hand, in each entry."""
    units = np.array([1e-10, 1.0])
    normal = np.array([[2.0, 1.0], [1.0, 2.0]]) / np.outer(units, units)
    by_hand = np.array([[2.0, -1.0], [-1.0, 2.0]]) / 3.0 * np.outer(units, units)
    np.testing.assert_allclose(linear_algebra.scaled_inverse(normal), by_hand, rtol=1e-9)
    assert linear_algebra.scaled_inverse(np.diag([4.0, 0.0]))[0, 0] == 0.25
