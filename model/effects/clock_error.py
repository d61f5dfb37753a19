"""The recorder's clock runs fast or slow against the commanded frequency.

With one clock for drive and recorder it cannot be seen.
"""

from __future__ import annotations

from collections.abc import Mapping

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="clock_error",
    summary="the recorder's clock differs from the one that made the drive",
    parameters=(
        Parameter("relative", "1", -0.05, 0.05, 1e-4, calibration=3e-5, meaning="recorded over true time, minus 1"),
    ),
    confused_with={"local_gravity": "the drive's frequency"},
    reference="quartz: 50 ppm; a wrong rate in a file: anything",
)


def time_scale(p: Mapping[str, float]) -> float:
    """Recorded over true time."""
    return 1.0 + p["relative"]
