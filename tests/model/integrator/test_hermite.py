"""Roots of the quintic of a step, against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from model.integrator.flight import crossing, first_standstill, first_touch, hermite5, standstill
from model.integrator.problem import StepEnds


def _falling(rng: np.random.Generator) -> StepEnds:
    """A step that begins above zero and ends below it."""
    return StepEnds(
        0.002, rng.uniform(1e-9, 1e-3), rng.uniform(-0.5, 0.5), rng.uniform(-30, 30),
        -rng.uniform(1e-9, 1e-3), rng.uniform(-0.5, 0.5), rng.uniform(-30, 30),
    )  # fmt: skip


def test_a_crossing_is_a_root_inside_its_bracket() -> None:
    """Of a thousand falling steps every crossing has the level's height within rounding."""
    rng = np.random.default_rng(1)
    for _ in range(1000):
        ends = _falling(rng)
        z = crossing(0.0, 0.0, 1.0, ends)
        assert 0.0 < z < 1.0
        slope = abs(hermite5(z, ends)[1]) * ends.d
        assert abs(hermite5(z, ends)[0]) < 1e-12 * slope + 1e-15


def test_a_standstill_has_no_velocity() -> None:
    """Where velocities differ in sign the vertex is met as bisection meets it."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        ends = _falling(rng)._replace(v0=rng.uniform(1e-3, 0.5), v1=-rng.uniform(1e-3, 0.5))
        lo, hi = 0.0, 1.0
        if np.count_nonzero(np.diff(np.sign([hermite5(x, ends)[1] for x in np.linspace(0.0, 1.0, 200)]))) > 1:
            continue
        for _ in range(60):
            middle = 0.5 * (lo + hi)
            lo, hi = (middle, hi) if hermite5(middle, ends)[1] > 0.0 else (lo, middle)
        assert abs(standstill(ends, 1.0) - lo) < 1e-11


def test_a_graze_is_met_from_above() -> None:
    """A dip that just passes zero inside a step is found at its first side, one that just misses is none."""
    for depth, touches in ((1e-12, True), (-1e-12, False)):
        h = 0.5 * 20.0 * 0.001**2 - depth
        ends = StepEnds(0.002, h, -0.02, 20.0, h, 0.02, 20.0)
        z = first_touch(ends)
        assert (0.0 < z < 0.5) if touches else z == -1.0


def test_a_motion_that_turns_and_turns_back_within_a_step_stands_still_where_it_turned() -> None:
    """A fall with a short rise inside ends where the rise begins, and one that only slows down does not end."""
    d = 1e-3
    for least, wanted in ((0.01, 0.45), (-0.01, -1.0)):  # the velocity in the middle; falling at both ends

        def velocity(z: float, least: float = least) -> float:
            return least - 4.0 * (z - 0.5) ** 2

        h1 = d * (least - 1.0 / 3.0)
        ends = StepEnds(d, 0.0, velocity(0.0), 4.0 / d, h1, velocity(1.0), -4.0 / d)
        assert first_standstill(ends, -1.0) == pytest.approx(wanted, abs=1e-11)
