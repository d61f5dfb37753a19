"""The plate is driven by a force, and the ball's mass rides along while it is in contact.

In flight the plate accelerates by ``relative (a_p + g)`` more than the ``a_p`` of contact.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="mass_loading",
    summary="the ball's weight loads the shaker: the plate moves more while the ball is in the air",
    parameters=(
        Parameter(
            "relative", "1", -0.5, 0.5, 0.003, calibration=3e-4, hook="flight_gain",
            meaning="amplitude in flight over contact, minus 1",
        ),
        Parameter(
            "bare", "1", 0.0, 1.0, 0.3, start_grid=(1.0,), plate_only=True,
            meaning="1 where the drive was scaled without the ball",
        ),
    ),
    variants=(("relative",), ("relative", "bare")),
    confused_with={"harmonic_distortion": "steps without flights", "table_resonance": "a slow line after impacts"},
    reference="Newton's second law; mass ratio of ball and armature",
)  # fmt: skip


def transfer(p: Mapping[str, float], omega_radps: Any, accel_g: Any) -> Any:
    """Factor on the plate in contact, where the drive's scale is another plate's."""
    return np.full(np.shape(omega_radps), 1.0 / (1.0 + p["bare"] * p["relative"]), dtype=np.complex128)
