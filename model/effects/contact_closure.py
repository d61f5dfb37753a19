"""What an impact does to the circuit: it closes late, and for a moment even when the ball leaves at once.

A contact that chatters closes late, one behind a comparator with hysteresis opens late. A nuisance of the instrument,
not of the motion.
"""

from __future__ import annotations

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="contact_closure",
    summary="an impact closes the circuit late, and for a moment even when the ball leaves at once",
    parameters=(
        Parameter(
            "closure_s", "s", 0.0, 2e-3, 1e-4, calibration=1e-3, plate_only=True, hook="closure_s",
            meaning="shortest closed time",
        ),
        Parameter(
            "late_s", "s", -1.5e-4, 1.5e-4, 1e-5, calibration=5e-5, hook="closing_delay_s",
            meaning="later a closing than an opening",
        ),
    ),
    confused_with={"contact_latency": "landing times"},
    nuisance=True,
    reference="elastic contact, deformation of the wire",
)  # fmt: skip
