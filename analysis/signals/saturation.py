"""A reading that stands still at its largest or smallest value: sensor or converter are at their end.

The tones of what is cut off are too small, and no fit can tell. Impacts that are cut off for some samples do no harm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

STANDS = 0.02  # share of the samples at an end from which tones suffer: a sine cut off there has lost 0.1 %
CROWDED = 4.0  # times as many as at the next value; at the end of a sine there are 2.4 times as many


def share_at_an_end(values: npt.NDArray[Any]) -> float:
    """Share of ``values`` (n,) at the largest or the smallest one, where a signal that turns there would have fewer."""
    total = 0
    for end, beyond in ((values.max(), values < values.max()), (values.min(), values > values.min())):
        if not beyond.any():
            return 0.0  # a channel that shows nothing is another matter
        there = int(np.count_nonzero(values == end))
        next_to_it = values[beyond].max() if end > values[beyond][0] else values[beyond].min()
        if there > CROWDED * int(np.count_nonzero(values == next_to_it)):
            total += there
    return total / len(values)
