"""What is computed once: the same numbers as when it is computed anew."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from analysis.computing import Memory
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.noise_model import EXCESSES_S, excess_noise, log_odds, robust_loss
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.plate_data.plate_observables import expected

FRICTION = {("coulomb_friction", "mu_up"): 0.15, ("coulomb_friction", "mu_down"): 0.15}
PLATE = {("drive_gain", "relative"): 0.02, ("phase_lag", "delay_s"): 1e-4, ("drive_gain", "relative@drift"): 0.01}


def test_a_result_is_made_once_until_too_many_others_are_asked_for() -> None:
    """The same key gives the same object; of a full memory the one that was not asked for longest is forgotten."""
    memory, made = Memory(2), list[int]()

    def make() -> list[int]:
        made.append(0)
        return made

    assert memory.recall("a", make) is memory.recall("a", make)
    assert len(made) == 1
    for key, count in (("b", 2), ("a", 2), ("c", 3), ("a", 3), ("b", 4)):
        memory.recall(key, make)
        assert len(made) == count


def test_what_one_thread_makes_the_others_wait_for() -> None:
    """Four threads that ask at once get one object, made once; where making it fails, each of them tries for itself."""
    memory, made, together = Memory(2), list[int](), threading.Barrier(4)

    def make() -> list[int]:
        made.append(0)
        time.sleep(0.05)
        return made

    def fail() -> list[int]:
        made.append(0)
        raise ValueError("not to be made")

    def asked(key: str, maker: Callable[[], list[int]]) -> list[int]:
        together.wait()
        return memory.recall(key, maker)

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: asked("a", make), range(4)))
        assert len(made) == 1
        assert all(x is made for x in found)
        tries = [pool.submit(asked, "b", fail) for _ in range(4)]
    assert [type(t.exception()) for t in tries] == [ValueError] * 4
    assert len(made) == 5


def test_no_flight_is_flown_for_what_touches_the_plate_alone(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A drive's gain or lag leaves prediction and uncertainty the very objects they were, a friction does not."""
    model = fly_ramp(FRICTION, 1)
    assert model.predicted({**FRICTION, **PLATE}) is model.predicted(FRICTION)
    assert uncertainty_at(model, {**FRICTION, **PLATE}) is uncertainty_at(model, FRICTION)
    assert model.predicted({}) is not model.predicted(FRICTION)


def test_no_flight_is_flown_for_how_a_light_table_was_driven(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Whether the drive's scale is that of the loaded plate shows only in plate data; a new frequency is flown."""
    model = fly_ramp(FRICTION, 1)
    mode = {("table_resonance", "mass_ratio"): 0.02, ("table_resonance", "frequency_hz"): 9.0}
    loaded = {**mode, ("table_resonance", "loaded"): 1.0}
    assert model.predicted(loaded) is model.predicted(mode)
    assert np.any(model.residuals(loaded).plate != model.residuals(mode).plate)
    assert model.predicted({**mode, ("table_resonance", "frequency_hz"): 11.0}) is not model.predicted(mode)


def test_shares_of_the_effects_add_up_to_the_expected_data(fly_ramp: Callable[..., ForwardModel]) -> None:
    """Plate residuals from kept shares are those of all effects at once, a trend among them."""
    model = fly_ramp({}, 1)
    data = model.observations.plate
    at_once = data.value - expected(data, model.by_step(PLATE))
    for _ in range(2):
        assert model.residuals(PLATE).plate == pytest.approx(at_once, rel=1e-12, abs=1e-12)


def test_a_model_like_another_shares_its_plate_and_not_its_flights(fly_ramp: Callable[..., ForwardModel]) -> None:
    """A model of the same plate predicts the same with a memory of flights of its own."""
    model = fly_ramp(FRICTION, 1)
    other = ForwardModel(model.observations, model.declared, like=model)
    assert other.predicted(FRICTION) is not model.predicted(FRICTION)
    assert np.array_equal(other.residuals(FRICTION).landing_s, model.residuals(FRICTION).landing_s, equal_nan=True)
    assert np.array_equal(other.residuals(FRICTION).plate, model.residuals(FRICTION).plate)


def test_the_excess_is_that_of_the_robust_loss() -> None:
    """The likelihood in one logarithm gives the loss and the excess of the robust loss itself, outliers included."""
    rng = np.random.default_rng(3)
    sigma, period = rng.uniform(2e-6, 3e-5, 300), np.full(300, 0.04)
    residual = 4e-5 * rng.standard_normal(300)
    residual[::40] = 0.02
    total = np.hypot(sigma[None, :], EXCESSES_S[:, None])
    losses = np.sum(robust_loss(residual / total, log_odds(total, period)) + np.log(total), axis=1)
    excess, loss = excess_noise(residual, sigma, period)
    assert excess == EXCESSES_S[np.argmin(losses)]
    assert loss == pytest.approx(losses.min(), rel=1e-10)
