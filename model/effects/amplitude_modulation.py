"""The plate's amplitude swells and sinks slowly within a step.
The rule kept here: one slow sine; its phase is free in each step.
"""

from __future__ import annotations

from collections.abc import Mapping

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="amplitude_modulation",
    summary="the plate's amplitude swells and sinks within a step",
    parameters=(
        Parameter(
            "depth", "1", 0.0, 0.9, 0.003, calibration=2e-4, power=0.5, meaning="relative amplitude of the swell"
        ),
    ),
    seen_in=("plate",),
    confused_with={"parameter_drift": "several periods within the run", "mains_hum": "the line's frequency"},
    reference="beating supplies, a hunting amplitude loop",
)


def modulation(p: Mapping[str, float]) -> float:
    """Relative depth of the modulation."""
    return p["depth"]
