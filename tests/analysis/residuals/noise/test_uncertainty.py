"""Errors that edges share where they are rounded to samples alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.events.edge_jitter import MIN_STEPS, Scatter
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit
from analysis.residuals.noise import changes
from analysis.residuals.noise.uncertainty import forgotten, rounding_errors, uncertainty_at
from analysis.residuals.observations import ContactCircuit, Observations
from analysis.thresholds import FROZEN

SAMPLING_S = 5e-5
IN_A_ROW = 5  # flights without a rest between them
ROUNDING_S = SAMPLING_S / np.sqrt(12.0)


RATE, LAG = ("viscous_damping", "rate_per_s"), ("accelerometer_lag", "delay_s")


def test_an_event_that_hardly_moves_keeps_what_it_changes_by(
    fly_ramp: Callable[..., ForwardModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From values near by, uncertainties are those found anew within a hundredth, and most events are not flown."""
    model = fly_ramp({RATE: 0.5}, 1)
    near, flown = uncertainty_at(model, {RATE: 0.5}), []
    here = {RATE: 0.501, LAG: 1e-6}
    anew = uncertainty_at(model, here)
    made = changes.Moves.together
    monkeypatch.setattr(changes.Moves, "together", lambda x, *args: flown.append(x.again.sum()) or made(x, *args))
    kept = uncertainty_at(model, here, near.changes)
    assert sum(flown) < 0.5 * model.observations.scored.sum()
    for name in ("opening_total_s", "landing_total_s"):
        assert getattr(kept, name) == pytest.approx(getattr(anew, name), rel=0.01)
    far = {RATE: 3.0}
    assert uncertainty_at(model, far, near.changes).landing_total_s == pytest.approx(
        uncertainty_at(model, far).landing_total_s, rel=0.01
    )


def test_an_event_is_moved_one_way_only_where_it_is_straight(
    fly_ramp: Callable[..., ForwardModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Flights of ten tones: what each tone changes them by is as from moves either way, to a hundredth of all."""
    model = fly_ramp({RATE: 0.5}, 2)
    steps = model.observations.steps
    every = np.zeros((len(steps), 10, 5), dtype=np.complex128)  # errors of five tones, in both quadratures
    every[:, np.arange(10), np.arange(10) // 2] = 1e-3 * np.tile([1.0, 1j], 5)
    omega = steps.plate.omega_radps[:, :1] * np.arange(1.0, 6.0)
    tones = np.zeros((len(steps), 5), dtype=np.complex128)
    tones[:, : steps.plate.acceleration_mps2.shape[1]] = steps.plate.acceleration_mps2[:, :5]
    plate = replace(steps.plate, omega_radps=omega, acceleration_mps2=tones)
    wide = replace(steps, plate=plate, spread_mps2=every, forcing=np.arange(5) < np.ones((len(steps), 1)))
    observations = replace(model.observations, steps=wide)
    one_way = uncertainty_at(ForwardModel(observations, {}, like=model), {RATE: 0.5})
    told = changes.Moves._bends
    monkeypatch.setattr(changes.Moves, "_bends", lambda *args: (told(*args)[0], np.ones(len(args[3]), dtype=bool)))
    both = uncertainty_at(ForwardModel(observations, {}, like=model), {RATE: 0.5})
    assert not np.array_equal(one_way.landing_by_tone, both.landing_by_tone)
    for name in ("opening", "landing"):
        off = np.linalg.norm(getattr(one_way, f"{name}_by_tone") - getattr(both, f"{name}_by_tone"), axis=1)
        assert np.all(off <= 0.01 * getattr(both, f"{name}_total_s"))


@pytest.mark.parametrize("jitter_s", [0.0, 5e-6, 2e-5])
def test_the_covariance_is_that_of_edges_read_once_a_sample(jitter_s: float) -> None:
    """Edges at ten places, jittered and rounded ten thousand times against samples anywhere: but for the harmonics from
    the fifth on, an eighth of T^2 / 12."""
    rng = np.random.default_rng(1)
    time_s = 0.02 * np.arange(10) + SAMPLING_S * rng.random(10)
    exact = time_s + SAMPLING_S * rng.random((10_000, 1))
    jitter = jitter_s * rng.standard_normal(exact.shape)
    error = SAMPLING_S * (np.floor((exact + jitter) / SAMPLING_S) + 0.5) - exact
    shared = rounding_errors(time_s, np.full(10, np.hypot(ROUNDING_S, jitter_s)), SAMPLING_S, jitter_s)
    found = np.cov(error.T)
    apart = ~np.eye(10, dtype=bool)
    assert (shared @ shared.T)[apart] == pytest.approx(found[apart], abs=0.16 * ROUNDING_S**2)
    assert np.all(np.sum(shared**2, axis=1) < np.diag(found))


def test_edges_known_within_a_sample_share_nothing() -> None:
    """An edge timed better than its rounding was not rounded; nor was one that never came, or in no samples. Where
    nothing tells the jitter, no edges are known to share an error."""
    time_s, rounded = np.array([0.1, np.nan]), np.full(2, ROUNDING_S)
    assert not np.any(rounding_errors(time_s, np.array([1e-6, ROUNDING_S]), SAMPLING_S, 0.0))
    assert not np.any(rounding_errors(time_s, rounded, 0.0, 0.0))
    assert not np.any(rounding_errors(time_s, rounded, SAMPLING_S, np.inf))


def test_errors_that_are_forgotten_go_together_less_the_longer_they_lie_apart() -> None:
    """Two steps of twelve flights: within a step errors go together by ``exp(-rate time)``, and each has its size.
    Where nothing is forgotten they stay what they were."""
    rng, rate = np.random.default_rng(5), 5.0
    step, time_s = np.repeat([0, 1], 12), np.arange(24) * 0.04
    changes = rng.standard_normal((2, 24, 2))
    lasting, own = forgotten(changes, step, time_s, rate)
    same = step[:, None] == step
    together = np.einsum("qnk,qmk->knm", changes, changes) * same
    wanted = together * np.exp(-rate * np.abs(time_s[:, None] - time_s))
    found = np.einsum("qnk,qmk->knm", lasting, lasting) * same
    assert np.diagonal(found, axis1=1, axis2=2).T + own == pytest.approx(np.diagonal(together, axis1=1, axis2=2).T)
    near = np.abs(np.subtract.outer(np.arange(24), np.arange(24))) == 1
    assert np.std((found - wanted)[:, near & same]) < 0.2 * np.std(wanted[:, near & same])
    lasting, own = forgotten(changes, step, time_s, 0.0)
    assert np.einsum("qnk,qmk->knm", lasting, lasting) * same == pytest.approx(together)
    assert own == pytest.approx(0.0, abs=1e-9)


def with_landings(observations: Observations, landing_s: np.ndarray) -> Observations:
    """Landings replaced where they are known."""
    known = np.where(np.isfinite(landing_s), landing_s, observations.measured.landing_s)
    return replace(observations, measured=replace(observations.measured, landing_s=known))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("places", [1, 3])
def test_rounding_that_repeats_is_no_lack_of_fit(fly_ramp: Callable[..., ForwardModel], places: int, seed: int) -> None:
    """Exact landings rounded to samples, whose error returns every cycle or every third: told of the samples, it is
    noise, also in what is predicted from them where the ball leaves as it lands."""
    sampling_s = 1.0 / 25.37 / (500.0 + (1.0 / 3.0 + 0.002 if places == 3 else 0.0))
    observations = fly_ramp({}, seed).observations
    observations = replace(observations, landing_sigma_s=np.full(len(observations), sampling_s / np.sqrt(12.0)))
    for _ in range(IN_A_ROW):  # a ball that leaves as it lands is predicted from the landing before
        observations = with_landings(observations, ForwardModel(observations, {}).predict({}).landing_s)
    read = sampling_s * (np.floor(observations.measured.landing_s / sampling_s) + 0.5)
    rounded = with_landings(observations, read)
    seen = Scatter(repeated_s2=np.zeros(MIN_STEPS), freedom=np.ones(MIN_STEPS, dtype=int), sampling_s=sampling_s)
    told = goodness_of_fit(ForwardModel(replace(rounded, circuit=ContactCircuit(scatters=(Scatter(), seen))), {}), {})
    untold = goodness_of_fit(ForwardModel(rounded, {}), {})
    assert untold.p_serial < 1e-12
    assert told.p_lack_of_fit > FROZEN.lack_p
