"""A coupling capacitor: a first-order high-pass, sample by sample.

The samples lie on the exact response of the circuit to a voltage that is straight between them.
"""

from __future__ import annotations

import math

import numpy as np

from kernels.arrays import Floats


class HighPass:
    """First-order high-pass that remembers; ``corner_hz`` None lets everything pass.

    With ``r = 2 pi corner / rate``, a straight piece of slope ``s`` a sample is answered by
    ``y[n] = exp(-r) y[n-1] + s (1 - exp(-r)) / r``.
    """

    def __init__(self, corner_hz: float | None, rate_hz: float) -> None:
        self._r = 2.0 * math.pi * corner_hz / rate_hz if corner_hz else 0.0
        self._state: Floats | None = None

    def __call__(self, volts: Floats) -> Floats:
        """The next samples (n,), filtered; before the first the circuit had rested at it."""
        if self._r == 0.0 or not len(volts):
            return volts
        decay = math.exp(-self._r)
        gain = (1.0 - decay) / self._r
        from scipy.signal import lfilter  # takes most of a second to import

        if self._state is None:
            self._state = np.array([-gain * volts[0]])
        out, self._state = lfilter([gain, -gain], [1.0, -decay], volts, zi=self._state)
        return np.asarray(out)
