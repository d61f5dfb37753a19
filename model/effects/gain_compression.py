"""The plate's motion falls behind the drive as the amplitude grows.

To lowest order the loss goes with the mean square of the acceleration that the drive asks for, all its tones together:
a coil that heats, an amplifier that gives way. What bends each cycle makes harmonics, too: `harmonic_distortion`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="gain_compression",
    summary="the plate's motion falls behind the drive as the amplitude grows",
    parameters=(
        Parameter(
            "per_g2", "1/g^2", -0.2, 0.5, 1e-3, meaning="relative loss per square of one tone of the same mean square"
        ),
    ),
    confused_with={"drive_gain": "a range of amplitudes", "parameter_drift": "steps in shuffled or up-and-down order"},
    reference="saturation of amplifier and magnet, first even term",
)


def transfer(p: Mapping[str, float], omega_radps: Floats, accel_g: Floats) -> Complexes:
    """Factor on drive -> plate."""
    return (1.0 / np.maximum(1.0 + p["per_g2"] * accel_g**2, 0.1)).astype(np.complex128)
