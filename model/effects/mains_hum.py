"""The plate moves at the mains frequency.

It is a motion of the plate; pick-up in a sensor is a fault of that channel.
"""

from __future__ import annotations

from collections.abc import Mapping

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="mains_hum",
    summary="the plate also moves at the mains frequency",
    parameters=(
        Parameter(
            "amplitude_mps2",
            "m/s^2",
            0.0,
            50.0,
            0.05,
            calibration=0.002,
            ordinary=0.02,  # picked up by the accelerometer's cable: one tone with the plate's own
            power=0.5,
            meaning="at 50 or 60 Hz",
        ),
    ),
    confused_with={"harmonic_distortion": "a forcing that does not divide the mains frequency"},
    reference="ground loops in the amplifier",
)


def hum_mps2(p: Mapping[str, float]) -> float:
    """Amplitude of the plate's acceleration at the mains frequency."""
    return p["amplitude_mps2"]
