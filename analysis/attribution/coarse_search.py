"""Where to begin a fit when landings are missed by far: grids and a simplex over what switches the ball's behaviour.

The rule kept here: whether a ball rebounds or rests, slides or hangs, is decided by a few parameters, and no slope
leads from one behaviour to another; so these are looked for over their whole range, jointly, on a thinned table of
events, before any local fit.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from analysis.attribution.fit import parameter_of
from analysis.residuals.forward_model import DRIFT, ForwardModel, ParameterId
from analysis.residuals.whitening import Whitener

Point = dict[ParameterId, float]

MOST_EVENTS = 300
MOST_STEPS_OF_SIMPLEX = 70
REBOUND = ("restitution", "e0")
FRICTION = (("coulomb_friction", "mu_up"), ("coulomb_friction", "mu_down"))
DIALS: tuple[tuple[tuple[ParameterId, ...], tuple[float, ...]], ...] = (
    ((REBOUND,), (0.03, 0.1, 0.17, 0.25, 0.32, 0.4, 0.46, 0.52, 0.6, 0.7, 0.8)),
    (FRICTION, (0.05, 0.12, 0.2, 0.3, 0.45)),
)
FIRST_PACE: Mapping[ParameterId, float] = {REBOUND: 0.03, **dict.fromkeys(FRICTION, 0.03)}  # of the simplex


def subsample(world: ForwardModel, train: NDArray[np.bool_], most: int = MOST_EVENTS) -> ForwardModel:
    """The same world with at most about ``most`` judged events, spread over the steps in ``train``."""
    ev = world.evidence
    judged = ev.judged & train[ev.measured.step]
    counts = np.bincount(ev.measured.step[judged], minlength=len(ev.steps))
    share = max(most // max(int(np.sum(counts > 0)), 1), 4)
    before: NDArray[np.int64] = np.cumsum(judged) - judged
    first = np.concatenate([[0], np.cumsum(counts)])[:-1]
    judged &= before - first[ev.measured.step] < share
    return ForwardModel(replace(ev, judged=judged, measured=replace(ev.measured, wanted=judged)), world.declared)


class CoarseSearch:
    """The loss as a function of a few parameters, each channel's excess at its best everywhere.

    Parameters
    ----------
    world
        Thinned.
    values
        The rest of the parameters, and where uncertainties are taken.
    train
        Steps that may be seen.
    """

    def __init__(self, world: ForwardModel, values: Mapping[ParameterId, float], train: NDArray[np.bool_]) -> None:
        self.world, self.values, self.train = world, dict(values), train
        self.whitener = Whitener.of(world, values)

    def loss(self, point: Mapping[ParameterId, float]) -> float:
        """Loss at the common values overridden by ``point``."""
        r = self.world.residuals({**self.values, **point})
        return self.whitener.profile_loss(r, self.world.evidence.plate, self.train)

    def lowest(self, points: Sequence[Point], count: int) -> list[tuple[float, Point]]:
        """The ``count`` best of several points, the best first."""
        return sorted(((self.loss(p), p) for p in points), key=lambda pair: pair[0])[:count]

    def descend(self, point: Point, keys: Sequence[ParameterId]) -> tuple[float, Point]:
        """Go down from ``point`` in ``keys`` (both frictions as one where they start alike), by a simplex."""
        groups = _groups(point, keys)
        if not groups:
            return self.loss(point), point
        bounds = [(parameter_of(g[0]).low, parameter_of(g[0]).high) for g in groups]
        start = np.array([point[g[0]] for g in groups])
        pace = np.array([FIRST_PACE.get(g[0], max(0.3 * abs(point[g[0]]), parameter_of(g[0]).typical)) for g in groups])
        low, high = np.array(bounds).T
        simplex = np.vstack([start, np.clip(start + np.diag(np.where(start + pace > high, -pace, pace)), low, high)])

        def at(x: NDArray[np.float64]) -> Point:
            return {**point, **{k: float(v) for g, v in zip(groups, x, strict=True) for k in g}}

        options: Any = {"initial_simplex": simplex, "maxfev": MOST_STEPS_OF_SIMPLEX, "xatol": 1e-5, "fatol": 0.5}
        found: Any = minimize(lambda x: self.loss(at(x)), start, method="Nelder-Mead", bounds=bounds, options=options)  # type: ignore[call-overload]
        return float(found.fun), at(found.x)


def _groups(point: Point, keys: Sequence[ParameterId]) -> list[tuple[ParameterId, ...]]:
    """Coordinates of the simplex: each key by itself, both directions of friction together where they are equal."""
    out: list[tuple[ParameterId, ...]] = []
    both = all(k in keys and k in point for k in FRICTION) and point[FRICTION[0]] == point[FRICTION[1]]
    for key in keys:
        if key[1].endswith(DRIFT) or key not in point or (both and key == FRICTION[1]):
            continue
        out.append(FRICTION if both and key == FRICTION[0] else (key,))
    return out


def joint_points(
    starts: Sequence[Mapping[ParameterId, float]], fresh: Sequence[ParameterId], chosen: Sequence[ParameterId]
) -> list[Point]:
    """A candidate's starting points, each with every setting of the dials that the chosen or fresh parameters hold."""
    grids: list[list[Point]] = [[{k: v for k, v in p.items() if k in fresh} for p in starts] or [{}]]
    for keys, settings in DIALS:
        if keys[0] in fresh:
            others = [p for p in grids[0] if all(k not in p for k in keys)]
            grids[0] = others + [{**p, **dict.fromkeys(keys, s)} for p in grids[0][:1] for s in settings]
        elif keys[0] in chosen:
            grids.append([{}, *(dict.fromkeys([k for k in keys if k in chosen], s) for s in settings)])
    return [{k: v for part in parts for k, v in part.items()} for parts in itertools.product(*grids)]
