"""The plate moves differently with and without the ball on it.
The rule kept here: the relative change of amplitude in flight against contact.
"""

from __future__ import annotations

from collections.abc import Mapping

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="mass_loading",
    summary="the ball's weight loads the shaker: the plate moves more while the ball is in the air",
    parameters=(
        Parameter(
            "relative", "1", -0.5, 0.5, 0.003, calibration=3e-4, meaning="amplitude in flight over contact, minus 1"
        ),
    ),
    seen_in=("plate",),
    confused_with={"harmonic_distortion": "steps without flights"},
    reference="mass ratio of ball and armature",
)


def gate(p: Mapping[str, float]) -> float:
    """Relative change of the plate's amplitude while the ball is off it."""
    return p["relative"]
