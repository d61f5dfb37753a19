"""The accelerometer shows the plate's motion early and too small: a high-pass in its amplifier.

Sensors with a charge amplifier or a supply over the signal's cable are coupled through a capacitor. At a tenth of the
forcing's frequency its corner still turns the phase by 6 degrees, half a millisecond at 30 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import ORDINARY_LAG, Effect, Parameter

EFFECT = Effect(
    name="accelerometer_high_pass",
    summary="the accelerometer's amplifier has a high-pass",
    parameters=(
        Parameter(
            "corner_hz", "Hz", 0.0, 10.0, 0.02, start_grid=(0.2, 2.0), meaning="corner of a high-pass of first order",
        ),
    ),
    confused_with={"contact_latency": "runs at several frequencies", "phase_lag": "landing times"},
    hides=ORDINARY_LAG,
    reference="coupling capacitors of charge amplifiers and IEPE supplies",
)  # fmt: skip


def accelerometer_response(p: Mapping[str, float], omega_radps: Floats) -> Complexes:
    """Reading over truth."""
    present = np.where(omega_radps > 0.0, omega_radps, np.inf)  # a tone that is not there has the frequency 0
    return np.asarray(1.0 / (1.0 - 2j * np.pi * p["corner_hz"] / present))
