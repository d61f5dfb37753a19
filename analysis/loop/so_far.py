"""The judgement of a run that still goes on: is what it recorded so far more than noise of the declared model?

A test after each step, each at the same level, accuses most innocent rigs sooner or later. The error rate of the *run*
is held instead: its probability `RUN_P` is divided among the looks, so that a rig that does as declared is ever accused
in one run of ``1 / RUN_P``, however many steps the run has (alpha spending; the sum over all looks is the bound of
Bonferroni, which needs no independence between them).

References
----------
K. K. G. Lan and D. L. DeMets, Biometrika 70, 659 (1983): spending an error rate over looks at growing data.
Decision 285.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.attribution.candidates import candidates_of, null_value_of, parameter_of, priors_of
from analysis.attribution.fit import Fitted, Fitter
from analysis.attribution.hypothesis import Refits
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.lack_of_fit import goodness_of_fit, plate_probability
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import Observations
from analysis.residuals.prediction_errors import landing_probability, noise_floors_us, scored_rows
from analysis.residuals.values import TREND, ParameterId
from analysis.thresholds import FROZEN, RUN_P
from model.effects.registry import resolve


@dataclass(frozen=True)
class Promising:
    """A candidate that could explain what is more than noise, judged by a linear step and no more."""

    names: tuple[str, ...]  # of its effects
    gain: float  # in nats, were the residuals linear in it
    values: dict[ParameterId, float]  # of its free parameters, at the end of that step


@dataclass(frozen=True)
class SoFar:
    """The judgement after a look."""

    within: bool  # whether flights and plate are within noise of the declared model, at the level of this look
    p: float  # probability of so much from noise
    level: float  # that below which this look accuses
    landing_rms_us: float  # error of the predicted landings, as the closed loop states it
    floor_us: float  # its noise floor
    flights: int  # number of flights judged
    promising: tuple[Promising, ...]  # empty within noise


def level_of_look(look: int) -> float:
    """Part of the run's error rate that the look number ``look`` (1, 2, ...) may spend; all of them sum to `RUN_P`."""
    return RUN_P / (look * (look + 1))


def judge_so_far(observations: Observations, look: int) -> SoFar | None:
    """Judge a run by what it has recorded so far; None without flights to judge.

    Parameters
    ----------
    observations
        Of all finished steps.
    look
        The number of this look at the run, from 1; looks may be left out.
    """
    if not observations.scored.any():
        return None
    model = ForwardModel(observations, resolve(observations.setup.declared_values()))
    fitter = Fitter(model, priors_of(observations.setup), np.ones(len(observations.steps), bool))
    # calibrations move within their priors, as in the closed loop
    declared = Refits(fitter).converged((), Whitener.of(model, {}), (), {}).fitted
    left, level = goodness_of_fit(model, declared.values), level_of_look(look)
    rows, _ = scored_rows(model, declared.values, np.ones(len(observations.steps), bool))
    p_landings, rms_us = landing_probability(model, declared.values, rows)
    floor_us = noise_floors_us(model, declared.values, rows)[0]
    # the three tests share the level; a trifle that many flights resolve is no discovery, as in the closed loop
    tests = (
        (left.p_flights(FROZEN), left.ratio > FROZEN.lack_ratio),
        (plate_probability(model, declared.values), not left.plate_passes(FROZEN)),
        (p_landings, rms_us > FROZEN.most_rms_us(floor_us)),
    )
    within = not any(len(tests) * p < level and large for p, large in tests)
    p = min(1.0, len(tests) * min(p for p, _ in tests))
    return SoFar(within, p, level, rms_us, floor_us, len(rows), () if within else _promising(model, fitter, declared))


def _promising(model: ForwardModel, fitter: Fitter, declared: Fitted) -> tuple[Promising, ...]:
    """Candidates whose linearised gain is beyond doubt, the largest first, one for each set of names."""
    found: dict[tuple[str, ...], Promising] = {}
    for candidate in candidates_of(model):
        free = tuple(key for key in candidate.free if key not in declared.free)
        if not free or any(key[1].endswith(TREND) for key in free):
            continue
        shapes = [key for key in free if parameter_of(key).is_shape]
        settings = sorted({tuple(start.get(key, null_value_of(key)) for key in shapes) for start in candidate.starts})
        # a dozen settings of a candidate's shapes, evenly
        few = (dict(zip(shapes, at, strict=True)) for at in settings[:: max(1, len(settings) // 12)])
        gain, values = max((fitter.linear_step(declared, free, at) for at in few), key=lambda step: step[0])
        best = found.get(candidate.names)
        if gain > FROZEN.gain_nats and (best is None or gain > best.gain):
            found[candidate.names] = Promising(candidate.names, gain, {key: values[key] for key in free})
    # by the linear gain only, before any fit of them: a few names are a hint while the run lasts, no verdict
    return tuple(sorted(found.values(), key=lambda one: -one.gain)[:4])
