"""How well edges repeat, found only from the edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from analysis.events.edge_jitter import MIN_STEPS, Scatter, raised_together

PERIOD_S = 1.0 / 22.31
RATE_HZ = 20000.0


def with_jitter(time_s: np.ndarray, sigma_s: np.ndarray, *rest: Any, **named: float) -> np.ndarray:
    """Uncertainty of the edges, raised by their own scatter."""
    return Scatter.of(time_s, sigma_s, *rest, **named).raised(sigma_s)


def edges(
    rng: np.random.Generator, jitter_s: float, cycle: int = 1, swell_s: float = 0.0, period_s: float = PERIOD_S
) -> tuple[np.ndarray, ...]:
    """Twelve steps of three edges a cycle, jittered, sampled, and swelling slowly: times and steps."""
    times, steps = [], []
    for step in range(12):
        cycles = cycle * np.arange(14 // cycle)[:, None]
        exact = 10.0 * step + (cycles + np.array([0.1, 0.4, 0.7]) + rng.random()) * period_s
        exact = exact + swell_s * np.sin(2 * np.pi * 0.7 * exact)
        seen = np.ceil((exact + jitter_s * rng.standard_normal(exact.shape)) * RATE_HZ) / RATE_HZ - 0.5 / RATE_HZ
        times.append(seen.ravel())
        steps.append(np.full(seen.size, step))
    return np.concatenate(times), np.concatenate(steps)


@pytest.mark.parametrize(
    ("jitter_s", "cycle", "swell_s"), [(2e-5, 1, 0.0), (2e-5, 2, 0.0), (2e-5, 1, 1e-4), (0.0, 1, 0.0)]
)
def test_jitter_is_found_to_a_sixth(jitter_s: float, cycle: int, swell_s: float) -> None:
    """Whatever the cycle and a slow swell, and where sampling errors alternate from cycle to cycle."""
    sampled = 1.0 / RATE_HZ / np.sqrt(12.0)
    found = []
    for seed in range(8):
        time_s, step = edges(np.random.default_rng(seed), jitter_s, cycle, swell_s)
        own = np.full(time_s.size, sampled)
        found.append(with_jitter(time_s, own, step, np.ones(time_s.size, bool), np.full(12, PERIOD_S))[0])
    assert np.mean(found) == pytest.approx(np.hypot(sampled, jitter_s), rel=1 / 6)


@pytest.mark.parametrize("jitter_s", [0.0, 5e-6, 1e-5, 2e-5])
@pytest.mark.parametrize("samples", [800, 1000])
def test_jitter_is_found_where_every_cycle_is_a_whole_number_of_samples(jitter_s: float, samples: int) -> None:
    """The rounding repeats: jitter shows only in edges that change their sample; found to a sixth of the rounding."""
    period_s = samples / RATE_HZ
    sampled, found = 1.0 / RATE_HZ / np.sqrt(12.0), []
    for seed in range(16):
        time_s, step = edges(np.random.default_rng(seed), jitter_s, period_s=period_s)
        rest = np.full(time_s.size, sampled), step, np.ones(time_s.size, bool), np.full(12, period_s)
        found.append(with_jitter(time_s, *rest, sampling_s=1.0 / RATE_HZ)[0])
    jitter = np.sqrt(np.mean(np.square(found)) - sampled**2)
    assert jitter == pytest.approx(jitter_s, abs=sampled / 6)


def test_what_never_repeats_says_nothing() -> None:
    """Irregular edges leave the uncertainty as it was."""
    rng = np.random.default_rng(0)
    time_s, step = np.sort(rng.random(300)) * 10.0, np.arange(300) // 30
    own = np.full(300, 1e-5)
    assert with_jitter(time_s, own, step, np.ones(300, bool), np.full(10, PERIOD_S)) is own


def test_hum_is_no_jitter() -> None:
    """A line that is no multiple of the forcing moves edges from cycle to cycle: told of it, the jitter stays."""
    line, found = 2 * np.pi * 50.0, []
    for seed in range(8):
        time_s, step = edges(np.random.default_rng(seed), 2e-5)
        time_s = time_s + 1e-4 * np.sin(line * time_s)
        own = np.full(time_s.size, 1.0 / RATE_HZ / np.sqrt(12.0))
        rest = time_s, own, step, np.ones(time_s.size, bool), np.full(12, PERIOD_S)
        found.append((with_jitter(*rest)[0], with_jitter(*rest, [np.array([line])] * 12)[0]))
    blind, told = np.mean(found, axis=0)
    assert blind > 5e-5
    assert told == pytest.approx(np.hypot(1.0 / RATE_HZ / np.sqrt(12.0), 2e-5), rel=1 / 6)


def test_a_line_beside_a_harmonic_does_not_explain_the_jitter_away() -> None:
    """Half a turn of beat in a step is almost a parabola: taken at jittered times it would fit the jitter itself."""
    found = []
    for seed in range(8):
        time_s, step = edges(np.random.default_rng(seed), 2e-5)
        line = 2 * np.pi * (2 / PERIOD_S - 0.7)
        own, lines = np.full(time_s.size, 1e-6), [np.array([line])] * 12
        found.append(with_jitter(time_s, own, step, np.ones(time_s.size, bool), np.full(12, PERIOD_S), lines)[0])
    assert np.mean(found) == pytest.approx(np.hypot(1.0 / RATE_HZ / np.sqrt(12.0), 2e-5), rel=0.2)


def test_a_short_recording_takes_the_scatter_of_all() -> None:
    """One with two steps that repeat is raised by those of all together; one with enough of its own is left."""
    few, own = Scatter(np.full(MIN_STEPS - 1, 9e-12)), Scatter(np.full(MIN_STEPS, 25e-12))
    short, long, silent = np.full(5, 4e-6), np.full(7, 5e-6), np.full(2, 4e-6)
    found = raised_together([short, long, silent], [few, own, Scatter()])
    assert found[0] == pytest.approx(np.hypot(4e-6, 5e-6))
    assert found[1] is long
    assert found[2] == pytest.approx(np.hypot(4e-6, 5e-6))
    assert raised_together([short, silent], [few, few])[1] == pytest.approx(np.full(2, 5e-6))


def test_fewer_steps_than_that_say_nothing() -> None:
    """Two recordings without a third step that repeats stay as they are."""
    short = np.full(5, 4e-6)
    assert raised_together([short, short], [Scatter(np.full(1, 9e-12)), Scatter()])[0] is short


def test_edges_of_which_few_repeat_take_the_jitter_of_the_circuits_others() -> None:
    """Where few steps repeat a circuit's closings tell how its openings jitter; where many do, the openings do."""
    rng, others_s, found = np.random.default_rng(3), 2e-5, {3: [], 12: []}
    true_s = np.hypot(1.0 / RATE_HZ / np.sqrt(12.0), 2e-5)
    for steps, stated in found.items():
        for _ in range(40):
            time_s, step = edges(rng, 2e-5)
            few = (step < steps) & ((steps > 3) | (np.arange(step.size) % 3 == 0))
            sigma_s = np.full(time_s.size, 1.0 / RATE_HZ / np.sqrt(12.0))
            seen = Scatter.of(time_s, sigma_s, step, few, np.full(12, PERIOD_S), sampling_s=1.0 / RATE_HZ)
            stated.append([seen.raised(sigma_s)[0], seen.raised(sigma_s, others_s)[0], seen.raised(sigma_s, 0.0)[0]])
    few, many = (np.array(found[steps]) / true_s for steps in (3, 12))
    assert few[:, 1].std() < 0.8 * few[:, 0].std()  # with closings that jitter alike
    assert few[:, 1].mean() == pytest.approx(1.0, abs=0.05)
    assert many[:, 2].mean() == pytest.approx(many[:, 0].mean(), rel=0.05)  # with closings that do not jitter
    unseen = np.full(5, 4e-6)
    assert Scatter().raised(unseen, 3e-6) == pytest.approx(np.full(5, 5e-6))
