"""Candidate models on impact times of known truth."""

from types import ModuleType

import numpy as np
import pytest

from analysis.drop.times.impact_chain import drops_of
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.outcome import judge, of_times

G = 9.80665


def _drops(synthetic: ModuleType, truth: object, heights: list[float], seed: int, jitter_s: float = 1e-4) -> list[Drop]:
    rng = np.random.default_rng(seed)
    out = []
    for h in heights:
        _, impacts = synthetic.path(synthetic.replace(truth, height_m=h), np.array([8.0]), 2e-4, settle_mps=0.5)
        out.append(Drop(f"{h} m", drops_of(impacts + jitter_s * rng.standard_normal(len(impacts)), "x")[0]))
    return out


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({}, "constant_restitution"),
        ({"e1_s_per_m": 0.03}, "speed_dependent_restitution"),
        ({"drag_per_m": 0.15}, "quadratic_drag"),
    ],
)
def test_the_right_model_is_chosen(synthetic: ModuleType, changes: dict[str, float], name: str) -> None:
    """Six drops name the effect that is there, with its value inside the interval, and none where there is none."""
    truth = synthetic.Truth(e0=0.9, hold_s=0.0, **changes)
    verdict = judge(_drops(synthetic, truth, [0.3, 0.35, 0.4, 0.5, 0.55, 0.6], 3), G, np.random.default_rng(0))
    assert verdict.chosen == name
    fit = verdict.candidate(name).fit
    for parameter, value, half in zip(fit.model.parameters, fit.theta, fit.half_width(), strict=True):
        wanted = {"e0": 0.9, "k_per_m": 0.15, "e1_s_per_m": 0.03}[parameter]
        assert abs(value - wanted) < max(half, 0.002)


def test_friction_is_not_claimed_from_times_alone(synthetic: ModuleType) -> None:
    """With friction the times look like a lower restitution: a tie is reported, not a friction."""
    truth = synthetic.Truth(e0=0.9, friction=0.1, hold_s=0.0)
    verdict = judge(_drops(synthetic, truth, [0.3, 0.4, 0.5, 0.6], 5), G, np.random.default_rng(0))
    assert verdict.tie_set == ("constant_restitution", "coulomb_friction")
    assert verdict.candidate("constant_restitution").fit.theta[0] == pytest.approx(0.9 * np.sqrt(0.9 / 1.1), abs=0.003)


def test_a_known_height_reveals_friction(synthetic: ModuleType) -> None:
    """With the height as data, friction is found and restitution is put right."""
    drops = _drops(synthetic, synthetic.Truth(e0=0.9, friction=0.1, hold_s=0.0), [0.2, 0.3, 0.4, 0.5, 0.6, 0.7], 5)
    heights = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    with_height = [Drop(d.name, d.bounces, (h, 0.001)) for d, h in zip(drops, heights, strict=True)]
    verdict = judge(with_height, G, np.random.default_rng(0))
    assert verdict.chosen == "coulomb_friction"
    e0, mu = verdict.candidate("coulomb_friction").fit.theta
    assert e0 == pytest.approx(0.9, abs=0.01)
    assert mu == pytest.approx(0.1, abs=0.01)


def test_the_drop_height_comes_back(synthetic: ModuleType) -> None:
    """The height from which a ball was dropped lies in the interval, for one drop in a quiet room."""
    drops = _drops(synthetic, synthetic.Truth(e0=0.88, hold_s=0.0), [0.42], 2)
    verdict = judge(drops, G, np.random.default_rng(0))
    height = of_times(drops, verdict, G, [None], np.random.default_rng(1)).payload["drop_height_m"]
    assert height["low"] < 0.42 < height["high"]
    assert height["high"] - height["low"] < 0.1


def test_three_impacts_give_a_ratio_and_no_verdict(synthetic: ModuleType) -> None:
    """One bounce gives a restitution; nothing can be held out, and the words say so."""
    drops = [Drop("short", drops_of(np.array([0.0, 0.4, 0.76]), "x")[0])]
    verdict = judge(drops, G, np.random.default_rng(0))
    result = of_times(drops, verdict, G, [None], np.random.default_rng(0))
    assert result.payload["models"][0]["parameters"]["e0"]["value"] == pytest.approx(0.9)
    assert result.payload["models"][0]["held_out_rms_ms"] is None
    assert any("Too few bounces" in sentence for sentence in result.sentences)


def test_rivals_that_do_as_well_are_named(synthetic: ModuleType) -> None:
    """One drop with drag and scattering bounces: drag is chosen or tied, or nothing beyond a constant is."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = synthetic.Truth(height_m=0.5, e0=0.88, drag_per_m=0.12, hold_s=0.0, scatter=0.004)
        _, impacts = synthetic.path(truth, np.array([9.0]), 2e-4, settle_mps=0.5, rng=rng)
        verdict = judge([Drop("x", drops_of(impacts, "x")[0])], G, rng)
        assert verdict.chosen == "constant_restitution" or "quadratic_drag" in verdict.tie_set


def test_where_nothing_can_be_held_out_nothing_is_told(synthetic: ModuleType) -> None:
    """With four impacts every simple candidate stays in the tie set."""
    drops = [Drop("short", drops_of(np.array([0.0, 0.4, 0.76, 1.08]), "x")[0])]
    verdict = judge(drops, G, np.random.default_rng(0))
    wanted = {"constant_restitution", "speed_dependent_restitution", "quadratic_drag", "coulomb_friction"}
    assert set(verdict.tie_set) == wanted


def test_an_irregular_bounce_is_left_out(synthetic: ModuleType) -> None:
    """A bounce that hits an edge spoils one ratio, which does not bend the fit."""
    flights = 0.6 * 0.88 ** np.arange(10)
    flights[4:] *= 0.8
    drops = [Drop("edge", drops_of(np.concatenate(([0.0], np.cumsum(flights))), "x")[0])]
    verdict = judge(drops, G, np.random.default_rng(0))
    assert verdict.left_out.sum() + drops[0].bounces.broken.sum() == 1
    assert verdict.candidate("constant_restitution").fit.theta[0] == pytest.approx(0.88, abs=1e-3)


def test_a_restitution_that_rises_with_speed_is_not_explained() -> None:
    """Taps of a hand, each interval 20 ms shorter than the last, follow a law that no ball has; it is said."""
    events = np.cumsum(0.4 - 0.02 * np.arange(15))
    verdict = judge([Drop("taps", drops_of(events, "taps")[0])], G, np.random.default_rng(1))
    assert verdict.chosen == "unexplained"
    assert any("gain energy" in words or "would rise" in words for words in verdict.doubts)
