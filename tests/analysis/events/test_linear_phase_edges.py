"""Edges of the contact circuit behind a linear-phase filter: a sigma-delta converter, or a resampling by others."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.edges import time_edges
from analysis.events.levels import CrossingScan, measure_levels
from analysis.signals import PAD

RATE_HZ, FINE, DELAY = 20000.0, 16, 32


def test_an_edge_is_where_half_of_the_swing_is_and_its_ringing_is_no_contact() -> None:
    """Square edges anywhere between samples, behind a sharp low-pass: to a tenth of a sample, and no dips."""
    rng = np.random.default_rng(3)
    exact = 0.02 + 0.01 * np.arange(120) + 1e-4 * rng.random(120)
    fine_s = np.arange(int(1.25 * RATE_HZ * FINE)) / (RATE_HZ * FINE)
    square = 5.0 * (np.searchsorted(exact, fine_s) % 2)
    taps = np.sinc(0.9 * (np.arange(2 * DELAY * FINE + 1) / FINE - DELAY)) * np.hamming(2 * DELAY * FINE + 1)
    seen = np.convolve(square, taps / taps.sum(), mode="same")[::FINE] + 0.002 * rng.standard_normal(
        fine_s.size // FINE
    )
    levels = measure_levels(seen, 0.0, 5.0)
    assert levels.ripple > 0.05
    scan = CrossingScan(levels)
    scan.add(np.pad((seen / 5.0).astype(np.float32), PAD, mode="edge"), 0, PAD, seen.size)
    edges, _, _ = time_edges(scan.crossings(), levels, RATE_HZ)
    assert edges.time_s.size == exact.size
    assert np.abs(edges.time_s - exact).max() < 5e-6
    assert edges.uncertainty_s == pytest.approx(5e-6, rel=0.2)
