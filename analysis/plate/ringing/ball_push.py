"""What the ball does to the plate, per ball mass, from recorded volts: its weight and inertia, and its impacts.

Over a flight the relative velocity falls by ``I``, the integral of ``g + a``; from ``v_start`` it comes to the impact
speed ``I - v_start``. The displacement of the whole flight is zero, so ``v_start`` is the double integral of ``g + a``
over the flight's length; after a rest it is 0. An impact's impulse is the impact speed plus ``v_start`` of the flight
that follows at once. No model of the ball enters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from kernels.arrays import Bools, Floats, Integers

SHORTEST_REST_S = 1.2e-3  # after a shorter contact the ball left as it landed
LONG_S, FEWEST_FLIGHTS = 5e-3, 10  # flights from rest that show a friction and an accelerometer that is late
# friction (m/s^2) and lateness (s), where flights of one length leave open which of both it is
USUAL = np.array([1.0, 1e-4])
LEAST_SPREAD_MPS = 1e-6  # of flights without noise


@dataclass(frozen=True)
class Push:
    """Push on the plate for a ball of unit mass, upwards."""

    contact_mps2: Floats  # of the ball that lies on it, mean in each block, (n,)
    impact_s: Floats  # of the impacts as the accelerometer shows them, in order, (m,)
    impulse_mps: Floats  # of the same, (m,)
    block_s: float  # length of a block
    late_s: float = 0.0  # by so much the accelerometer shows what happens too late
    rise_mps2: Floats | float = 0.0  # change of the contact's push over the length of each block, (n,)
    missed_mps: float = np.inf  # median speed by which flights from rest miss the plate; none where they are too few
    stays: bool = False  # whether the ball that lands stays there: it leaves at once only as the plate falls away
    rubbed_mps2: Floats | float = 0.0  # of the rod, which the flying ball drags along, mean in each block, (n,)

    @property
    def impacts_mps2(self) -> Floats:
        """Mean push of the impacts in each block, (n,); one between two centres of blocks is shared by both."""
        n = len(self.contact_mps2)
        place = self.impact_s / self.block_s - 0.5
        block = np.clip(np.floor(place).astype(np.int64), 0, n - 2)
        part = np.clip(place - block, 0.0, 1.0)
        out = np.zeros(n)
        np.add.at(out, block, self.impulse_mps * (1.0 - part) / self.block_s)
        np.add.at(out, block + 1, self.impulse_mps * part / self.block_s)
        return out


def filled_after_impacts(acceleration_mps2: Floats, known: Bools) -> Floats:
    """The acceleration (n,) with a line through the blocks that impacts hide: their rings and pulses push no ball."""
    out, rows = acceleration_mps2.copy(), np.flatnonzero(known)
    hidden = np.flatnonzero(~known)
    if not len(rows) or not len(hidden):
        return out
    out[hidden] = np.interp(hidden, rows, acceleration_mps2[rows])
    return out


def ball_push(
    acceleration_mps2: Floats, block_s: float, takeoff_s: Floats, landing_s: Floats, gravity_mps2: float,
    mass_ratio: float = 0.0, before: Push | None = None,
) -> Push:  # fmt: skip
    """What the ball does to the plate while it lies on it, and at each landing.

    Parameters
    ----------
    acceleration_mps2, block_s
        Of the plate, means (n,) of blocks of that length.
    takeoff_s, landing_s
        Of the flights (m,), in order.
    gravity_mps2, mass_ratio
        Of the place; of the ball and what moves under it: with the ball on it the plate accelerates by so much less.
    before
        The push from an acceleration that was known less well; how late the accelerometer is, and whether the ball
        bounces, go on from there.
    """
    late_s, stays = (0.0, False) if before is None else (before.late_s, before.stays)
    felt, edges_s = gravity_mps2 + acceleration_mps2, np.arange(len(acceleration_mps2) + 1) * block_s
    bounced, landed_s = np.append(np.inf, takeoff_s[1:] - landing_s[:-1]) < SHORTEST_REST_S, landing_s
    # a contact stays closed for longer than it touches; a ball that does not bounce leaves where nothing presses it
    presses = np.interp(np.roll(landing_s, 1) + late_s, edges_s[:-1] + 0.5 * block_s, felt) > 0.0
    takeoff_s = np.where(bounced & ~(presses & stays), np.roll(landing_s, 1), takeoff_s)
    takeoff_s, landing_s = takeoff_s + late_s, landing_s + late_s
    length_s = landing_s - takeoff_s
    flight = np.clip(np.searchsorted(takeoff_s, edges_s, side="right") - 1, 0, len(takeoff_s) - 1)
    until_s = np.clip(edges_s, takeoff_s[flight], landing_s[flight])
    air = np.diff((np.cumsum(length_s) - length_s)[flight] + until_s - takeoff_s[flight]) / block_s
    # Impacts keep to a phase: what blocks blur would add up, the jump of the plate that is suddenly loaded above all.
    free = felt / (air + (1.0 - air) / (1.0 + mass_ratio))
    # velocity at the blocks' edges is exact, as blocks are means; the spline keeps it there
    once = CubicSpline(edges_s, np.append(0.0, np.cumsum(free)) * block_s)
    twice = once.antiderivative()
    begun = once(takeoff_s)
    gained, back = once(landing_s) - begun, (twice(landing_s) - twice(takeoff_s)) / length_s - begun
    flown = (np.cumsum(gained) - gained)[flight] + once(until_s) - begun[flight]
    inside = np.clip(np.searchsorted(takeoff_s, edges_s[:-1] + 0.5 * block_s) - 1, 0, len(takeoff_s) - 1)
    free_mps = (back * (bounced & (not stays)) + begun)[inside] - once(np.stack([edges_s[:-1], edges_s[1:]]))
    long, friction, rate, missed_mps = ~bounced & (length_s > LONG_S), 0.0, np.zeros_like(air), np.inf
    if np.sum(long) >= FEWEST_FLIGHTS:
        slowed_mps = np.zeros_like(free_mps)
        for _ in range(2):  # a friction slows the ball on both ways, and lets it turn round earlier
            ball_mps = free_mps - friction * slowed_mps
            rate = air * np.sum(ball_mps, axis=0) / np.maximum(np.sum(np.abs(ball_mps), axis=0), LEAST_SPREAD_MPS)
            slowed, slowed_back, slowed_mps = _over_flights(rate, block_s, takeoff_s, landing_s, inside)
            friction, later_s = _missed(back[long], slowed_back[long], (gained / length_s)[long])
        late_s, begun_s, ended_s = late_s + later_s, takeoff_s + later_s, landing_s + later_s
        gained = once(ended_s) - once(begun_s) + friction * slowed
        back = (twice(ended_s) - twice(begun_s)) / length_s - once(begun_s) + friction * slowed_back
        missed_mps = float(np.median(np.abs(back[long])))
    if np.sum(left := bounced & ~presses) >= FEWEST_FLIGHTS:
        stays = bool(np.median(back[left]) < 0.005 * np.median(gained[left]))  # slower than that is no bounce
    start = back * (bounced & (not stays))
    # what changes at an impact is the speed over the plate, which recoils
    loaded = 1.0 + mass_ratio
    pressed = -np.diff(once(edges_s) - flown) / block_s / loaded
    rise = -(1.0 - air) * once(edges_s[:-1] + 0.5 * block_s, 2) * block_s / loaded
    impulse = -(gained - start + np.append(start[1:], 0.0)) / loaded
    return Push(pressed, landed_s + late_s, impulse, block_s, late_s, rise, missed_mps, stays, friction * rate)


def _missed(back_mps: Floats, slowed_back: Floats, closing_mps2: Floats) -> tuple[float, float]:
    """Friction (m/s^2) and lateness (s) of the accelerometer that bring flights from rest (n,) back to the plate.

    By ``back_mps`` each would have had to start to come back. A friction takes ``slowed_back`` times itself from that;
    a late accelerometer has not shown the end of a flight yet, in which the ball comes closer by ``closing_mps2`` times
    the lateness and the flight's length.
    """
    spread_mps = 1.5 * float(np.median(np.abs(back_mps - np.median(back_mps)))) + LEAST_SPREAD_MPS
    missed = np.column_stack([slowed_back, closing_mps2])

    def left(x: Floats) -> Floats:
        return np.append((back_mps + missed @ x) / spread_mps, x / USUAL)

    found = least_squares(left, np.zeros(2), loss="soft_l1", x_scale=USUAL).x
    return float(found[0]), float(found[1])


def _over_flights(
    rate: Floats, block_s: float, takeoff_s: Floats, landing_s: Floats, flight: Integers
) -> tuple[Floats, Floats, Floats]:
    """Integral of a rate (n,) over each flight, the mean of it over the flight, (m,) each; so far in blocks, (2, n)."""
    edges_s = np.arange(len(rate) + 1) * block_s
    once = np.append(0.0, np.cumsum(rate)) * block_s
    twice = np.append(0.0, np.cumsum(0.5 * (once[1:] + once[:-1]))) * block_s
    begun = np.interp(takeoff_s, edges_s, once)
    path = np.interp(landing_s, edges_s, twice) - np.interp(takeoff_s, edges_s, twice)
    so_far = np.stack([once[:-1], once[1:]]) - begun[flight]
    return np.interp(landing_s, edges_s, once) - begun, path / (landing_s - takeoff_s) - begun, so_far
