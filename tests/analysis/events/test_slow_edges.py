"""Edges that take many samples: an RC of 0.1 ms at 200 kHz is read as it is at 20 kHz."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from analysis.events.edges import time_edges
from analysis.events.impact_detection import NO_IMPACTS
from analysis.events.levels import CLOSES, DIP, OPENS, CrossingScan, measure_levels
from analysis.events.short_contacts import refine_short_contacts

TAU_S, NOISE_V = 1e-4, 0.01


def behind_an_rc(rng: np.random.Generator, rate_hz: float, contacts: int) -> tuple[np.ndarray, np.ndarray]:
    """Edges in time, and volts of a comparator read once a sample with an RC behind; contacts of 0.6 to 3 RC."""
    flights, lengths_s = rng.uniform(4e-3, 9e-3, contacts), rng.uniform(0.6, 3.0, contacts) * TAU_S
    lengths_s[::5] = 3e-3
    true = np.cumsum(np.column_stack([flights, lengths_s]).ravel())
    n = int((true[-1] + 5e-3) * rate_hz)
    is_open = np.searchsorted(true, np.arange(n) / rate_hz, side="right") % 2 == 0
    keep = np.exp(-1.0 / (TAU_S * rate_hz))
    volts = lfilter([1.0 - keep], [1.0, -keep], 5.0 * is_open, zi=[keep * 5.0])[0]
    return true, volts + NOISE_V * rng.standard_normal(n)


@pytest.mark.parametrize("rate_hz", [20e3, 50e3, 100e3, 200e3])
def test_contacts_shorter_than_the_rc_are_dated_at_every_rate(rate_hz: float) -> None:
    """Noise of the levels is the noise; every contact is found, once, and its edges scatter as stated."""
    true, volts = behind_an_rc(np.random.default_rng(3), rate_hz, 200)
    levels = measure_levels(volts, 0.0, 5.0)
    assert levels.noise_v == pytest.approx(NOISE_V, rel=0.1)
    scan = CrossingScan(levels)
    fraction = ((volts - levels.closed_v) / levels.swing_v).astype(np.float32)
    scan.add(fraction, 0, 0, fraction.size)
    crossings = scan.crossings()
    assert (crossings.kind == DIP).any()
    edges, opening, closing = time_edges(crossings, levels, rate_hz)
    assert opening.tau_s == pytest.approx(TAU_S, rel=0.01) and closing.tau_s == pytest.approx(TAU_S, rel=0.01)
    assert opening.clock_s == closing.clock_s == pytest.approx(1.0 / rate_hz)
    found = refine_short_contacts(edges, crossings, levels, (opening, closing), NO_IMPACTS, rate_hz)
    np.testing.assert_array_equal(found.kind, np.tile([CLOSES, OPENS], 200))
    error = (found.time_s - true) / found.uncertainty_s
    assert abs(error.mean()) < 0.25
    assert np.std(error) == pytest.approx(1.0, abs=0.15)
