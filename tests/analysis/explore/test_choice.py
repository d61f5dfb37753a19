"""What a block of steps is worth: limits of the information, and what calibrations can make up for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.explore.choice import divergences, mutual_information, sharpened
from analysis.explore.explanations import Explanation, Weighed

A, B, SCALE = ("effect", "a"), ("effect", "b"), ("gauge", "gain")


def known(*free, information=None):
    """Two explanations, the first with no parameter of its own, the second with ``free``; one calibration."""
    explanations = (Explanation((), (), {}, 0.5), Explanation(("effect",), free, {}, 0.5))
    keys = (SCALE, A, B)
    return Weighed(explanations, keys, 1, np.eye(3) if information is None else information)


def products(slopes, differences):
    """Sum over the data of all products of columns: three parameters, then the two explanations."""
    columns = np.column_stack([*slopes, *differences])
    return columns.T @ columns


def test_information_is_bounded_by_what_is_unknown():
    """Explanations that predict the same tell nothing; ones far apart tell as much as is not known."""
    p = np.array([0.7, 0.2, 0.1])
    assert mutual_information(p, np.zeros((3, 3))) == pytest.approx(0.0, abs=1e-12)
    far = 1e3 * (1.0 - np.eye(3))
    assert mutual_information(p, far) == pytest.approx(-np.sum(p * np.log(p)))


@given(st.lists(st.floats(0.01, 1.0), min_size=2, max_size=5), st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_more_apart_is_never_worth_less(weights, one, more):
    """Information grows with every divergence, and is never negative."""
    p = np.array(weights) / np.sum(weights)
    apart = 1.0 - np.eye(len(p))
    low, high = mutual_information(p, one * apart), mutual_information(p, (one + more) * apart)
    assert -1e-12 <= low <= high + 1e-12


def test_a_difference_that_a_calibration_makes_up_for_counts_little():
    """A change that looks like the accelerometer's gain separates nothing; one across it counts as half its square."""
    n = 400
    gain, other = np.ones(n), np.tile([1.0, -1.0], n // 2)
    zeros = np.zeros(n)
    alike = divergences(products((gain, zeros, zeros), (zeros, 0.1 * gain)), known(A), known(A).explanations)
    across = divergences(products((gain, zeros, zeros), (zeros, 0.1 * other)), known(A), known(A).explanations)
    assert alike[1, 0] < 0.01
    assert across[1, 0] == pytest.approx(0.5 * 0.1**2 * n)


def test_a_rival_uses_its_own_parameters():
    """An explanation with the parameter that makes the difference is not told from it; one without is."""
    n = 400
    shape = np.tile([1.0, -1.0], n // 2)
    zeros = np.zeros(n)
    total = products((zeros, shape, zeros), (zeros, 0.1 * shape))
    d = divergences(total, known(A), known(A).explanations)
    assert d[1, 0] == pytest.approx(0.5 * 0.1**2 * n) and d[0, 1] < 0.01


def test_sharpening_is_the_logarithm_of_the_deviations():
    """Sixteen times the information is a quarter of the deviation: ln 4 nats; nothing for what is not asked for."""
    explanation = Explanation(("effect",), (A,), {}, 1.0)
    found = Weighed((explanation,), (SCALE, A), 1, np.diag([1.0, 4.0]))
    total = np.zeros((3, 3))
    total[1, 1] = 60.0
    assert sharpened(total, found, [A]) == pytest.approx(np.log(4.0), rel=1e-6)
    assert sharpened(total, found, []) == 0.0
