"""Unmasked intervals of a step."""

from __future__ import annotations

import numpy as np

from analysis.plate.fit_mask import FitIntervals


def test_intervals_hold_every_kept_block_once() -> None:
    """Blocks are one interval as long as they are kept, in one window and all in contact or none."""
    rng = np.random.default_rng(4)
    keep = np.repeat(rng.random(200) < 0.7, rng.integers(1, 9, 200))
    n = keep.size
    window, contact = np.arange(n) // 13 - 1, np.repeat(rng.random(n) < 0.5, 7)[:n]
    found = FitIntervals.of_blocks(100, keep, window, contact, 0.5)
    bounds = np.rint(found.span_s / 0.5).astype(int) - 100
    covered = np.zeros(n, dtype=int)
    for (start, stop), own_window, own_contact in zip(bounds, found.window, found.contact, strict=True):
        covered[start:stop] += 1
        assert np.all(window[start:stop] == own_window) and np.all(contact[start:stop] == own_contact)
    np.testing.assert_array_equal(covered, keep)
    same = (window[1:] == window[:-1]) & (contact[1:] == contact[:-1])
    assert len(bounds) == np.count_nonzero(keep) - np.count_nonzero(keep[1:] & keep[:-1] & same)
