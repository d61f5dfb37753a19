"""Thresholds of the verdict, in one place, frozen before any scoring.

A change of a number here is a decision to be recorded, with the whole confusion matrix made anew. Decisions 5 and 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """Thresholds that decide what is named and what is called explained."""

    # largest probability that the best of all candidates gains so much by chance, for an effect to be named
    best_of_all_p: float = 1e-3
    first_effect_nats: float = 6.0  # least held-out gain of the first effect
    first_effect_sigmas: float = 1.5  # the same in standard errors of the per-step differences
    # the same standard errors where landings that were lost are found, or more than noise is left without the effect
    # and only noise with it: a gain by a single step has one
    few_steps_sigmas: float = 1.0
    # gain beyond doubt without a null of its own: of a richer form, of a term, at a detection limit
    gain_nats: float = 12.0
    gain_sigmas: float = 2.0  # the same in standard errors
    next_effect_nats: float = 15.0  # the same for every further effect: one cause must nearly fail before two are named
    next_effect_sigmas: float = 2.5  # the same in standard errors
    worse_nats: float = 6.0  # rise of a channel's held-out loss beyond which an effect is refused
    worse_sigmas: float = 2.0  # the same in standard errors: both must be exceeded
    tolerated_plate_loss: float = 0.05  # part of a gain that plate data may lose while they remain noise
    tie_nats: float = 4.0  # lead below which two sets of effects are not distinguished
    tie_sigmas: float = 2.0  # the same in standard errors
    found_excess: float = 0.1  # part of the excess noise left at which lost landings count as found again
    found_nats: float = 100.0  # gain at which they do
    reported_nats: float = 1.0  # least gain of a refused candidate that is reported with its reason
    negligible_nats: float = 4.0  # gain on the training steps below which a candidate is not followed
    # largest root mean square change of whitened residuals between a set and a simpler one to call them the same
    idle_rms: float = 0.15
    reserve_every: int = 4  # every so-many-th step is held out from all fits and all selection
    # times `next_effect_nats` below which a further effect must also gain on the reserved steps
    reserve_factor: float = 2.0
    # standard deviations, of a log-likelihood ratio, by which reserved steps may lie below what the others promise
    reserve_sigmas: float = 2.0
    lack_p: float = 1e-4  # probability under which the remainder is more than noise
    law_p: float = 1e-2  # probability of the remainder below which a law is sought in place of what is named
    # least rms of standardised residuals for a lack of fit to count; a trifle in a long run is no discovery
    lack_ratio: float = 1.25
    plate_rms_z: float = 1.6  # largest rms of standardised plate data
    noise_like_ratio: float = 1.25  # ratio, of flights and of plate data, below which no second cause is sought
    max_rms_over_floor: float = 1.5  # largest held-out error over the noise floor of an explained recording
    chance_p: float = 1e-3  # probability of a held-out error that noise may still have made
    most_effects: int = 3  # largest number of effects that act on the ball and are named
    knots_rms: float = 1.05  # rms of standardised landings below which no finer knots are tried
    base_rms: float = 1.15  # the same for a second set of named effects
    # correlation of its mark on the flights above which a named effect is reported as similar to a smooth term
    similar_correlation: float = 0.8

    def most_rms_us(self, floor_us: float) -> float:
        """Largest error of an explained recording next to its noise floor; all edges of a step share `SHARED_S`."""
        return self.max_rms_over_floor * math.hypot(floor_us, 1e6 * SHARED_S)


FROZEN = Thresholds()

# ---- constants of the noise model and of the measures above: the same for every caller ----

# likelihood of an event
OUTLIER_FRACTION = 0.03  # share of events that may be other ones than predicted, anywhere within a period
FAR_CYCLES = 0.1  # median error of take-offs from rest and landings, in cycles, that no effect explains
FEWEST_TAKEOFFS = 8  # from rest, for that test
LEAST_EXCESS_S = 3e-7  # error of the integration and of the edge's own physics
SHARED_S = 1e-6  # common error of all edges of one kind in a step: the contact circuit's own physics
ANOTHER_EVENT_S = 1e-3  # change of a predicted event beyond which it is another event: no derivative follows it
FARTHEST_PERIODS = 0.5  # cap of a residual, in periods: beyond, another event was met
COMMON_MODE_SIGMAS = 6.0  # residuals beyond (tone covariance included) are excluded from the step's common mode
LOST_RATIO = 20.0  # excess over uncertainty beyond which landings count as lost
UNSHARED_RATIO = 2.0  # excess over uncertainty that no error shared by a step explains

# calibrations and single parameters
MOVED_SIGMAS = 2.0  # of its stated uncertainty, from which a calibration is tried as the cause itself
CALIBRATION_SIGMAS = 2.5  # largest error of a calibration, in its own sigmas; a larger one is an effect
NULL_P = 0.05  # probability of Wald's test under which parameters differ from their null values

# gain by step
MOST_OF_A_STEP_NATS = 12.0  # clip of one step's contribution to a gain

# the search for candidates: what is followed farther
DRIFTING_NATS = 100.0  # gain above which a candidate is tried with a drift as well
FOLLOWED_PART = 0.3  # of the best gain of a round, below which a candidate's weights are not iterated
NEAR_NATS, NEAR_PART = 30.0, 0.2  # lag behind the best one, in nats and of its gain, beyond which a candidate is left
NEAR_CAUSE = 0.5  # part of a chosen cause's gain from which another is tried in its place when all causes are named
LEADING_P = 0.05  # chance of so large a gain below which a refused candidate of many runs is worth a pass of its own
IMPROBABLE = 1e-4  # explanations of less probability are left out
LEAST_INFORMATION = 1e-9  # of a size of unit scale, and of its part beyond the nuisances: below, it changes nothing

# a run that still goes on
RUN_P = 1e-3  # probability that a rig that does as declared is accused at any look of a run

# goodness of fit
GRAZING_RATIO = 6.0  # uncertainty of a landing, over the median one, at which it is near-grazing
GRAZING_SIGMAS = 3.0  # shift of a measured number in the test for near-grazing
FARTHEST_SIGMAS = 6.0  # clip of a standardised residual
INNOVATION_SIGMAS = 4.0  # clip of an independent residual: a rare graze is no law
SCALE_KNOWN = 0.12  # relative uncertainty of the noise scale, found from some dozens of edges
LEAST_IN_BIN = 6  # innovations in a bin or group that is tested
LEAST_OF_KIND = 6  # plate data of a kind that is tested
