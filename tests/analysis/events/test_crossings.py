"""The scan of the contact's voltage looks at quiet stretches at once and misses nothing in them."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.events.levels import CLOSES, DIP, OPENS, CrossingScan, Levels
from analysis.signals import AT_ONCE

N = 3 * AT_ONCE


@pytest.mark.parametrize("at", [2, AT_ONCE - 1, AT_ONCE, AT_ONCE + 1, 2 * AT_ONCE, N - 2])
def test_one_sample_is_found_wherever_it_lies(at: int) -> None:
    """A single sample that closes, opens or dips is found at its place, at the bounds of stretches as between them."""
    for rest, value, kinds in ((0.0, 1.0, [OPENS, CLOSES]), (1.0, 0.0, [CLOSES, OPENS]), (1.0, 0.6, [DIP])):
        fraction = np.full(N + 32, rest, dtype=np.float32)
        fraction[16 + at] = value
        found = CrossingScan(Levels(0.0, 5.0, 0.01)).add(fraction, 0, 16, N)
        assert found.kind.tolist() == kinds
        assert found.sample[0] == at
