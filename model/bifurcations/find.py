"""The bifurcations of any ball in order: by the map's own equations where there are some, else by stepping gamma.

Decision 10.
"""

from __future__ import annotations

from model.bifurcations.events import NARROWEST, Bifurcation, bifurcations
from model.bifurcations.sweep import observed_bifurcations
from model.orbits.attractor import Ball
from model.orbits.exact_ball import FrictionBall, IdealBall

BOUNCING = 1e-3  # default with restitution: most gammas are chaotic there, and a search down to 1e-6 takes minutes


def find_bifurcations(
    ball: Ball, low: float, high: float, *, narrowest: float | None = None, sweep: str | None = None
) -> list[Bifurcation]:
    """Bifurcations between ``low`` and ``high`` of the attractor reached from rest, or carried along by ``sweep``.

    Parameters
    ----------
    narrowest
        Width in gamma of the narrowest window looked for; None: `NARROWEST`, with restitution `BOUNCING`. A sweep and
        an integrated ball are looked at step by step instead (`model.bifurcations.sweep`).

    Raises
    ------
    ValueError
        If the range is empty, negative or not finite.
    """
    if isinstance(ball, IdealBall | FrictionBall) and sweep is None:
        finest = narrowest if narrowest is not None else BOUNCING if ball.bounces else NARROWEST
        return bifurcations(ball, low, high, narrowest=finest)
    return observed_bifurcations(ball, low, high, sweep=sweep)
