"""What a block of steps is worth: limits of the information, and what calibrations can make up for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.explore.choice import (
    Option,
    Pool,
    divergences,
    limits_of,
    mutual_information,
    sharpened,
    sharpest,
    whitened_difference,
)
from analysis.explore.explanations import Explanation, Weighed, _Fit

A, B, SCALE = ("effect", "a"), ("effect", "b"), ("gauge", "gain")


def known(*free, information=None):
    """Two explanations, the first with no parameter of its own, the second with ``free``; one calibration."""
    explanations = (Explanation((), (), {}, 0.5), Explanation(("effect",), free, {}, 0.5))
    keys = (SCALE, A, B)
    return Weighed(explanations, keys, 1, np.eye(3) if information is None else information, np.zeros(3))


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


def test_a_flight_that_becomes_another_one_separates_nothing():
    """Of three flights and a datum of the plate, the one that moves by 3 ms counts for nothing."""

    class InMicroseconds:
        step = np.zeros(3, dtype=np.int64)

        def white_all(self, bare):
            """In units of a microsecond each."""
            return 1e6 * bare

    raw = np.array([1e-6, 2e-6, 0.0, 0.0])
    assert whitened_difference(InMicroseconds(), raw, raw + np.array([2e-6, 3e-3, -9e-6, 4e-6])) == pytest.approx(
        [2.0, 0.0, -6.0, 4.0]
    )


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
    found = Weighed((explanation,), (SCALE, A), 1, np.diag([1.0, 4.0]), np.zeros(2))
    total = np.zeros((3, 3))
    total[1, 1] = 60.0
    assert sharpened(total, found, [A]) == pytest.approx(np.log(4.0), rel=1e-6)
    assert sharpened(total, found, []) == 0.0


def test_the_time_left_is_spent_on_the_best_option_and_not_beyond_a_calibration():
    """A size is as sharp as its best option makes it in the time left; one that a calibration bounds, hardly at all."""
    size, gain = ("coulomb_friction", "mu_up"), ("accelerometer_gain", "relative")
    none = Explanation((), (), {}, 1.0)

    def pool(information, seconds):
        option = Option(None, (0.5, 0.6), 10, lambda places: seconds * len(places))
        return Pool(option, np.array([np.pad(information, (0, 1))] * 2), np.zeros(2))

    apart_ = np.diag([0.0, 15.0])
    known_apart = Weighed((none,), (gain, size), 1, np.diag([0.0, 10.0]), np.array([4.0, 0.0]))
    pools = [pool(apart_, 1.0), pool(apart_, 5.0)]
    assert sharpest(pools, known_apart, size, 2.0) == pytest.approx(0.5)  # 10 before, 30 more in two seconds
    assert sharpest(pools, known_apart, size, -1.0) == pytest.approx(1.0)
    both = 100.0 * np.ones((2, 2))  # data see gain + size alone
    known_both = Weighed((none,), (gain, size), 1, both, np.array([4.0, 0.0]))
    assert sharpest([pool(both, 1.0)], known_both, size, 200.0) > 0.98


def test_calibrations_go_with_a_size():
    """An explanation one deviation away contradicts what is recorded by half a nat, not by what gauges could absorb."""
    data = 1e4 * np.array([[1.0, 1.0], [1.0, 1.001]])  # a gain, and a size that looks nearly like it
    stiffness = np.array([4.0, 0.0])
    fit = _Fit(data, np.zeros(2), stiffness, np.zeros(2), 1)
    own = np.array([1])
    _, _, deviation = fit.observations(own, np.zeros(1))
    size = float(deviation[0])
    moved = np.array([-float(fit.follow(own)[0, 0]) * size, size])
    prior = np.diag([4.0, 1.0])  # of the gain; of the size, one unit
    assert 0.5 * moved @ (data + prior) @ moved == pytest.approx(0.5, rel=1e-6)
    assert 0.5 * size**2 * data[1, 1] > 100.0


def test_a_fit_that_stopped_short_is_no_evidence():
    """What a fit left of its own gradient does not speak for a candidate that the fitted numbers could replace."""
    rng = np.random.default_rng(4)
    shared = rng.standard_normal((200, 2))
    own = shared @ [1.0, -0.5] + 1e-3 * rng.standard_normal(200)  # nearly what the shared ones can do
    jacobian = np.column_stack([shared, own])
    left = jacobian.T @ (shared @ [0.3, 0.2])  # the gradient of a fit that is off by so much, and of nothing else
    fit = _Fit(1e6 * jacobian.T @ jacobian, 1e6 * left, np.zeros(3), np.zeros(3), 2)
    log, mean, _ = fit.observations(np.array([2]), np.zeros(1))
    assert log < 0.5 and abs(mean[0]) < 0.1


def test_a_calibration_that_data_know_better_is_no_explanation():
    """Freeing a calibration that the recordings themselves tell moves nothing; one that is strained is freed."""
    stated, data = np.array([100.0]), np.array([[1e6]])  # one over variances: known to 0.1, and to 0.001 from the data
    fit = _Fit(data, np.array([100.0 * 0.01]), stated, np.array([0.01]), 1)
    log, mean, deviation = fit.observations(np.array([0]), np.array([0.01]))
    assert log < 0.0 and abs(mean[0]) < 2e-5 and deviation[0] == pytest.approx(1e-3, rel=1e-3)
    strained = _Fit(data, np.array([100.0 * 0.9]), stated, np.array([0.9]), 1)
    assert strained.observations(np.array([0]), np.array([0.9]))[0] > 30.0


def test_a_rival_that_holds_to_a_calibration_is_told_from_one_that_frees_it():
    """Only the explanation that frees a gauge's gain may follow it; its rival holds to what is stated."""
    n = 400
    gain = np.ones(n)
    total = products((gain, np.zeros(n), np.zeros(n)), (np.zeros(n), 0.1 * gain))
    freed, other = Explanation(("gauge",), (SCALE,), {}, 0.5), Explanation(("effect",), (A,), {}, 0.5)
    both = Weighed((freed, other), (SCALE, A, B), 1, np.eye(3), np.array([1e6, 0.0, 0.0]))
    d = divergences(total, both, both.explanations)
    assert d[1, 0] < 0.01 and d[0, 1] == pytest.approx(0.5 * 0.1**2 * n, rel=1e-3)


def test_what_calibrations_forbid_is_said():
    """A size that only its product with a calibration's factor shows becomes no sharper than the calibration."""
    size, gain = ("coulomb_friction", "mu_up"), ("accelerometer_gain", "relative")
    prior = 4.0  # of the gain: one over its variance
    both = np.array([[1.0, 1.0], [1.0, 1.0]])  # data see gain + size alone
    best = Explanation(("coulomb_friction",), (size,), {}, 1.0)
    known = Weighed((best,), (gain, size), 1, 100.0 * both, np.array([prior, 0.0]))
    pools = [Pool(None, np.array([np.pad(50.0 * both, (0, 1))]), np.zeros(1))]
    share, limiting = limits_of(pools, known, size)
    now, least = np.sqrt(1.0 / 100.0 + 1.0 / prior), np.sqrt(1.0 / prior)
    assert share == pytest.approx(least / now, rel=1e-3) and limiting == (gain,)
