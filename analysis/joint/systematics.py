"""Systematic errors that all runs of a rig share, as nuisances with a prior: how the contact's edges are dated.

An estimator of edges errs alike in every run, by its threshold, the sampling, or the edges that it does not see. Ten
runs average noise, and not this. So each run's summary has derivatives to these errors too, and one value of each,
common to all runs, is fitted with every candidate: only what such an error cannot imitate can be named.

What delays both edges alike is a calibration of each run, `contact_latency`. Openings may be off against closings. A
contact from which the ball leaves at once is seen only where noise or sampling has made it longer, so its closing is
dated too early: by up to half of its length, and by no more than an edge's own uncertainty. Decision 158.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.attribution.chance import Place
from analysis.attribution.fit import of_same_events
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import EDGE_STEP_S
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import Values
from kernels.arrays import Bools, Floats

NAMES = ("openings late beside closings", "closings of brief contacts late")
PLACES: tuple[Place, ...] = tuple((("systematic", name), ()) for name in NAMES)
"""What their coordinates are called among those of a run's summary."""
UNIT_S = 1e-6  # of their coordinates


@dataclass(frozen=True)
class Systematics:
    """What one run tells of the errors of `NAMES`."""

    slopes: Floats  # derivatives of the bare residuals to each, per `UNIT_S`, (r, 2)
    # standard deviations of their priors, in `UNIT_S`, (2,); 0 where the run has no such edges
    sigma: tuple[float, ...]

    @classmethod
    def of(cls, model: ForwardModel, whitener: Whitener, at: Values) -> Systematics:
        """From one run at the parameter values ``at``."""
        observations = model.observations
        brief = np.append(observations.measured.relaunched[1:] & observations.measured.linked[1:], False)
        now = model.residuals(at)
        raw, columns = whitener.stacked(now), []
        for closings, openings in ((np.zeros_like(brief), 1.0), (brief, 0.0)):
            late_s = np.where(closings, EDGE_STEP_S, 0.0)
            earlier = model.predict(at, landing_shift_s=-late_s, near=now.predicted)
            there = replace(
                now,
                landing_s=np.where(
                    observations.scored, observations.measured.landing_s - late_s - earlier.landing_s, np.nan
                ),
                opening_s=np.where(
                    model.from_rest,
                    observations.measured.opening_s - openings * EDGE_STEP_S - earlier.opening_s,
                    np.nan,
                ),
            )
            change = of_same_events(whitener.stacked(there) - raw, whitener)
            columns.append(change * UNIT_S / EDGE_STEP_S)
        opening_s, closing_s = (
            _typical(observations.opening_sigma_s, model.from_rest),
            _typical(observations.landing_sigma_s, brief),
        )
        # all edges together may be off by a tenth of one edge's uncertainty; closings by half of what their prior
        # allows
        sigma_s = (0.1 * opening_s, min(0.5 * observations.circuit.closure_s, closing_s))
        return cls(np.column_stack(columns), tuple(s / UNIT_S for s in sigma_s))


def _typical(sigma_s: Floats, some: Bools) -> float:
    return float(np.median(sigma_s[some])) if some.any() else 0.0
