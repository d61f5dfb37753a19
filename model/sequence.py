"""The bifurcations of any ball in order: by the map's own equations where there are some, else by what is seen.

The rule kept here: one call for every ball, so that the command line need not know which it has.
"""

from __future__ import annotations

from model.ball import IdealBall
from model.bifurcation import NARROWEST, Bifurcation, bifurcations
from model.orbit import Ball
from model.rough_ball import RoughBall


def sequence(
    ball: Ball, low: float, high: float, *, narrowest: float = NARROWEST, sweep: str | None = None
) -> list[Bifurcation]:
    """Bifurcations between ``low`` and ``high`` of the attractor reached from rest, or carried along by ``sweep``.

    Raises
    ------
    ValueError
        If the range is empty, negative or not finite.
    """
    if isinstance(ball, IdealBall | RoughBall) and sweep is None:
        return bifurcations(ball, low, high, narrowest=narrowest)
    raise ValueError("not yet")
