"""Contact edges: sub-sample where the voltage shows it, honest where it does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from analysis.events.edges import time_edges
from analysis.events.levels import CLOSES, DIP, OPENS, CrossingScan, Levels, measure_levels

RATE = 20000.0


def circuit(
    edges_s: np.ndarray, n: int, tau_open_s: float, tau_close_s: float, noise_v: float, rng: np.random.Generator
) -> np.ndarray:
    """Volts of a 5 V circuit that starts closed and toggles at the given times, by its RC, exactly."""
    t = np.arange(n) / RATE
    volts = np.zeros(n)
    level, target, since, tau = 0.0, 0.0, 0.0, tau_close_s
    ends = np.append(edges_s, np.inf)
    for k, end in enumerate(ends):
        inside = (t >= since) & (t < end)
        volts[inside] = target + (level - target) * np.exp(-(t[inside] - since) / tau)
        level = target + (level - target) * np.exp(-(end - since) / tau) if np.isfinite(end) else level
        since, target, tau = end, (5.0 if k % 2 == 0 else 0.0), (tau_open_s if k % 2 == 0 else tau_close_s)
    return volts + noise_v * rng.standard_normal(n)


def timed(volts: np.ndarray, levels: Levels):
    """Edges of a signal handed over in two pieces."""
    scan = CrossingScan(levels)
    fraction = ((volts - levels.closed_v) / levels.swing_v).astype(np.float32)
    half = volts.size // 2
    padded = np.pad(fraction, 16, mode="edge")
    scan.add(padded[: half + 32], 0, 16, half)
    scan.add(padded[half:], half, 16, volts.size - half)
    return time_edges(scan.crossings(), levels, RATE)


@pytest.mark.parametrize(("tau_open_s", "tau_close_s"), [(2e-5, 2e-5), (1e-4, 2e-5)])
def test_rc_edges_are_found_between_samples_with_the_stated_uncertainty(tau_open_s: float, tau_close_s: float) -> None:
    """With a visible RC shape the time constants come back and errors scatter as stated, well under a microsecond."""
    rng = np.random.default_rng(3)
    true = np.cumsum(rng.uniform(3e-3, 9e-3, 400))
    volts = circuit(true, int((true[-1] + 0.01) * RATE), tau_open_s, tau_close_s, 0.003, rng)
    levels = measure_levels(volts, 0.0, 5.0)
    assert levels.noise_v == pytest.approx(0.003, rel=0.1)
    edges, opening, closing = timed(volts, levels)
    assert opening.tau_s == pytest.approx(tau_open_s, rel=0.01)
    assert opening.clock_s == closing.clock_s == 0.0
    assert closing.tau_s == pytest.approx(tau_close_s, rel=0.02)
    error = edges.time_s - true
    assert np.sqrt(np.mean(error**2)) < 1e-6
    assert np.std(error / edges.uncertainty_s) == pytest.approx(1.0, abs=0.15)
    np.testing.assert_array_equal(edges.kind, np.tile([OPENS, CLOSES], 200))


def test_sharp_edges_have_no_bias_and_a_uniform_uncertainty() -> None:
    """Where nothing shows between two samples, the middle is taken: no bias, sigma of a sample over root twelve."""
    rng = np.random.default_rng(4)
    true = np.cumsum(rng.uniform(3e-3, 9e-3, 2000))
    volts = circuit(true, int((true[-1] + 0.01) * RATE), 1e-9, 1e-9, 0.003, rng)
    edges, opening, _ = timed(volts, measure_levels(volts, 0.0, 5.0))
    assert opening.tau_s == 0.0
    error = edges.time_s - true
    sigma = 1.0 / RATE / np.sqrt(12.0)
    assert abs(error.mean()) < 4.0 * sigma / np.sqrt(true.size)
    assert np.std(error) == pytest.approx(sigma, rel=0.06)
    np.testing.assert_allclose(edges.uncertainty_s, sigma)


@pytest.mark.parametrize("seed", range(6))
def test_edges_of_a_locked_motion_tell_a_short_rc_no_better_than_their_few_places(seed: int) -> None:
    """Fifteen steps of twenty edges, each step at one place between two samples: errors stay within what is stated."""
    rng = np.random.default_rng(seed)
    first = 0.05 + np.arange(15) * 0.8 + rng.uniform(0.0, 1.0 / RATE, 15)
    opens = (first[:, None] + 0.04 * np.arange(20)).ravel()
    true = np.column_stack([opens, opens + 0.017 + np.repeat(rng.uniform(0.0, 1.0 / RATE, 15), 20)]).ravel()
    volts = circuit(true, int((true[-1] + 0.05) * RATE), 2e-6, 2e-6, 0.005, rng)
    edges, _, _ = timed(volts, measure_levels(volts, 0.0, 5.0))
    assert np.abs((edges.time_s - true) / edges.uncertainty_s).max() < 3.0


@pytest.mark.parametrize("ramp_s", [4e-6, 8e-6, 1.6e-5])
def test_edges_in_a_straight_line_are_not_taken_for_an_rc(ramp_s: float) -> None:
    """A voltage that runs from level to level in a part of a sample is dated without bias, as a sharp one is."""
    rng = np.random.default_rng(5)
    true = np.cumsum(rng.uniform(3e-3, 9e-3, 2000))
    t = np.arange(int((true[-1] + 0.01) * RATE)) / RATE
    opens = np.where(np.arange(true.size) % 2 == 0, 5.0, 0.0)
    corners = np.column_stack([true, true + ramp_s]).ravel()
    volts = np.interp(t, corners, np.column_stack([5.0 - opens, opens]).ravel()) + 0.003 * rng.standard_normal(t.size)
    edges, _, _ = timed(volts, measure_levels(volts, 0.0, 5.0))
    error = edges.time_s - true
    sigma = 1.0 / RATE / np.sqrt(12.0)
    assert abs(error.mean()) < 4.0 * sigma / np.sqrt(true.size)
    assert np.std(error) < 1.1 * sigma


@pytest.mark.parametrize("from_hz", [8000.0, 9070.0])
def test_lines_that_somebody_drew_between_samples_are_dated_as_the_samples_were(from_hz: float) -> None:
    """A sharp circuit brought to 20 kHz by linear interpolation: no bias, and the uncertainty of the lower rate."""
    rng = np.random.default_rng(6)
    true = np.cumsum(rng.uniform(3e-3, 9e-3, 1000))
    own = np.arange(int((true[-1] + 0.01) * from_hz)) / from_hz
    seen = 5.0 * (np.searchsorted(true, own) % 2) + 0.003 * rng.standard_normal(own.size)
    volts = np.interp(np.arange(int(own[-1] * RATE)) / RATE, own, seen)
    edges, opening, closing = timed(volts, measure_levels(volts, 0.0, 5.0))
    assert opening.tau_s == closing.tau_s == 0.0
    assert opening.straight_s == pytest.approx(1.0 / from_hz, rel=0.01)
    error, sigma = edges.time_s - true, 1.0 / from_hz / np.sqrt(12.0)
    assert abs(error.mean()) < 4.0 * sigma / np.sqrt(true.size)
    assert np.std(error) == pytest.approx(sigma, rel=0.06)
    np.testing.assert_allclose(edges.uncertainty_s, sigma, rtol=0.02)


def test_lines_drawn_between_the_samples_of_an_rc_are_late_as_it_is_and_no_more() -> None:
    """A circuit with an RC of .4 samples, brought to 2.2 times the rate by lines: edges are late by less than the RC,
    where an RC fitted to the lines made them a sample early."""
    rng = np.random.default_rng(7)
    tau_s, factor = 0.4 / RATE, 2.205
    true = np.cumsum(rng.uniform(3e-3, 9e-3, 600))
    seen = circuit(true, int((true[-1] + 0.01) * RATE), tau_s, tau_s, 0.003, rng)
    volts = np.interp(np.arange(int((seen.size - 1) * factor)) / factor, np.arange(seen.size), seen)
    edges, opening, closing = timed(volts, measure_levels(volts, 0.0, 5.0))
    assert opening.tau_s == closing.tau_s == 0.0
    late = edges.time_s / factor - true
    assert 0.5 * tau_s < late.mean() < tau_s
    assert np.std(late) < np.median(edges.uncertainty_s) / factor


def test_a_brief_contact_between_edges_does_not_spoil_its_neighbours() -> None:
    """A contact of three samples is still found at both ends, though the voltage never settles."""
    rng = np.random.default_rng(5)
    starts = np.cumsum(rng.uniform(8e-3, 12e-3, 150))
    true = np.sort(np.concatenate([[1e-3], starts, starts + 1.6e-4]))
    volts = circuit(true, int((true[-1] + 0.01) * RATE), 2e-5, 2e-5, 0.002, rng)
    edges, _, _ = timed(volts, measure_levels(volts, 0.0, 5.0))
    np.testing.assert_allclose(edges.time_s, true, atol=2e-6)


def test_a_dent_is_no_edge_but_is_reported() -> None:
    """A contact too short to reach the threshold leaves a dip and no closing."""
    levels = Levels(0.0, 5.0, 0.002)
    volts = np.full(400, 5.0)
    volts[200] = 4.2
    edges, _, _ = timed(volts, levels)
    np.testing.assert_array_equal(edges.kind, [DIP])
    assert abs(edges.time_s[0] - 200 / RATE) < 1.0 / RATE


def test_levels_are_those_measured_not_those_declared() -> None:
    """A circuit that closes at 0.4 V and opens at 4.7 V is measured so; a level never seen stays as declared."""
    rng = np.random.default_rng(6)
    volts = np.where((np.arange(20000) // 500) % 2 == 0, 0.4, 4.7) + 0.01 * rng.standard_normal(20000)
    levels = measure_levels(volts, 0.0, 5.0)
    assert levels.closed_v == pytest.approx(0.4, abs=1e-3)
    assert levels.open_v == pytest.approx(4.7, abs=1e-3)
    always_open = measure_levels(np.full(5000, 5.0), 0.0, 5.0)
    assert always_open.closed_v == 0.0


@pytest.mark.parametrize("bits", [0, 12])
@pytest.mark.parametrize("tau_samples", [0.7, 3.0])
def test_edges_of_a_sampled_comparator_behind_an_rc_tell_nothing_between_samples(tau_samples: float, bits: int) -> None:
    """Edges that all have the same shape are timed to the middle of a sample, with the uncertainty of a sample."""
    rng = np.random.default_rng(4)
    true = np.cumsum(rng.uniform(3e-3, 9e-3, 200))
    square = circuit(true, int((true[-1] + 0.01) * RATE), 1e-9, 1e-9, 0.0, rng)
    keep = np.exp(-1.0 / tau_samples)
    volts = lfilter([1.0 - keep], [1.0, -keep], square) + 0.003 * rng.standard_normal(square.size)
    if bits:
        volts = np.round(volts * 2**bits / 20.0) * 20.0 / 2**bits
    edges, opening, closing = timed(volts, measure_levels(volts, 0.0, 5.0))
    assert opening.clock_s == closing.clock_s == 1.0 / RATE
    error = edges.time_s - true
    assert abs(error.mean()) < 3e-6
    assert np.std(error / edges.uncertainty_s) == pytest.approx(1.0, abs=0.15)


def test_a_converter_without_noise_is_as_coarse_as_its_step() -> None:
    """Levels that a 12-bit converter gives without any noise are uncertain by its step over root twelve."""
    rng = np.random.default_rng(5)
    true = np.cumsum(rng.uniform(3e-3, 9e-3, 100))
    step_v = 20.0 / 2**12
    volts = np.round(circuit(true, int((true[-1] + 0.01) * RATE), 5e-5, 5e-5, 0.0, rng) / step_v) * step_v
    levels = measure_levels(volts, 0.0, 5.0)
    assert levels.noise_v == pytest.approx(step_v / np.sqrt(12.0), rel=0.01)
    edges, *_ = timed(volts, levels)
    assert np.std((edges.time_s - true) / edges.uncertainty_s) == pytest.approx(1.0, abs=0.3)


def test_edges_after_a_dip_do_not_depend_on_what_was_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A closing soon after a dip has the same time, whatever numbers a new array happens to hold."""
    rng = np.random.default_rng(8)
    true = np.cumsum(rng.uniform(3e-3, 6e-3, 60))
    opened = true[30:40:2]
    short = [o + d for o in opened for d in (0.0, 1e-3, 1.04e-3, 1.54e-3)]  # in the air, a third of the time constant
    after = np.concatenate([true[:30], short, true[40:]])
    volts = circuit(after, int((true[-1] + 0.01) * RATE), 1e-4, 1e-4, 0.003, rng)
    levels = measure_levels(volts, 0.0, 5.0)
    plain, *_ = timed(volts, levels)
    assert (plain.kind == DIP).any()
    fresh = np.empty
    for number in (-1.0, float(plain.time_s[plain.kind == DIP][0])):

        def used(shape: object, *args: object, number: float = number, **kwargs: object) -> np.ndarray:
            """Numbers that an earlier array left behind."""
            return fresh(shape, *args, **kwargs) if args or kwargs else np.full(shape, number)

        with monkeypatch.context() as patch:
            patch.setattr(np, "empty", used)
            other, *_ = timed(volts, levels)
        np.testing.assert_array_equal(other.time_s, plain.time_s)
