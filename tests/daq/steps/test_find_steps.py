"""Finding steps: edges to a cycle, frequencies to a few parts per million, whatever the drive does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from daq.setup.setup import Forcing
from daq.steps.find_steps import FoundStep, find_steps, given_step, step_table
from daq.steps.forcing_detection import Signal, gamma_of
from kernels.arrays import Floats

RATE_HZ = 2000.0
LEVELS = [0.2, 0.25, 0.3, 0.5, 0.45, 1.0]
Ramp = Callable[..., Floats]


def steps_in(x: Floats, forcing: Forcing, rate_hz: float = RATE_HZ) -> list[FoundStep]:
    """Steps in an array."""
    return find_steps(Signal(lambda a, b: x[a:b], rate_hz, forcing), 0, len(x))


@pytest.mark.parametrize("ratio", [1, 2, 3, 5])
@pytest.mark.parametrize("fade", [0, 2, 12])
def test_levels_and_edges(ramp: Ramp, ratio: int, fade: int) -> None:
    """Each level is one step, found to a cycle and a half, with its amplitude and frequency, at any ratio and fade."""
    frequency = 25.37
    x = ramp(LEVELS, [frequency] * 6, ratio=ratio, fade=fade) + np.random.default_rng(1).normal(0, 3e-4, 1)[0]
    x += np.random.default_rng(2).normal(0, 3e-4, len(x))
    found = steps_in(x, Forcing(frequency_hz=24.0, ratio=ratio))
    assert len(found) == 6
    cycle = RATE_HZ / frequency
    first = round(0.2 * RATE_HZ)
    for i, (step, level) in enumerate(zip(found, LEVELS, strict=True)):
        begin = first + i * (round(fade * cycle) + round(20 * cycle))
        assert abs(step.stop - (begin + round(fade * cycle) + round(20 * cycle))) < 1.5 * cycle + 0.15 * fade * cycle
        assert abs(step.start - begin) < 1.5 * cycle + 0.15 * fade * cycle
        assert abs(step.tones.amplitudes[0]) == pytest.approx(level, rel=1e-3)
        assert abs(step.frequency_hz / frequency - 1) < 5 * step.frequency_sigma_hz / frequency + 1e-5


@pytest.mark.parametrize("growth", [0.001, 0.02])
def test_holds_whose_amplitude_drifts_keep_their_borders(growth: float) -> None:
    """Whether they drift by a thousandth or by two per cent, six levels are six steps, the last one too."""
    n = round(14 * RATE_HZ / 25.0)
    envelope = np.concatenate([level * np.linspace(1.0 - growth / 2.0, 1.0 + growth / 2.0, n) for level in LEVELS])
    x = envelope * np.sin(2.0 * np.pi * 25.0 * np.arange(len(envelope)) / RATE_HZ)
    found = steps_in(x, Forcing(frequency_hz=25.0))
    assert [s.stop for s in found] == pytest.approx(n * np.arange(1, 7), abs=1.5 * RATE_HZ / 25.0)
    assert [abs(s.tones.amplitudes[0]) for s in found] == pytest.approx(LEVELS, rel=growth)


def test_frequency_steps_large_and_small(ramp: Ramp) -> None:
    """Steps that change frequency, by a factor of two or by two parts in a thousand, are told apart and measured."""
    frequencies = [20.0, 40.0, 31.3, 31.36, 25.0, 24.5]
    found = steps_in(ramp([1.0] * 6, frequencies), Forcing(frequency_hz=30.0))
    assert [s.frequency_hz for s in found] == pytest.approx(frequencies, rel=5e-6)


def test_hint_may_be_far_off(ramp: Ramp) -> None:
    """The profile's frequency need not be that of the file: a factor of four either way finds the same steps."""
    x = ramp(LEVELS, [31.0] * 6)
    for hint in (8.0, 31.0, 120.0):
        assert [s.frequency_hz for s in steps_in(x, Forcing(frequency_hz=hint))] == pytest.approx([31.0] * 6, rel=1e-5)


def test_frequency_sigma_is_honest(ramp: Ramp) -> None:
    """Over many noises the error of the frequency is what its stated standard deviation says."""
    clean = ramp([1.0], [25.37])
    score = []
    for seed in range(40):
        noisy = clean + np.random.default_rng(seed).normal(0, 0.02, len(clean))
        (step,) = steps_in(noisy, Forcing(frequency_hz=25.0))
        score.append((step.frequency_hz - 25.37) / step.frequency_sigma_hz)
    assert 0.6 < np.std(score) < 1.6
    assert abs(np.mean(score)) < 0.8


def test_silence_and_noise_hold_no_steps() -> None:
    """Zeros, noise and a constant are not steps."""
    rng = np.random.default_rng(1)
    for x in (np.zeros(20_000), rng.normal(0, 1, 20_000), np.full(20_000, 2.5)):
        assert steps_in(x, Forcing(frequency_hz=25.0)) == []


def test_pauses_part_steps(ramp: Ramp) -> None:
    """Equal steps with silence between them are steps of their own, and the silence belongs to none."""
    one = ramp([0.5], [25.0])
    found = steps_in(np.concatenate([one, np.zeros(3000), one]), Forcing(frequency_hz=25.0))
    assert len(found) == 2
    assert found[1].start - found[0].stop > 3000


def test_a_sweep_that_never_rests_is_cut_in_pieces() -> None:
    """An amplitude that grows without a rest is taken in pieces that cover it."""
    t = np.arange(40_000) / RATE_HZ
    found = steps_in(np.sin(2 * np.pi * 25.0 * t) * (0.2 + t / 10), Forcing(frequency_hz=25.0))
    assert len(found) > 10
    assert sum(s.stop - s.start for s in found) > 0.9 * len(t)


def test_a_second_harmonic_does_not_become_the_forcing(ramp: Ramp) -> None:
    """With c = 2 the stronger second tone is not taken for the first."""
    (step,) = steps_in(ramp([0.3], [25.0], ratio=2), Forcing(frequency_hz=30.0, ratio=2))
    assert step.frequency_hz == pytest.approx(25.0, rel=1e-5)
    assert np.abs(step.tones.amplitudes) == pytest.approx([0.3, 1.2], rel=1e-4)


def test_step_table_counts_samples(ramp: Ramp) -> None:
    """Fade, settle and hold add up; gamma's direction is that of the ramp."""
    forcing = Forcing(frequency_hz=25.37)
    found = steps_in(ramp([0.3, 0.6, 0.4], [25.37] * 3), forcing)
    rows = step_table(found, forcing, RATE_HZ, np.array([0.3, 0.6, 0.4]))
    assert rows["direction"].tolist() == [1, 1, -1]
    assert (rows["fade_samples"] <= rows["settle_samples"]).all()
    assert (rows["settle_samples"] < rows["n_samples"]).all()
    hold = (rows["n_samples"] - rows["settle_samples"]) * rows["frequency_hz"] / RATE_HZ
    np.testing.assert_allclose(hold, rows["cycles"])


def test_gamma_follows_the_shape_of_the_forcing() -> None:
    """Plate tones of g gamma m^2 d_m give back gamma, for one tone and for two, whatever the phases."""
    rng = np.random.default_rng(4)
    for ratio in (1, 2, 3):
        forcing = Forcing(frequency_hz=25.0, ratio=ratio, amplitude=(1.0, 0.7), phase_deg=(10.0, 40.0))
        tones = [0.83 * m * m * z * np.exp(1j * rng.uniform(0, 6)) for m, z in forcing.displacement_tones()]
        assert gamma_of(np.array(tones), forcing) == pytest.approx(0.83, rel=1e-12)


def test_a_given_step_keeps_its_edges(ramp: Ramp) -> None:
    """Where somebody says what was set, the edges are theirs and the frequency is fitted; too short gives none."""
    x = ramp([1.0], [25.37])
    signal = Signal(lambda a, b: x[a:b], RATE_HZ, Forcing(frequency_hz=10.0))
    (step,) = given_step(signal, 600, 1900, 25.3)
    assert (step.start, step.hold, step.stop) == (600, 600, 1900)
    assert step.frequency_hz == pytest.approx(25.37, rel=1e-5)
    assert given_step(signal, 600, 700, 25.3) == []


def test_hum_and_impacts_are_not_steps(ramp: Ramp) -> None:
    """Noise that repeats itself (hum beating with the tones, ringing after impacts) does not cut a step in pieces."""
    rng = np.random.default_rng(6)
    x = ramp([0.3, 0.6], [25.3] * 2)[400:-400]  # without the silence, in which hum is all there is
    hum = 0.05 * np.sin(2 * np.pi * 50.0 * np.arange(len(x)) / RATE_HZ)
    hits = (rng.random(len(x)) < 0.01) * rng.normal(0, 0.3, len(x))
    ringing = np.convolve(hits, np.exp(-np.arange(30) / 5))[: len(x)]
    for disturbance in (hum, ringing):
        found = steps_in(x + disturbance, Forcing(frequency_hz=25.0))
        assert [abs(s.tones.amplitudes[0]) for s in found] == pytest.approx([0.3, 0.6], rel=0.05)
        assert [s.frequency_hz for s in found] == pytest.approx([25.3] * 2, rel=2e-3)


@pytest.mark.parametrize("levels", [(0.2, 0.5, 0.3), (0.2, 0.21, 0.22), (1.0, 1.1, 1.3)])
@pytest.mark.parametrize("fade", [4, 6, 8, 12, 20, 40])
def test_a_fade_is_no_step(ramp: Ramp, levels: tuple[float, ...], fade: int) -> None:
    """Short and long fades, small and large, quiet and noisy, belong to the step that they lead to."""
    clean = ramp(list(levels), [25.37] * 3, fade=fade)
    for noise in (0.0, 1e-3):
        x = clean + np.random.default_rng(1).normal(0, noise, len(clean))
        found = steps_in(x, Forcing(frequency_hz=25.37))
        assert [abs(s.tones.amplitudes[0]) for s in found] == pytest.approx(levels, rel=5e-3)


@pytest.mark.parametrize("noise", [0.0, 1e-5])
@pytest.mark.parametrize("fade", [2, 6])
def test_a_hold_ends_before_a_fade_that_begins_slowly(ramp: Ramp, fade: int, noise: float) -> None:
    """The quiet beginning of the next fade does not shift a hold's amplitude."""
    levels = [0.25, 0.305, 0.36, 0.415]
    x = ramp(levels, [25.37] * 4, ratio=2, fade=fade)[340:]
    x += np.random.default_rng(5).normal(0, noise, len(x))
    found = steps_in(x, Forcing(frequency_hz=25.37, ratio=2))
    assert [abs(s.tones.amplitudes[0]) for s in found[1:]] == pytest.approx(levels[1:], rel=1e-5)


def test_a_table_that_rings_loudly_does_not_hide_a_step(ramp: Ramp) -> None:
    """Levels 4 % apart under impacts that ring at 1.5 kHz, three times as loud as the motion: each is a step."""
    rng, rate_hz, levels = np.random.default_rng(7), 10_000.0, [1.31, 1.367, 1.425]
    x = ramp(levels, [22.1] * 3, rate_hz=rate_hz)
    since_s = np.arange(200) / rate_hz
    rings = 4.0 * np.exp(-since_s / 2.6e-3) * np.sin(2.0 * np.pi * 1500.0 * since_s)
    hits = np.zeros(len(x))
    for cycle in range(4, 64):
        hits[round(cycle * rate_hz / 22.1 + rng.normal(0.0, 3.0))] = 1.0
    found = steps_in(x + np.convolve(hits, rings)[: len(x)], Forcing(frequency_hz=22.1), rate_hz)
    assert [abs(s.tones.amplitudes[0]) for s in found] == pytest.approx(levels, rel=0.01)
