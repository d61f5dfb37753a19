"""The circuit opens only when the ball has risen by a gap: take-offs are seen late, landings are not.

A nuisance, always fitted; an alarm when it leaves its prior.
"""

from __future__ import annotations

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="contact_gap",
    summary="the circuit opens late because contact lasts over a small height",
    parameters=(
        Parameter(
            "gap_m", "m", 0.0, 2e-4, 2e-7, calibration=2e-6, start_grid=(3e-7, 3e-6), power=3.0, hook="gap_m",
            meaning="height over which contact lasts",
        ),
    ),
    confused_with={"adhesion": "landing times, dwell time, two comparator levels"},
    nuisance=True,
    reference="a cubic tangency: 0.3 micrometres delay the opening by 0.7 ms",
)  # fmt: skip
