"""The next sample that matters."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.signals import AT_ONCE, first_beyond


@pytest.mark.parametrize("above", [True, False])
def test_the_next_sample_beyond_a_bound_is_found_from_every_place(above: bool) -> None:
    """From every place on, the first sample beyond the bound; a sample at the bound and one that is no number are none,
    and the length of the signal is the answer where none follows."""
    rng = np.random.default_rng(3)
    x = rng.uniform(0.0, 1.0, 5 * AT_ONCE + 7).astype(np.float32)
    bound = np.sort(x)[-4] if above else np.sort(x)[3]
    x[[AT_ONCE, 2 * AT_ONCE - 1]] = np.nan
    beyond = np.flatnonzero(x > bound if above else x < bound)
    for begin in range(x.size + 1):
        after = beyond[beyond >= begin]
        assert first_beyond(x, begin, bound, above) == (after[0] if after.size else x.size)
