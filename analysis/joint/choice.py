"""Choice among candidates over runs, and the joint verdict from the last pass.

A candidate is judged by its gain, by what the best of all gains by chance, and by its gain on runs left out. The run is
the replicate: null draws give the scores of whole runs random signs, and each run is predicted by the fit of all
others.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from analysis.attribution.candidates import Prior, coordinate_of, null_value_of, parameter_of, scale_of, value_at
from analysis.attribution.chance import ScoreSpace, probability_of, unit_scale
from analysis.attribution.choice import (
    LogScoreDifference,
    chance_refusal,
    gain_refusal,
    penalised_best,
    required_gain,
    tied,
)
from analysis.joint.population import Population, constancy, each_on_its_own, one_run_alone
from analysis.joint.result import OverRuns, Systematic
from analysis.joint.summary import NAMES, PLACES, UNIT_S, Aligned, Option, width_of
from analysis.residuals.values import ParameterId
from analysis.thresholds import Thresholds
from kernels.arrays import Floats


@dataclass(frozen=True)
class Tested:
    """A candidate, added to what is named."""

    option: Option
    sizes: Floats  # its sizes in coordinates
    gain: float  # in the fit of all runs, nats
    losses: Floats  # of each run by the fit of all others, relative to the run's own point, (R,)
    held_out: LogScoreDifference  # gain on runs that the fit did not see
    p: float  # probability that the best of all candidates gains so much by chance
    refusal: str  # what forbids it, in words; empty where nothing does


class Candidates:
    """All candidates, each added to one fit of the population."""

    def __init__(self, model: Aligned, found: Population, limits: Thresholds) -> None:
        self.model, self.found, self.limits = model, found, limits
        self.every = np.ones(len(found.runs), dtype=np.bool_)
        self.before = model.left_out(found, found.free)
        self._places = np.arange(model.named, len(model.columns), dtype=np.int64)
        total = np.sum([run.information for run in found.runs], axis=0)
        free, tried = found.free, self._places
        self._follow = found.covariance @ total[np.ix_(free, tried)]
        bare = total[np.ix_(tried, tried)]
        self._information = bare - total[np.ix_(tried, free)] @ self._follow
        self._whole = np.diag(bare)
        self._scale = unit_scale(np.diag(self._information), self._whole)
        self._signs = (model.low[tried] >= 0.0).astype(np.int64) - (model.high[tried] <= 0.0).astype(np.int64)

    def tested(self, depth: int) -> list[Tested]:
        """Every candidate that gains anything, the one of greatest held-out gain first.

        ``depth`` is the number of effects named before.
        """
        out: dict[tuple[str, ...], Tested] = {}
        for option in self.model.options:
            rows = self.model.places_of(option)
            shown = rows[self._scale[rows - self.model.named] > 0.0]
            if len(shown) == 0:
                continue
            free = np.concatenate([self.found.free, shown])
            x = self.model.fit(self.found.runs, self.found.x, free)
            gain = self.model.loss(self.found, self.found.x) - self.model.loss(self.found, x)
            if gain < self.limits.reported_nats:
                continue
            losses = self.model.left_out(self.found, free)
            held_out = LogScoreDifference.of(self.before, losses, self.every)
            p = self._p(gain, x)
            one = Tested(option, x[rows], gain, losses, held_out, p, self._refusal(held_out, p, depth))
            key = (*option.names, *(f"{k[0]}.{k[1]}" for k, _ in option.sizes))
            if key not in out or losses.sum() < out[key].losses.sum():
                out[key] = one
        return sorted(out.values(), key=lambda t: float(t.losses.sum()))

    def chosen(self, found: Sequence[Tested]) -> tuple[Tested | None, tuple[Tested, ...]]:
        """The candidate to name, simplest of those that tie with the best; and all that tie with it."""
        passing = [t for t in found if not t.refusal]
        if not passing:
            return None, ()
        close = [t for t in passing if tied(passing[0].losses, t.losses, self.every, self.limits)]
        costs = [self.limits.tie_nats * len(t.option.sizes) for t in close]
        best = close[penalised_best(passing[0].losses, [t.losses for t in close], costs, self.every)]
        return best, tuple(t for t in found if t is best or tied(best.losses, t.losses, self.every, self.limits))

    def detection_limits(self) -> dict[str, float]:
        """By ``effect.parameter``, the size that gains `Thresholds.gain_nats` in the fit of all runs.

        Beside calibrations, which have their own intervals, what is named and the errors that all runs share; of
        several settings of its shapes the one that shows least. What no run shows is left out.
        """
        out: dict[str, float] = {}
        for j, (key, _) in enumerate(self.model.columns[self.model.named :]):
            if self._scale[j] > 0.0 and key not in self.model.point.own:
                width = np.sqrt(2.0 * self.limits.gain_nats) * self._scale[j] * scale_of(key)
                name = f"{key[0]}.{key[1]}"
                out[name] = max(out.get(name, 0.0), float(width ** parameter_of(key).power))
        return dict(sorted(out.items()))

    def judged_again(self, first: Tested, gain: float, gains: Floats, depth: int) -> Tested:
        """A candidate with its gains as runs linearised at its value have them, too.

        Runs linearised where it is nothing weigh down what its own signal throws off, and so promise too little of it;
        linearised at its value they promise too much: ``gain`` in the fit of all runs, ``gains`` (R,) of each left out.
        The mean of both is the difference of the log likelihoods themselves, to third order (trapezoid rule).
        """
        x = self.found.x.copy()
        x[self.model.places_of(first.option)] = first.sizes
        both = 0.5 * (self.before - first.losses + gains)
        held_out = LogScoreDifference.of(both, np.zeros_like(both), self.every)
        mean = 0.5 * (first.gain + gain)
        p = self._p(mean, x)
        return replace(first, gain=mean, held_out=held_out, p=p, refusal=self._refusal(held_out, p, depth))

    @functools.cached_property
    def _noise(self) -> Floats:
        """Best gains of normal noise, (draws,)."""
        seed = hashlib.sha256(np.round(self.found.x, 9).tobytes()).digest()
        return self._space(self.found.x).by_noise(np.random.default_rng(np.frombuffer(seed, dtype="<u4")))

    def _p(self, gain: float, x: Floats) -> float:
        """Probability that chance lets the best of all candidates gain so much; runs' scores are taken at ``x``."""
        by_runs = self._space(x).by_steps(
            self.every.astype(np.float64), np.arange(len(self.every)), np.random.default_rng(len(self.every))
        )
        return probability_of(gain, (self._noise, by_runs))

    def _refusal(self, gain: LogScoreDifference, p: float, depth: int) -> str:
        why = gain_refusal(gain, *required_gain(depth, self.limits), replicate="run")
        return why or chance_refusal(p, self.limits) or ""

    def _space(self, x: Floats) -> ScoreSpace:
        """Scores of each run at ``x``, less what calibrations follow, in units of their deviation."""
        prior, free, tried = self.model.prior, self.found.free, self._places
        # each run bears an equal part of the priors' pull: at the fit the runs' slopes then add up to none
        share = (prior.precision * (x - prior.mean))[free] / len(self.every)
        parts = np.empty((len(self.every), len(tried)))
        for i, run in enumerate(self.found.runs):
            slope = run.slope_at(x)
            parts[i] = slope[tried] - self._follow.T @ (slope[free] - share)
        first = self.model.named
        groups = [tuple(int(j) - first for j in self.model.places_of(o)) for o in self.model.options]
        return ScoreSpace.scaled(parts, self._information, self._whole, groups, self._signs)


def parameters_over_runs(
    model: Aligned, found: Population, days: Floats, limits: Thresholds, declared: Mapping[ParameterId, Prior]
) -> tuple[OverRuns, ...]:
    """Every parameter over the runs, named effects first, from the last pass.

    ``days`` are when each run began, (R,), see `days_since_first`; ``declared`` priors of calibrations before any run.
    """
    columns = model.columns[: model.named - len(PLACES)]
    # Bonferroni's share: so many parameters are tested for constancy
    level = limits.best_of_all_p / max(len(columns), 1)
    every = [_over_runs(model, found, i, key, days, level, declared.get(key)) for i, (key, _) in enumerate(columns)]
    return tuple(sorted(every, key=lambda x: x.kind != "effect"))


def systematics_of(model: Aligned, found: Population) -> tuple[Systematic, ...]:
    """The errors of the contact's edges that all runs share."""
    us = 1e6 * UNIT_S
    return tuple(
        Systematic(name, us * float(found.x[i]), us * found.sigma(i), us * float(model.prior.precision[i] ** -0.5))
        for i, name in enumerate(NAMES, start=model.named - len(PLACES))
    )


def _over_runs(
    model: Aligned, found: Population, place: int, key: ParameterId, days: Floats, level: float, declared: Prior | None
) -> OverRuns:
    """One parameter over the runs."""
    values, sigmas = each_on_its_own(model.runs, found, place)
    own = place < len(model.width)
    if own:
        # a calibration is seen where a run's own sigma is below its prior's: else the run only repeats the profile
        sigmas = np.where(sigmas < model.width[place], sigmas, np.inf)
    test = constancy(values, sigmas, days)
    effect = not own or model.prior.precision[place] == 0.0
    x, sigma = float(found.x[place]), found.sigma(place)
    spread = float(found.spread[place]) if own else test.spread
    slope = float(np.sign(test.slope)) * _in_unit(key, x, abs(test.slope))
    in_units = replace(
        test, spread=_in_unit(key, x, test.spread), slope=slope, slope_sigma=_in_unit(key, x, test.slope_sigma)
    )
    one = None  # the only run that shows a named effect
    if effect:
        stated = Prior(null_value_of(key), 0.0) if declared is None else declared
        one = one_run_alone(values, sigmas, coordinate_of(key, stated.mean), width_of(key, stated.sigma))
    if one is not None:
        sigma_of_others = _in_unit(key, one.others, one.others_sigma)
        one = replace(one, others=value_at(key, one.others), others_sigma=sigma_of_others)
    inside = [(value_at(key, float(v)), _in_unit(key, float(v), float(s))) for v, s in zip(values, sigmas, strict=True)]
    return OverRuns(
        *key, parameter_of(key).unit, "effect" if effect else "calibration", value_at(key, x), _in_unit(key, x, sigma),
        _in_unit(key, x, spread), tuple(v for v, _ in inside), tuple(s for _, s in inside),
        in_units, test.differs(level), one,
    )  # fmt: skip


def _in_unit(key: ParameterId, x: float, width: float) -> float:
    """A width about a coordinate, in the parameter's unit; infinite where it is."""
    if not np.isfinite(width):
        return float("inf")
    if parameter_of(key).power == 1.0:
        return width * parameter_of(key).scale
    # a coordinate that is a root of the value has no constant unit: half the interval's length
    return 0.5 * (value_at(key, x + width) - value_at(key, x - width))


def days_since_first(started: Sequence[str]) -> tuple[Floats, bool]:
    """Days from the first run to each start (ISO 8601), (R,), and whether they are known; else the runs' numbers."""
    try:
        starts = [datetime.fromisoformat(x) for x in started]
        seconds = np.array([(x - min(starts)).total_seconds() for x in starts])
    except (ValueError, TypeError):
        return np.arange(len(started), dtype=np.float64), False
    # two runs that began at one instant have wrong clocks: a trend with the date would mean nothing
    if len(set(seconds.tolist())) < len(seconds):
        return np.arange(len(started), dtype=np.float64), False
    return seconds / 86400.0, True
