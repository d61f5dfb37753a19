"""The measure of forcing on every axis and page: gamma, or at c = 1 gamma_peak, with its definition.

Everything is computed in ``gamma = A w^2 / g`` of one tone. At c = 1 both tones are one sine, and the paper's
experimental axis is its peak acceleration, ``gamma_peak``: a constant multiple of gamma.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from daq.setup.setup import Forcing

PEAK_LABEL = "Γₚₑₐₖ = max(−ẍₚ)/g"
GAMMA_LABEL = "Γ = Aω²/g"


@dataclass(frozen=True)
class GammaScale:
    """The measure of gamma that is shown."""

    factor: float  # shown value over gamma
    name: str  # in plain text
    symbol: str  # a sign in figures
    label: str  # of an axis, with the definition
    definition: str  # one sentence


def gamma_scale(forcing: Forcing, ratios: ArrayLike) -> GammaScale:
    """The measure shown for steps driven at the frequency ratios ``ratios``: gamma_peak where all are 1, else gamma."""
    own = np.unique(np.asarray(ratios, dtype=np.int64))
    if own.tolist() == [1]:
        factor = float(abs(forcing.displacement_tones()[0][1])) if forcing.ratio == 1 else 2.0
        sense = f"gamma_peak = max(-a)/g = {factor:.4g} A w^2/g"
        return GammaScale(
            factor, "gamma_peak", "Γₚₑₐₖ", f"{PEAK_LABEL}   (c = 1)",
            f"{sense}: the greatest downward acceleration of the plate's sine over gravity (c = 1).",
        )  # fmt: skip
    at = f"   (c = {own[0]})" if len(own) == 1 else ""
    return GammaScale(
        1.0, "gamma", "Γ", f"{GAMMA_LABEL}{at}",
        "gamma = A w^2/g: the acceleration amplitude of the first tone over gravity, before the second is added.",
    )  # fmt: skip
