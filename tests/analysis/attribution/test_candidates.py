"""Candidates: what the effects' own files say of them, and where their fits begin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.attribution.candidates import candidates_of, distinct_starts, scale_of, trends_of
from analysis.attribution.choice import contained_in
from analysis.attribution.coarse_search import axes_of
from analysis.attribution.fit import HELD, Fitter
from analysis.plate.ringing.modes import Identified
from analysis.plate.ringing.regression import PlateMode
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.plate_data.plate_observables import SECOND
from analysis.residuals.values import TREND, ParameterId

RATIO, HZ, DAMPING = keys = tuple(("table_resonance", q) for q in ("mass_ratio", "frequency_hz", "damping"))
BEND = ("harmonic_distortion", "quadratic_per_g")


def start(loss: float, hz: float, ratio: float = 0.02) -> tuple[float, dict[ParameterId, float]]:
    """A start at a pitch."""
    return loss, {RATIO: ratio, HZ: hz, DAMPING: 0.05}


def test_another_pitch_begins_a_fit_of_its_own() -> None:
    """Of starts in order, the best and the best at an unlike pitch; another size alone makes no other start."""
    starts = [start(1.0, 3.4), start(2.0, 3.4, ratio=0.01), start(3.0, 4.3), start(4.0, 4.9), start(5.0, 8.0)]
    assert distinct_starts(starts, keys) == [starts[0], starts[3]]
    assert distinct_starts(starts[:3], keys) == starts[:1]


def test_squares_are_also_begun_where_they_have_a_slope() -> None:
    """A bent amplifier's harmonics are squares: beside the absent effect, the best start with it present is tried."""
    bends = tuple(("harmonic_distortion", q) for q in ("quadratic_per_g", "cubic_per_g2"))
    points = ((0.0, 0.0), (3e-3, 5e-4), (1.0, 1.0))
    starts = [(float(i), dict(zip(bends, point, strict=True))) for i, point in enumerate(points)]
    assert distinct_starts(starts, bends, with_size=True) == starts[:2]
    assert distinct_starts(starts[1:], bends, with_size=True) == starts[1:2]
    assert distinct_starts(starts, bends) == starts[:1]


UP, DOWN = ("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down")


def test_tied_parameters_begin_equal_and_drift_together(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Both directions of friction start from one number, are searched as one, and have a trend in common."""
    model = fly_ramp({}, 0, gammas=(0.4, 0.8))
    friction = next(c for c in candidates_of(model) if c.names == ("coulomb_friction",))
    assert friction.starts and all(start[UP] == start[DOWN] for start in friction.starts)
    (points,) = axes_of(({},), (UP, DOWN), ())
    assert any(p for p in points) and all(p[UP] == p[DOWN] for p in points if p)
    together = [c.free for c in trends_of((UP, DOWN)) if len(c.free) == 2]
    assert together == [((UP[0], UP[1] + TREND), (DOWN[0], DOWN[1] + TREND))]


def test_a_spring_and_a_magnet_may_act_together(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Each alone is a form of the position force, and the fullest form holds both: no other pull stands in for one."""
    forms = [set(c.free) for c in candidates_of(fly_ramp({}, 0, gammas=(0.4, 0.8))) if c.names == ("position_force",)]
    assert len(forms) == 3 and forms[2] == forms[0] | forms[1]


def test_an_identified_mode_is_where_a_resonance_begins_and_a_datum_of_its_fit(
    fly_ramp: Callable[..., ForwardModel], fitter_of: Callable[[ForwardModel], Fitter]
) -> None:
    """A mode of 6.66 Hz, known to 0.05 Hz, is the only start, and stays known when its frequency is free.

    One of small gain is a start among others.
    """
    model = fly_ramp({}, 0, gammas=(0.4, 0.8))
    mode = PlateMode(6.66, 0.04, 0.03, np.diag(np.square([0.05, 0.004, 0.001])), 0.1, 0.3, 1e4)
    seen = ForwardModel(replace(model.observations, ringing=Identified(mode)), {})
    resonance = next(c for c in candidates_of(seen) if c.names == ("table_resonance",))
    assert [start[HZ] for start in resonance.starts] == [6.66]
    unsure = ForwardModel(replace(model.observations, ringing=Identified(replace(mode, gain_nats=20.0))), {})
    resonance = next(c for c in candidates_of(unsure) if c.names == ("table_resonance",))
    assert {3.0, 6.66} < {start[HZ] for start in resonance.starts}
    mean, inverse = fitter_of(seen).prior_rows([HZ], frozenset({HZ}))
    scale = scale_of(HZ)
    assert (mean[0] * scale, scale / inverse[0]) == pytest.approx((6.66, HELD * 0.05))


def test_a_plate_that_is_quiet_offers_no_resonance(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Where volts leave room for no mode, none is flown; all other candidates stay."""
    observations = fly_ramp({}, 0, gammas=(0.4, 0.8)).observations
    quiet = ForwardModel(replace(observations, ringing=Identified(quiet=True)), {})
    offered, left = ({c.names for c in candidates_of(m)} for m in (ForwardModel(observations, {}), quiet))
    assert offered - left == {("table_resonance",)}


def test_every_candidate_has_a_place_to_start_from(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Where steps are too short to show a modulation, none is offered."""
    model = fly_ramp({}, 0, gammas=(0.4, 0.8))
    assert model.observations.modulation is None
    assert all(c.starts for c in candidates_of(model))


def test_trends_of_calibrations_are_candidates_from_the_first_round(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A drive and an accelerometer that drift are offered, each with its own calibration."""
    found = [c.names for c in candidates_of(fly_ramp({}, 0, gammas=(0.4, 0.8)))]
    assert ("drive_gain", "parameter_drift") in found and ("accelerometer_gain", "parameter_drift") in found


def test_plain_friction_is_contained_in_friction_that_weakens() -> None:
    """A fuller form holds its special cases and itself, not the other way round."""
    assert contained_in(("stribeck_friction",)) == {"stribeck_friction", "coulomb_friction"}
    assert contained_in(("coulomb_friction",)) == {"coulomb_friction"}


def test_what_an_earlier_selection_has_seen_starts_there_only(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Neither the null value nor the grid: calibrations may have taken its place since."""
    model, corner = fly_ramp({}, 0, gammas=(0.4, 0.8)), ("accelerometer_high_pass", "corner_hz")
    starts = {c.free: c.starts for c in candidates_of(model, {corner: 2.9})}
    unseen = {c.free: c.starts for c in candidates_of(model) if c.free != (corner,)}
    assert starts.pop((corner,)) == ({corner: 2.9},)
    assert starts == unseen


@pytest.mark.parametrize("ratio", [1, 3])
@pytest.mark.parametrize("bend_per_g", [0.02, -0.02])
def test_a_bend_begins_with_the_sign_that_its_second_harmonic_has(
    fly_ramp: Callable[..., ForwardModel], ratio: int, bend_per_g: float
) -> None:
    """Squares of harmonics do not tell a bend's sign: the phase of the second one does, with any second tone."""
    observations = fly_ramp({}, 0, gammas=(0.4, 0.8)).observations
    steps, data = observations.steps, observations.plate
    x = 2.0 * np.pi * np.arange(64) / 64
    wave_g = np.cos(x + 0.7) + (np.cos(ratio * x - 1.1) if ratio > 1 else 0.0)  # any phases
    tones = 2.0 * np.fft.rfft(wave_g + bend_per_g * wave_g**2)[1:9] / 64
    omega_radps = 2.0 * np.pi * 25.0 * np.arange(1.0, 9.0)
    plate = replace(steps.plate, omega_radps=omega_radps[None, :], acceleration_mps2=9.81 * tones[None, :])
    share = 1j * np.exp(-1.1j) / (1j * np.exp(0.7j)) ** ratio
    second = replace(
        data.among(np.arange(1)), kind=np.array([SECOND]), step=np.zeros(1, np.int64), multiple=np.array([2]),
        omega_radps=omega_radps[1:2], accel_g=np.ones(1), scale=np.array([9.81]),
        others=np.array([[ratio]]), shares=np.array([[share]]),
    )  # fmt: skip
    bent = replace(observations, steps=replace(steps, plate=plate), plate=second)
    model = ForwardModel(bent, {})
    starts = [c.starts for c in candidates_of(model) if BEND in c.free]
    assert starts and all(start[BEND] * bend_per_g > 0.0 for start in starts[0])
