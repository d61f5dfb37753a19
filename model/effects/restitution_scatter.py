"""Restitution that scatters from impact to impact: each rebound is off its own way, two-sided exponential.

The mean is that of `restitution`. What scatters shifts no prediction: it is an uncertainty of the landing after a
rebound. So it is measured from the landings when all else is fitted (`analysis.attribution.rebound_scatter`), and no
search frees it.
"""

from __future__ import annotations

from model.effects.base import Effect, Parameter

EFFECT = Effect(
    name="restitution_scatter",
    summary="the rebound scatters from impact to impact about its mean",
    parameters=(
        Parameter(
            "sd",
            "1",
            0.0,
            0.3,
            0.01,
            hook="rebound_scatter",
            meaning="standard deviation of the restitution of an impact",
        ),
    ),
    confused_with={"restitution": "a loss with impact speed shifts rebounds of one speed alike"},
    library=False,
    reference="Montaine, Heckel, Kruelle, Schwager and Poeschel, arXiv:1104.0049 (2011)",
)
