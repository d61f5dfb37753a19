"""A linear trend of a parameter with the time in the run, named together with that parameter's effect.

The drift is relative to the parameter's value in the middle of the run, and the whole run long.
"""

from __future__ import annotations

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="parameter_drift",
    summary="a parameter changes steadily during the run",
    parameters=(Parameter("per_run", "1", -2.0, 2.0, 0.05, meaning="end minus start, over the middle value"),),
    confused_with={"gain_compression": "steps in shuffled or up-and-down order"},
    is_trend=True,
    reference="warming, wear, an amplifier that drifts",
)
