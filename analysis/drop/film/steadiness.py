"""Whether the camera stood still, by the ball: no fall accelerates sideways, and one floor has one height."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from analysis.drop.film.flights import LEAST_SAMPLES, Clip, Flight, jitter

Array = NDArray[np.float64]

_LEAST_WANDER_PX = 0.15
_WANDER_OF_JITTER = 3.0
_CHANCE = 1e-6
_LEAST_STEP = 0.005  # of the fall: no lens is better along it


def wander_of(clip: Clip, flights: Sequence[Flight]) -> tuple[float, float] | None:
    """Departure of the ball from even motion across its fall, rms over its flights, and its jitter; in pixels.

    None where the film shows by other things that the camera stood still, or nothing is known of the ball's place
    across.
    """
    if clip.watched or clip.across is None:
        return None
    squares: list[Array] = []
    noise: list[float] = []
    for flight in flights:
        inside = (clip.frame >= flight.frame[0]) & (clip.frame <= flight.frame[-1])
        frame, across = clip.frame[inside], clip.across[inside]
        if len(frame) < LEAST_SAMPLES + 2:
            continue
        left = across - np.polynomial.Polynomial.fit(frame, across, 1)(frame)
        squares.append(left**2 * len(frame) / (len(frame) - 2))
        noise.append(jitter(across))
    if not squares:
        return None
    return float(np.sqrt(np.concatenate(squares).mean())), float(np.median(noise))


def in_words(wander: tuple[float, float] | None) -> str | None:
    """What contradicts a camera at rest, where the ball wanders sideways far beyond its jitter."""
    if wander is None or wander[0] < max(_LEAST_WANDER_PX, _WANDER_OF_JITTER * wander[1]):
        return None
    return (
        f"the ball wanders sideways by {wander[0]:.2f} px within its flights, where places are good to "
        f"{wander[1]:.2f}: the camera moved, and nothing in the picture shows by how much; fix the camera, or let a "
        "floor or something with texture be seen"
    )


def floor_in_words(clip: NDArray[np.int64], floor: Array, draws: Array, fall: float) -> str | None:
    """What contradicts a floor at rest: impacts of one clip at heights that differ by far more than their errors.

    Parameters
    ----------
    clip, floor : (n,)
        Clip and height of each impact.
    draws : (m, n) float64
    fall : float
        Height of the fall, in the unit of ``floor``.
    """
    for number in np.unique(clip):
        own = (clip == number) & np.isfinite(floor)
        if own.sum() < 2:
            continue
        heights, sigma = floor[own], np.maximum(draws[:, own].std(axis=0), 1e-12)
        mean = float(np.average(heights, weights=sigma**-2.0))
        chance = float(stats.chi2.sf((((heights - mean) / sigma) ** 2).sum(), len(heights) - 1))
        if chance < _CHANCE and float(np.ptp(heights)) > _LEAST_STEP * fall:
            apart = 100.0 * float(np.ptp(heights)) / fall
            return (
                f"the impacts are at heights that differ by {apart:.1f} % of the fall, far more than their errors: the "
                "camera or the floor moved"
            )
    return None
