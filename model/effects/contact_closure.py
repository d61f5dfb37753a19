"""An impact closes the circuit for a moment even when the ball leaves at once.

A nuisance of the instrument, not of the motion.
"""

from __future__ import annotations

from collections.abc import Mapping

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="contact_closure",
    summary="an impact closes the circuit for a moment even when the ball leaves at once",
    parameters=(Parameter("closure_s", "s", 0.0, 2e-3, 1e-4, calibration=1e-3, meaning="shortest closed time"),),
    confused_with={"contact_latency": "landing times"},
    nuisance=True,
    reference="elastic contact, deformation of the wire",
)


def closure_s(p: Mapping[str, float]) -> float:
    """Shortest time for which an impact closes the circuit."""
    return p["closure_s"]
