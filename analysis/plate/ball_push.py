"""What the ball does to the plate, per ball mass, from recorded volts: its weight and inertia, and its impacts.

Over a flight the relative velocity falls by ``I``, the integral of ``g + a``; from ``v_start`` it comes to the impact
speed ``I - v_start``. The displacement of the whole flight is zero, so ``v_start`` is the double integral of ``g + a``
over the flight's length; after a rest it is 0. An impact's impulse is the impact speed plus ``v_start`` of the flight
that follows at once. No model of the ball enters.
"""

from __future__ import annotations

import numpy as np

from kernels.arrays import Bools, Floats

SHORTEST_REST_S = 1.2e-3  # after a shorter contact the ball left as it landed


def filled_after_impacts(acceleration_mps2: Floats, known: Bools) -> Floats:
    """The acceleration (n,) with a line through the blocks that impacts hide: their rings and pulses push no ball."""
    out, rows = acceleration_mps2.copy(), np.flatnonzero(known)
    hidden = np.flatnonzero(~known)
    if not len(rows) or not len(hidden):
        return out
    out[hidden] = np.interp(hidden, rows, acceleration_mps2[rows])
    return out


def ball_push(
    acceleration_mps2: Floats, block_s: float, takeoff_s: Floats, landing_s: Floats, gravity_mps2: float
) -> tuple[Floats, float]:
    """Mean push on the plate in each block, (n,), m/s^2, upwards, for a ball of unit mass; the sum of impulses, m/s.

    Parameters
    ----------
    acceleration_mps2
        Of the plate, block means (n,).
    block_s
        Length of a block.
    takeoff_s, landing_s
        Of the flights (m,), in order.
    gravity_mps2
        Of the place.
    """
    n, felt = len(acceleration_mps2), gravity_mps2 + acceleration_mps2
    edges_s = np.arange(n + 1) * block_s
    once = np.append(0.0, np.cumsum(felt)) * block_s
    twice = np.append(0.0, np.cumsum(0.5 * (once[1:] + once[:-1]))) * block_s

    def at(integral: Floats, time_s: Floats) -> Floats:
        return np.interp(time_s, edges_s, integral)

    length_s = landing_s - takeoff_s
    gained = at(once, landing_s) - at(once, takeoff_s)
    start = (at(twice, landing_s) - at(twice, takeoff_s)) / length_s - at(once, takeoff_s)
    rested = np.append(np.inf, takeoff_s[1:] - landing_s[:-1])
    start = np.where(rested < SHORTEST_REST_S, start, 0.0)
    impulse = gained - start + np.append(start[1:], 0.0)
    # while it flies the ball pushes nothing: contact's share of each block from the edges of all flights
    air = np.interp(edges_s, np.ravel(np.column_stack([takeoff_s, landing_s])), _flown(length_s))
    push = -felt * (1.0 - np.diff(air) / block_s)
    place = landing_s / block_s - 0.5  # centre of a block; an impulse between two centres is shared by both
    block = np.clip(np.floor(place).astype(np.int64), 0, n - 2)
    part = np.clip(place - block, 0.0, 1.0)
    np.add.at(push, block, -impulse * (1.0 - part) / block_s)
    np.add.at(push, block + 1, -impulse * part / block_s)
    return push, float(np.sum(impulse))


def _flown(length_s: Floats) -> Floats:
    """Time in the air until each take-off and landing, (2 m,)."""
    ends = np.cumsum(length_s)
    return np.ravel(np.column_stack([ends - length_s, ends]))
