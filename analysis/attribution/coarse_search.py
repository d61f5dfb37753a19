"""Coarse search of the profile likelihood: a grid, then a simplex, on a subsample of events.

A few parameters decide whether a ball rebounds or rests, slides or hangs, and no slope leads from one behaviour to
another. So these are tried over their whole range, jointly, before any local fit.

References
----------
J. A. Nelder and R. Mead, Comput. J. 7, 308 (1965): the simplex.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from analysis.attribution.candidates import Point, parameter_of
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.values import TREND, ParameterId
from kernels.arrays import Bools, Floats, Integers
from model.effects.registry import effect, registry


@functools.cache
def coarse_grids() -> tuple[tuple[tuple[ParameterId, ...], tuple[float, ...]], ...]:
    """Parameters that switch the ball's behaviour, with their grids: single ones, then groups of tied ones."""
    groups: dict[tuple[ParameterId, ...], tuple[float, ...]] = {}
    for r in registry():
        for q in r.effect.parameters:
            if q.coarse_grid:
                groups[_tied_with((r.effect.name, q.name))] = q.coarse_grid
    return tuple(sorted(groups.items(), key=lambda item: len(item[0])))


def _tied_with(key: ParameterId) -> tuple[ParameterId, ...]:
    """The parameters that are one number with ``key`` in the simplest case."""
    name, q = key
    groups = effect(name).effect.tied.values()
    return next((tuple((name, x) for x in group) for group in groups if q in group), (key,))


def subsample(model: ForwardModel, train: Bools, most: int = 120) -> ForwardModel:
    """The same model with at most about ``most`` scored events, spread over the steps in ``train``."""
    observations = model.observations
    scored = observations.scored & train[observations.measured.step]
    counts = np.bincount(observations.measured.step[scored], minlength=len(observations.steps))
    # at least four events of each step: a step of none would leave its gamma out of the search
    share = max(most // max(int(np.sum(counts > 0)), 1), 4)
    before: Integers = np.cumsum(scored) - scored
    first = np.concatenate([[0], np.cumsum(counts)])[:-1]
    scored &= before - first[observations.measured.step] < share
    few = replace(observations, scored=scored, measured=replace(observations.measured, wanted=scored))
    return ForwardModel(few, model.declared, like=model)


class CoarseSearch:
    """Profile loss as a function of a few parameters, each channel's excess noise at its best everywhere.

    Parameters
    ----------
    model
        A subsample.
    values
        The rest of the parameters, and where uncertainties are taken.
    train
        Steps that may be used, shape (m,).
    near
        Weights of all events at almost these values.
    """

    def __init__(
        self, model: ForwardModel, values: Mapping[ParameterId, float], train: Bools, near: Whitener | None = None
    ) -> None:
        self.model, self.values, self.train = model, dict(values), train
        self.whitener = Whitener.of(model, values, near)
        self.plate_noise = model.observations.plate.noise(train)

    def loss(self, point: Mapping[ParameterId, float]) -> float:
        """Loss at the common values overridden by ``point``."""
        r = self.model.residuals({**self.values, **point})
        return self.whitener.profile_loss(r, self.train, self.plate_noise)

    def lowest(self, axes: Sequence[Sequence[Point]], *, jointly: bool) -> tuple[float, Point]:
        """The lowest loss found over settings along several axes, see `axes_of`, and its point.

        ``jointly`` tries every combination. Else the two best points of the first axis go along the others one after
        another, and where these have led elsewhere, its other points are tried there: a sum of settings, no product.
        """
        if jointly:
            return self._best_of(
                [{k: v for part in parts for k, v in part.items()} for parts in itertools.product(*axes)]
            )
        first, *others = axes
        tried = sorted(((self.loss(p), p) for p in first), key=lambda pair: pair[0])
        found = tried[:2]
        for axis in others:
            ways = [[x, self._best_of([{**x[1], **s} for s in axis[1:]])] for x in found]
            found = [min(pair, key=lambda seen: seen[0]) for pair in ways]
        best = min(found, key=lambda pair: pair[0])
        if best in tried:
            return best
        moved = {k: v for k, v in best[1].items() if any(k in s for axis in others for s in axis)}
        return min(best, self._best_of([{**p, **moved} for p in first]), key=lambda pair: pair[0])

    def _best_of(self, points: Sequence[Point]) -> tuple[float, Point]:
        """The lowest loss of several points, and its point."""
        return min(((self.loss(p), p) for p in points), key=lambda pair: pair[0])

    def minimise(self, point: Point, keys: Sequence[ParameterId]) -> tuple[float, Point]:
        """Loss and place of the minimum near ``point`` in ``keys``; tied parameters that start equal stay equal."""
        groups = _groups(point, keys)
        if not groups:
            return self.loss(point), point
        parameters = [parameter_of(g[0]) for g in groups]
        start = np.array([point[g[0]] for g in groups])
        # a parameter at 0 begins with its scale: 30 % of nothing would leave the simplex flat
        step = np.array([q.coarse_step or max(0.3 * abs(x), q.scale) for q, x in zip(parameters, start, strict=True)])
        bounds = [(q.low, q.high) for q in parameters]
        low, high = np.array(bounds).T
        simplex = np.vstack([start, np.clip(start + np.diag(np.where(start + step > high, -step, step)), low, high)])

        def at(x: Floats) -> Point:
            return {**point, **{k: float(v) for g, v in zip(groups, x, strict=True) for k in g}}

        # 70 predictions at most: a full fit goes on from where the simplex ends
        options: Any = {"initial_simplex": simplex, "maxfev": 70, "xatol": 1e-5, "fatol": 0.5}
        found: Any = minimize(lambda x: self.loss(at(x)), start, method="Nelder-Mead", bounds=bounds, options=options)  # type: ignore[call-overload]
        return float(found.fun), at(found.x)


def _groups(point: Point, keys: Sequence[ParameterId]) -> list[tuple[ParameterId, ...]]:
    """Coordinates of the simplex: each key by itself, tied parameters together where they are equal."""
    out: list[tuple[ParameterId, ...]] = []
    for key in keys:
        # the frequency of a modulation was measured, and each other one is a motion of the plate anew
        if key[1].endswith(TREND) or key not in point or parameter_of(key).hint == "modulation_hz":
            continue
        group = _tied_with(key)
        equal = all(k in keys and point.get(k) == point[key] for k in group)
        if equal and key != group[0]:
            continue
        out.append(group if equal else (key,))
    return out


def axes_of(
    starts: Sequence[Mapping[ParameterId, float]], fresh: Sequence[ParameterId], chosen: Sequence[ParameterId]
) -> list[list[Point]]:
    """A candidate's starting points, its own coarse grid among them; then of each group of chosen ones its settings."""
    axes: list[list[Point]] = [[{k: v for k, v in p.items() if k in fresh} for p in starts] or [{}]]
    for keys, settings in coarse_grids():
        if keys[0] in fresh:
            others = [p for p in axes[0] if all(k not in p for k in keys)]
            axes[0] = others + [{**p, **dict.fromkeys(keys, s)} for p in axes[0][:1] for s in settings]
        elif keys[0] in chosen:
            axes.append([{}, *(dict.fromkeys([k for k in keys if k in chosen], s) for s in settings)])
    return axes
