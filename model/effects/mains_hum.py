"""The plate moves at the mains frequency.

It is a motion of the plate; pick-up only in a sensor is a fault of that channel, `mains_pickup`. Where both are there
the recorded line is their sum: both follow one mains, so that reading over motion is the same complex number in all
steps. Flights tell the motion. Decision 724.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import Effect, Parameter
from model.effects.mains_pickup import MAINS_HZ

EFFECT = Effect(
    name="mains_hum",
    summary="the plate also moves at the mains frequency",
    parameters=(
        # ordinary: picked up by the accelerometer's cable, one tone with the plate's own
        Parameter(
            "amplitude_mps2", "m/s^2", 0.0, 50.0, 0.05, calibration=0.002, ordinary=0.02, power=0.5,
            start_grid=(0.05, 0.5), meaning="at 50 or 60 Hz",
        ),
        Parameter("cable", "1", -5.0, 5.0, 0.1, meaning="what the cable adds, over the motion, in phase with it"),
        Parameter("cable_across", "1", -5.0, 5.0, 0.1, meaning="a quarter of a turn ahead of it"),
    ),
    variants=(("amplitude_mps2",), ("amplitude_mps2", "cable", "cable_across")),
    confused_with={"harmonic_distortion": "a forcing that does not divide the mains frequency"},
    reference="ground loops in the amplifier",
)  # fmt: skip


def hum_mps2(p: Mapping[str, float]) -> float:
    """Amplitude shown at the mains frequency."""
    return p["amplitude_mps2"] * abs(complex(1.0 + p["cable"], p["cable_across"]))


def accelerometer_response(p: Mapping[str, float], omega_radps: Floats) -> Complexes:
    """Reading over truth: the plate's motion and what the cable adds, where the mains are."""
    off_hz = np.abs(np.asarray(omega_radps)[..., None] / (2.0 * np.pi) - MAINS_HZ).min(axis=-1)
    # the mains stay within a few tenths of a hertz of their nominal frequency
    return np.where(off_hz < 0.5, complex(1.0 + p["cable"], p["cable_across"]), 1.0)
