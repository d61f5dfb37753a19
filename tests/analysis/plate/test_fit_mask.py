"""Unmasked intervals of a step, and projections of tones that are shifted in frequency."""

from __future__ import annotations

import numpy as np

from analysis.plate.step_state import FitIntervals, shifted_down, signed_frequencies


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


def test_a_shift_down_is_the_shift_up_with_every_frequency_reversed() -> None:
    """Tones shifted down, projected on a masked fit that leaves one tone out, are what the shift up says of them."""
    rng = np.random.default_rng(3)
    start = np.sort(rng.uniform(0.0, 0.8, 12))
    spans = np.column_stack([start, start + 0.02])
    kept = FitIntervals(np.repeat([0, 1], 6), spans, np.full(12, -1), np.zeros(12, dtype=np.bool_))
    omega, shift = np.array([[160.0, 320.0, 314.0], [150.0, 300.0, 314.0]]), 14.0
    every, own = signed_frequencies(omega), signed_frequencies(omega[:, :2])[:, 1:]
    fitted = np.ones((2, 3), dtype=np.bool_)
    fitted[1, 2] = False
    gram = kept.gram(every, np.column_stack([np.ones(2, dtype=np.bool_), fitted, fitted]))
    up, down = (kept.projected(gram, every, own + by)[:, 1:] for by in (shift, -shift))
    assert np.abs(up).max() > 0.1
    np.testing.assert_allclose(shifted_down(up), down, atol=1e-9)
    assert not up[1, [2, 5]].any()
