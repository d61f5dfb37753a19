"""Summaries of all runs in one set of coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.attribution.candidates import coordinate_of, parameter_of, scale_of
from analysis.attribution.chance import Place
from analysis.joint.population import Prior, Quadratic
from analysis.joint.summary import Option, Point, RunSummary
from analysis.joint.systematics import PLACES
from kernels.arrays import Floats, Integers


@dataclass(frozen=True)
class Aligned:
    """All runs in the same coordinates: each run's own parameters first (q), then shared ones, systematic errors that
    all runs share, and candidates.
    """

    point: Point
    columns: tuple[Place, ...]  # what each coordinate stands for, K in all
    options: tuple[Option, ...]  # candidates that at least half of the runs can show
    runs: tuple[Quadratic, ...]  # a quadratic each; what a run cannot show has no information
    prior: Prior  # of means and shared parameters
    width: Floats  # of the priors of what runs have their own values of, (q,)
    low: Floats  # least values of the coordinates, (K,)
    high: Floats  # largest ones, (K,)

    @property
    def named(self) -> int:
        """Number of coordinates before the candidates'."""
        return len(self.point.own) + len(self.point.shared) + len(PLACES)

    def places_of(self, option: Option) -> Integers:
        """Columns of a candidate."""
        return self.named + np.array([self.columns[self.named :].index(s) for s in option.sizes], dtype=np.int64)


def aligned(summaries: Sequence[RunSummary], point: Point, released: frozenset[str]) -> Aligned:
    """All runs in the same coordinates.

    All summaries are at ``point``; ``released`` effects were named: the mean of what they set has no prior.
    """
    counts: dict[Option, int] = {}
    for run in summaries:
        for option in run.options:
            counts[option] = counts.get(option, 0) + 1
    options = tuple(o for o, n in counts.items() if 2 * n >= len(summaries))
    own, shared = point.own, tuple(sorted(point.shared))
    columns = (*((k, ()) for k in (*own, *shared)), *PLACES, *dict.fromkeys(s for o in options for s in o.sizes))
    mean, precision = np.zeros(len(columns)), np.zeros(len(columns))
    width = np.array([width_of(key, point.priors[key].sigma) for key in own])
    for i, key in enumerate(own):
        mean[i] = coordinate_of(key, point.priors[key].mean)
        precision[i] = 0.0 if key[0] in released else width[i] ** -2.0
    first, named = len(own) + len(shared), len(own) + len(shared) + len(PLACES)
    sigma = np.max([run.systematic_sigma for run in summaries], axis=0)
    # a systematic error of a narrower prior is none
    precision[first:named] = np.maximum(sigma, 1e-3) ** -2.0
    bounds = [
        (-np.inf, np.inf)
        if place in PLACES
        else (coordinate_of(place[0], parameter_of(place[0]).low), coordinate_of(place[0], parameter_of(place[0]).high))
        for place in columns
    ]
    runs = tuple(_on(run, columns, named) for run in summaries)
    low, high = np.array(bounds).reshape(-1, 2).T
    return Aligned(point, columns, options, runs, Prior(mean, precision), width, low, high)


def width_of(key: tuple[str, str], sigma: float) -> float:
    """Standard deviation of a parameter's prior in coordinates."""
    return float(sigma ** (1.0 / parameter_of(key).power)) / scale_of(key)


def _on(run: RunSummary, columns: Sequence[Place], named: int) -> Quadratic:
    """A run's quadratic on the common columns; those that are named stand in the same place in every run."""
    known = {place: j for j, place in enumerate(run.columns[named:], start=named)}
    mine = np.array([j for j, place in enumerate(columns) if j < named or place in known], dtype=np.int64)
    theirs = np.array([j if j < named else known[columns[j]] for j in mine], dtype=np.int64)
    k, old = len(columns), run.quadratic
    origin = np.zeros(k)
    origin[mine] = old.origin[theirs]
    gradient, information = np.zeros(k), np.zeros((k, k))
    gradient[mine] = old.gradient[theirs]
    information[np.ix_(mine, mine)] = old.information[np.ix_(theirs, theirs)]
    return Quadratic(origin, gradient, information)
