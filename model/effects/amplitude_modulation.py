"""The plate's amplitude swells and sinks slowly, by a sine in time that multiplies all that the drive asks for.

Depth and frequency belong to the rig; the phase is another one in each recording, where the plate
itself shows it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="amplitude_modulation",
    summary="the plate's amplitude swells and sinks slowly",
    parameters=(
        Parameter("depth", "1", 0.0, 0.9, 0.003, hint="modulation_depth", meaning="relative amplitude of the swell"),
        Parameter(
            "frequency_hz", "Hz", 1e-3, 20.0, 0.002, null_value=1.0, start_grid=(1.0,), hint="modulation_hz",
            is_shape=True, meaning="of the swell",
        ),
    ),
    confused_with={
        "parameter_drift": "several periods within the run",
        "gain_compression": "steps in another order",
        "table_resonance": "its line is below the forcing, not on both sides of it",
    },
    reference="beating supplies, a hunting amplitude loop",
)  # fmt: skip


def modulation(p: Mapping[str, float]) -> tuple[float, float]:
    """Depth of the swell, relative, and its angular frequency, rad/s."""
    return p["depth"], 2.0 * math.pi * p["frequency_hz"]
