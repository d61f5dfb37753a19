"""The accelerometer reads something else at rest than declared.

It can be seen only where the channel is DC coupled and its zero is declared.
"""

from __future__ import annotations

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="accelerometer_offset",
    summary="the accelerometer's zero is not the declared one",
    parameters=(
        Parameter(
            "offset_mps2", "m/s^2", -50.0, 50.0, 0.05, calibration=0.01, hook="offset_mps2", meaning="reading at rest"
        ),
    ),
    confused_with={"local_gravity": "landing times"},
    reference="bias, tilt, temperature",
)
