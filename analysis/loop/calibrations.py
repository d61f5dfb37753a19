"""Calibrations as the best explanation fits them, beside what the profile states of them.

They are free in every fit, within their stated uncertainty, so that no effect is named for what they explain; a fit
that moves one is a finding all the same.
"""

from __future__ import annotations

from dataclasses import dataclass

from analysis.attribution.hypothesis import Hypothesis


@dataclass(frozen=True)
class Calibration:
    """A calibration, stated and fitted.

    Attributes
    ----------
    effect, parameter
        Its shared names.
    value, sigma
        As fitted, with standard deviation, in the parameter's own unit.
    stated, stated_sigma
        The same before the fit.
    """

    effect: str
    parameter: str
    value: float
    sigma: float
    stated: float
    stated_sigma: float

    @property
    def moved(self) -> bool:
        """Whether the fit has moved it by more than its stated uncertainty and by three of its own."""
        change = abs(self.value - self.stated)
        return change > self.stated_sigma and change > 3.0 * self.sigma


def fitted_calibrations(best: Hypothesis) -> tuple[Calibration, ...]:
    """Every calibration that the fit left free beside the effects of ``best``, in alphabetical order."""
    fitted = best.fitted
    return tuple(
        Calibration(*key, float(fitted.values[key]), fitted.sigma(key), prior.mean, prior.sigma)
        for key, prior in sorted(fitted.fitter.priors.items())
        if key in fitted.keys and key not in best.free
    )
