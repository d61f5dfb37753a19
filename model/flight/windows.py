"""Where the plate throws a ball at rest: the table of window edges that the kernels take, with checked arguments."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from kernels.arrays import Floats
from model.flight import branches
from model.flight.precision import check_gamma, check_harmonics
from model.tones import Forcing


@lru_cache(maxsize=64)
def turning_points(forcing: Forcing) -> Floats:
    """Phases in [0, 2 pi) where the plate's jerk vanishes: gamma-independent, so computed once for each forcing.

    Raises `ValueError` if a harmonic is no integer.
    """
    if not forcing.periodic:
        raise ValueError(f"harmonics {forcing.harmonic} are not all integers: the motion has no period of 2 pi")
    if not forcing.moves:
        return np.empty(0)
    check_harmonics(forcing)
    return np.asarray(branches.turning_points(forcing.tones, 0.0, branches.TWO_PI))


def edges(forcing: Forcing, gamma: float) -> tuple[Floats, int]:
    """The kernels' table of window edges and their number (`model.flight.branches.fill_edges`).

    Raises `ValueError` if gamma is negative, not finite or too large (`model.flight.precision`), or the forcing not
    periodic.
    """
    check_gamma(forcing, gamma)
    turning = turning_points(forcing)
    table = np.zeros(turning.size + 2)
    return table, branches.fill_edges(forcing.tones, turning, gamma, table)
