"""The accelerometer's cable picks up the mains: its reading shows them, the plate does not move by them.

Transformers and rectifiers add multiples of the mains frequency; all of them are one cause. Decision 282.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Floats
from model.effects.base import Effect, Parameter

MAINS_HZ = np.array([50.0, 60.0])
MULTIPLES = np.arange(1, 8)  # that are fitted where mains are found

EFFECT = Effect(
    name="mains_pickup",
    summary="the accelerometer's cable picks up the mains",
    parameters=(
        Parameter(
            "amplitude_mps2", "m/s^2", 0.0, 50.0, 0.05, power=0.5, start_grid=(0.05, 0.5), hook="pickup_mps2",
            meaning="shown at 50 or 60 Hz, none of it the plate's, nor of its multiples",
        ),
    ),
    confused_with={"mains_hum": "landing times"},
    reference="ground loops, unshielded cables",
)  # fmt: skip


def accelerometer_response(p: Mapping[str, float], omega_radps: Floats) -> Floats:
    """Reading over truth: without bound at the mains frequency and its multiples, where the plate is still."""
    hz = np.asarray(omega_radps)[..., None, None] / (2.0 * np.pi) / MULTIPLES[:, None]
    # the mains stay within a few tenths of a hertz of their nominal frequency
    shown = (p["amplitude_mps2"] > 0.0) & (np.abs(hz - MAINS_HZ) < 0.5).any(axis=(-2, -1))
    return np.where(shown, 1e9, 1.0)  # over a motion that is not there the reading has no bound
