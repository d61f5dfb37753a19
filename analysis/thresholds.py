"""Every threshold of the verdict, in one place, frozen before any scoring.

The rule kept here: changing a number here is a decision to be recorded, with the whole confusion matrix made anew.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """What a verdict needs.

    Attributes
    ----------
    gain_nats, gain_sigmas
        Held-out gain for an effect: at least so many nats, and so many standard errors of the per-step differences.
    again_nats, again_sigmas
        The same for every further effect: one cause must nearly fail before two are named.
    worse_nats, worse_sigmas
        A channel whose held-out loss rises by more than both is worse, and the effect is refused.
    tie_nats, tie_sigmas
        Sets within this of the best cannot be told apart from it.
    idle
        Largest root mean square change of whitened residuals between a set and a simpler one to call them the same.
    reserve
        Every so-many-th step is seen by no fit and no selection.
    lack_p
        Probability under which the remainder is more than noise.
    lack_ratio
        And at least so many times the noise floor, so that a trifle in a long run is not a discovery.
    plate_rms_z
        The same for plate data (root mean square of normalised residuals).
    quiet_ratio
        Ratio, of flights and of plate data, below which no second cause is looked for.
    clean_bill
        Times the noise floor: where held-out events are missed by more, nothing is called explained.
    most_effects
        Effects named at most.
    """

    gain_nats: float = 12.0
    gain_sigmas: float = 2.0
    next_effect_nats: float = 15.0
    again_sigmas: float = 2.5
    worse_nats: float = 6.0
    worse_sigmas: float = 2.0
    tie_nats: float = 4.0
    tie_sigmas: float = 2.0
    idle: float = 0.15
    reserve: int = 4
    lack_p: float = 1e-4
    lack_ratio: float = 1.25
    plate_rms_z: float = 1.6
    noise_like_ratio: float = 1.25
    max_rms_over_floor: float = 1.5
    most_effects: int = 3


FROZEN = Thresholds()
