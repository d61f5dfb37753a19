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
LONG_S, FEWEST_FLIGHTS = 5e-3, 10  # flights from rest that show a friction


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
) -> tuple[Floats, Floats]:
    """Mean push on the plate in each block for a ball of unit mass, upwards: of the contact and of impacts, (n,) each.

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
    rested = np.append(np.inf, takeoff_s[1:] - landing_s[:-1])
    bounced = rested < SHORTEST_REST_S
    takeoff_s = np.where(bounced, np.roll(landing_s, 1), takeoff_s)  # a contact stays closed for longer than it touches
    # the contact's share of each block, from the edges of all flights
    air = np.diff(np.interp(edges_s, np.ravel(np.column_stack([takeoff_s, landing_s])), _flown(landing_s - takeoff_s)))
    gained, back = _over_flights(felt, block_s, takeoff_s, landing_s)
    # A friction slows the ball on both ways: as much of it as brings flights from rest back to the plate.
    speed = np.where(bounced, back, 0.0)
    flight = np.clip(np.searchsorted(takeoff_s, edges_s[:-1] + 0.5 * block_s) - 1, 0, len(takeoff_s) - 1)
    fallen = np.append(0.0, np.cumsum(felt)) * block_s
    rising = speed[flight] + np.interp(takeoff_s, edges_s, fallen)[flight] > 0.5 * (fallen[1:] + fallen[:-1])
    slowing = np.where(rising, 1.0, -1.0) * air / block_s
    slowed, slowed_back = _over_flights(slowing, block_s, takeoff_s, landing_s)
    long = ~bounced & (landing_s - takeoff_s > LONG_S)
    if np.sum(long) >= FEWEST_FLIGHTS:
        friction = -float(np.median(back[long] / slowed_back[long]))
        gained, back = gained + friction * slowed, back + friction * slowed_back
    start = np.where(bounced, back, 0.0)
    impulse = gained - start + np.append(start[1:], 0.0)
    push = -felt * (1.0 - air / block_s)
    place = landing_s / block_s - 0.5  # centre of a block; an impulse between two centres is shared by both
    block = np.clip(np.floor(place).astype(np.int64), 0, n - 2)
    part = np.clip(place - block, 0.0, 1.0)
    impulses = np.zeros(n)
    np.add.at(impulses, block, -impulse * (1.0 - part) / block_s)
    np.add.at(impulses, block + 1, -impulse * part / block_s)
    return push, impulses


def _over_flights(rate: Floats, block_s: float, takeoff_s: Floats, landing_s: Floats) -> tuple[Floats, Floats]:
    """Integral of a rate (n,) over each flight, and the mean of it over the flight, (m,) each."""
    edges_s = np.arange(len(rate) + 1) * block_s
    once = np.append(0.0, np.cumsum(rate)) * block_s
    twice = np.append(0.0, np.cumsum(0.5 * (once[1:] + once[:-1]))) * block_s
    begun = np.interp(takeoff_s, edges_s, once)
    path = np.interp(landing_s, edges_s, twice) - np.interp(takeoff_s, edges_s, twice)
    return np.interp(landing_s, edges_s, once) - begun, path / (landing_s - takeoff_s) - begun


def _flown(length_s: Floats) -> Floats:
    """Time in the air until each take-off and landing, (2 m,)."""
    ends = np.cumsum(length_s)
    return np.ravel(np.column_stack([ends - length_s, ends]))
