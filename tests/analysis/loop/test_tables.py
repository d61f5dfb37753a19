"""Intervals of what a verdict adds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from analysis.attribution.hypothesis import Hypothesis
from analysis.loop.tables import added_effects, fitted_parameters


def test_interval_of_a_hum_allows_for_what_the_cable_picks_up() -> None:
    """A hum of .852 +- .002 m/s^2, of which ordinary pickup may be .02: the interval says so; a friction's stays."""
    hum, friction = ("mains_hum", "amplitude_mps2"), ("coulomb_friction", "mu_up")
    fitted = SimpleNamespace(values={hum: 0.852, friction: 0.1}, sigma=lambda key: 0.002)
    best = cast(Hypothesis, SimpleNamespace(fitted=fitted, free=(hum, friction)))
    first, second = added_effects(("mains_hum", "coulomb_friction"), fitted_parameters(best))
    assert first.parameters["amplitude_mps2"] == pytest.approx((0.852, 0.852 - 0.0394, 0.852 + 0.0394), abs=1e-4)
    assert second.parameters["mu_up"] == pytest.approx((0.1, 0.1 - 0.00392, 0.1 + 0.00392))
