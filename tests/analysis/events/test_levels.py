"""Levels of the contact circuit: what is counted while the volts are read once."""

from __future__ import annotations

import numpy as np

from analysis.events.levels import PLATEAU_AFTER, _edge_lengths, _settled


def test_settled_volts_are_those_amid_enough_on_their_side() -> None:
    """The volts picked are those of every window of the length that lies on one side as a whole."""
    rng = np.random.default_rng(2)
    volts = np.repeat(rng.uniform(0.0, 5.0, 40), rng.integers(1, 40, 40)) + rng.normal(0, 0.01, 1)
    side, before = volts > 2.5, 16
    length = before + PLATEAU_AFTER
    windows = np.lib.stride_tricks.sliding_window_view(side, length)
    for wanted in (False, True):
        whole = (windows == wanted).all(axis=1)
        np.testing.assert_array_equal(
            _settled(volts, side, wanted, before, length), volts[before:][: whole.size][whole]
        )


def test_edges_are_as_long_as_the_samples_between_the_levels() -> None:
    """A return to the level it came from is no edge."""
    volts = np.array([0.0, 0.1, 2.0, 3.0, 5.0, 4.9, 3.0, 5.0, 0.0, 2.0, 2.0, 2.0, 5.0])
    np.testing.assert_array_equal(_edge_lengths(volts, 0.0, 5.0), [2, 0, 3])
