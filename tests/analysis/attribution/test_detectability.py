"""Detection limits: what lies well beyond is named, what lies well below is not, and one step's word is not enough."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import g as G_MPS2

from analysis.attribution.candidates import priors_of, scale_of
from analysis.attribution.detectability import Detectability
from analysis.attribution.fit import Fitter
from analysis.loop.close_loop import close_loop
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import ParameterId
from analysis.thresholds import FROZEN
from benchmarks.analysis.joint import short_runs

RATE, PULL = ("viscous_damping", "rate_per_s"), ("adhesion", "a_mps2")


def detectability(model: ForwardModel) -> Detectability:
    """Beside the fit of calibrations alone, all steps seen."""
    fitter = Fitter(model, priors_of(model.observations.setup), np.ones(len(model.observations.steps), dtype=bool))
    return Detectability(fitter.fit(Whitener.of(model, {}), (), {}), FROZEN)


@pytest.mark.parametrize(("part", "seen"), [(0.4, False), (2.5, True)])
def test_what_lies_beyond_the_limit_gains_the_threshold(
    fly_ramp: Callable[..., ForwardModel], part: float, seen: bool
) -> None:
    """A damping of 2.5 times the limit is worth the 12 nats that a name needs, one of 0.4 times it is not."""
    limit = detectability(fly_ramp({}, 5)).limit(RATE)
    assert 0.0 < limit < 1.0
    model = fly_ramp({RATE: part * limit}, 6)
    fitter = detectability(model).best.fitter
    whitener = Whitener.of(model, {RATE: part * limit})
    gain = fitter.fit(whitener, (), {}).loss - fitter.fit(whitener, (RATE,), {}).loss
    assert (gain > 12.0) == seen


@pytest.mark.parametrize("key", [RATE, ("local_gravity", "excess_mps2"), ("drive_gain", "relative")])
def test_a_size_is_named_beyond_its_limit_and_not_below(
    fly_ramp: Callable[..., ForwardModel], key: ParameterId
) -> None:
    """Calibrations hide a pull or a gain up to their bounds, so that no straight line leads to its limit."""
    of = detectability(fly_ramp({}, 5))
    limit = of.limit(key) / scale_of(key)
    for part, seen in ((0.8, False), (1.25, True)):
        slope, multiple = np.zeros(len(of.best.raw)), math.nan
        for _ in range(4):  # until calibrations have followed
            slope, multiple = of.turn(key, part * limit, slope)
        assert (multiple < 1.0) == seen


def test_few_data_of_unknown_scatter_tell_less(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A change of all residuals gains as its square while it is small, and only as a logarithm where it is large."""
    of = detectability(fly_ramp({}, 5))
    change = np.ones(len(of.best.raw))
    small, part = of._gain(0.1 * change)
    large, less = of._gain(10.0 * change)
    assert 0.5 < part.min() <= part.max() <= 1.0
    assert large < 0.1 * 1e4 * small and less.max() < 0.1


@pytest.fixture(scope="module")
def limit_mps2(tmp_path_factory: pytest.TempPathFactory) -> float:
    """The adhesion that a clean run of another plant states as its detection limit."""
    clean = close_loop(short_runs(tmp_path_factory.mktemp("clean"), 1, 560, {}))
    return clean.detection.sizes["adhesion.a_mps2"]


@pytest.mark.slow
@pytest.mark.parametrize(("part", "seen"), [(0.4, False), (1.7, True)])
def test_runs_of_another_plant_confirm_the_limit_of_adhesion(
    tmp_path: Path, limit_mps2: float, part: float, seen: bool
) -> None:
    """Of three runs well beyond the limit most name the adhesion, of three well below none does."""
    paths = short_runs(tmp_path, 3, 561, {"adhesion.pull_g": part * limit_mps2 / G_MPS2})
    named = [any("adhesion" in names for names in close_loop([path]).selection.ties) for path in paths]
    assert sum(named) >= 2 if seen else not any(named)
