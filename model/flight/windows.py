"""Where the plate throws a ball at rest, and up to which amplitude double precision proves a landing.

A flight from rest lasts at most ``T = 2 gamma N`` (in 1/w), ``N = sum n_j b_j``, because the plate throws no faster
than ``gamma N``. Its height is computed with an error of at most `ROUNDING` times the sizes of its terms,
``gamma N T + T^2 = 6 (gamma N)^2``. Divided by an impact speed of ``gamma N`` that leaves the landing phase uncertain
by ``6 ROUNDING gamma N``; `docs/results/kernels.md` has the errors measured against 60 digits. Decision 106.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from kernels.arrays import Floats
from kernels.errors import InputError
from model.flight import branches
from model.flight.segment import ROUNDING
from model.tones import Forcing

PROVEN_PHASE = 1e-9
"""Largest uncertainty of a landing phase, radians: the last digit that is printed."""
LARGEST_ANGLE = 1e6
"""Up to which `model.flight.numerics.sincos` is proven; a phase of the n-th harmonic goes up to ``4 pi n``."""
MOST_WINDOWS = 20_000
"""Take-off windows that one flight may pass over: a few milliseconds."""


def check_harmonics(forcing: Forcing) -> None:
    """Refuse tones whose phases are beyond the proven sine.

    Raises `InputError` with the largest harmonic that is proven.
    """
    most = math.floor(LARGEST_ANGLE / (4.0 * math.pi))
    if max(forcing.harmonic, default=0.0) > most:
        raise InputError(
            f"c = {max(forcing.harmonic):g} is beyond what double precision proves: the sine of a phase is proven up "
            f"to {LARGEST_ANGLE:g} rad, which is c = {most}"
        )


@lru_cache(maxsize=64)
def largest_gamma(forcing: Forcing) -> float:
    """The largest gamma at which landings are proven, and flights short enough to be walked through."""
    if not forcing.moves:
        return math.inf
    speed = sum(n * abs(b) for n, b in zip(forcing.harmonic, forcing.amplitude, strict=True))
    error = 6.0 * ROUNDING * speed
    if error == 0.0:  # tones too small for a double
        return math.inf
    proven = PROVEN_PHASE / error
    return min(proven, _walked(forcing, speed))


def _walked(forcing: Forcing, speed: float) -> float:
    """The gamma at which a flight passes `MOST_WINDOWS` windows, at most one for each cycle of the fastest tone."""
    return MOST_WINDOWS * math.pi / (speed * max(1.0, *forcing.harmonic))


def check_gamma(forcing: Forcing, gamma: ArrayLike, lengthening: ArrayLike = 1.0) -> None:
    """Refuse amplitudes without meaning, or beyond `largest_gamma`.

    Raises `InputError` for a gamma that is negative, not finite or too large.

    ``lengthening`` is how much longer than the ideal ball's the flights can be (`lengthened`), one number or as
    ``gamma``.
    """
    if not (np.all(np.isfinite(gamma)) and np.all(np.asarray(gamma) >= 0)):
        raise InputError(f"gamma must be finite and not negative, not {gamma!r}")
    check_harmonics(forcing)
    most = largest_gamma(forcing) / float(np.max(lengthening, initial=1.0))
    largest = float(np.max(gamma, initial=0.0))
    if largest > most:
        speed = sum(n * abs(b) for n, b in zip(forcing.harmonic, forcing.amplitude, strict=True))
        why = (
            f"a flight would pass more than {MOST_WINDOWS} take-off windows"
            if _walked(forcing, speed) == largest_gamma(forcing)
            else f"rounding would leave the landing phase uncertain by more than {PROVEN_PHASE:g} rad"
        )
        raise InputError(
            f"gamma = {largest:g} is beyond what double precision proves on this plate: {why}; the largest is "
            f"{most:.4g}"
        )


def lengthened(mu_down: ArrayLike, e0: ArrayLike) -> Floats:
    """How much longer flights get by friction on the way down, and by bounces that add to one another.

    Friction leaves a pull of ``1 - mu_down``. With restitution ``e`` a launch is at most ``e v + (1 + e) gamma N``
    after an impact at ``v``, so speeds stay below ``(1 + e) / (1 - e)`` times the plate's.
    """
    # beyond 0.99 speeds are taken to grow no further: the bound has a pole at 1
    e = np.clip(np.asarray(e0, dtype=np.float64), 0.0, 0.99)
    return np.asarray((1.0 + e) / ((1.0 - e) * (1.0 - np.asarray(mu_down, dtype=np.float64))))


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

    Raises `ValueError` if gamma is negative, not finite or too large (`model.flight.windows`), or the forcing not
    periodic.
    """
    check_gamma(forcing, gamma)
    turning = turning_points(forcing)
    table = np.zeros(turning.size + 2)
    return table, branches.fill_edges(forcing.tones, turning, gamma, table)
