"""The plate moves at the mains frequency.

It is a motion of the plate; pick-up only in a sensor is a fault of that channel, `mains_pickup`.
"""

from __future__ import annotations

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="mains_hum",
    summary="the plate also moves at the mains frequency",
    parameters=(
        # ordinary: picked up by the accelerometer's cable, one tone with the plate's own
        Parameter(
            "amplitude_mps2", "m/s^2", 0.0, 50.0, 0.05, calibration=0.002, ordinary=0.02, power=0.5, hook="hum_mps2",
            meaning="at 50 or 60 Hz",
        ),
    ),
    confused_with={"harmonic_distortion": "a forcing that does not divide the mains frequency"},
    reference="ground loops in the amplifier",
)  # fmt: skip
