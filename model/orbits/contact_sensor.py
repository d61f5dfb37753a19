"""What the instrument sees: exact take-offs and landings turned into what a sampled contact circuit shows of them.

Of ideal flights on a ramp a quarter end in a contact shorter than one sample at 20 kHz, because the ball is launched
again where it lands; model and measurement must be compared like with like. A flight is never
dropped silently. Every visible flight says which exact flights it holds, and every hidden one is listed.

The circuit opens when the ball is `contact_gap` above the plate (so later than the take-off), closes at the landing,
stays closed for at least `closure_s` after an impact, may bounce meanwhile, and is read once a sample; a level that
lasts less than `dead_time_s` is not believed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kernels.arrays import Bools, Floats, Integers


@dataclass(frozen=True)
class Instrument:
    """A continuity channel.

    Parameters
    ----------
    rate_hz : float
        Samples a second.
    dead_time_s : float
        A new level is believed when it has lasted so long, and dated to its beginning (debounce).
    closure_s : float
        The shortest time the circuit stays closed after an impact (0-1 ms), even when the ball leaves at once.
    bounce_s : float
        For so long after an impact the circuit may open once more by itself, at random.

    Raises
    ------
    ValueError
        If the rate is not positive or a time negative.
    """

    rate_hz: float = 20000.0
    dead_time_s: float = 0.0
    closure_s: float = 0.0
    bounce_s: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what has no meaning."""
        times = (self.dead_time_s, self.closure_s, self.bounce_s)
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0 and all(0 <= t < math.inf for t in times)):
            raise ValueError(f"rate_hz must be positive and every time not negative, not {self}")


@dataclass(frozen=True)
class Observed:
    """Visible flights, arrays of equal length, in order.

    ``takeoff_s`` and ``landing_s`` are the times of the first open and the first closed sample; ``first`` and ``last``
    the exact flights at whose take-off the circuit opened and at whose landing it closed (both -1 for a false flight,
    a bounce of the contact). ``hidden`` lists every exact flight that is not the one and only content of a visible
    flight: merged with a neighbour, or never seen open.
    """

    takeoff_s: Floats
    landing_s: Floats
    first: Integers
    last: Integers
    hidden: Integers

    @property
    def merged(self) -> Bools:
        """Which visible flights hold more than one exact flight."""
        return np.asarray(self.last > self.first)


def observe(
    takeoff_s: ArrayLike,
    landing_s: ArrayLike,
    instrument: Instrument,
    *,
    opening_delay_s: ArrayLike = 0.0,
    rng: np.random.Generator | None = None,
) -> Observed:
    """What ``instrument`` shows of the exact flights.

    Parameters
    ----------
    takeoff_s, landing_s : array_like, shape (n,)
        Exact events, ascending: ``takeoff_s[i] <= landing_s[i] <= takeoff_s[i + 1]``.
    instrument : Instrument
    opening_delay_s : array_like, broadcast to (n,)
        Time from each take-off until the circuit opens.
    rng : Generator, optional
        Needed when the contact bounces.

    Raises
    ------
    ValueError
        If the events are not in order, or the contact bounces and there is no ``rng``.
    """
    takeoff = np.asarray(takeoff_s, dtype=np.float64)
    landing = np.asarray(landing_s, dtype=np.float64)
    if takeoff.ndim != 1 or takeoff.shape != landing.shape:
        raise ValueError(f"takeoff_s and landing_s must be equal in shape (n,), not {takeoff.shape}, {landing.shape}")
    if not (np.all(landing >= takeoff) and np.all(takeoff[1:] >= landing[:-1])):
        raise ValueError("events must be in order: takeoff_s[i] <= landing_s[i] <= takeoff_s[i + 1]")
    if instrument.bounce_s > 0.0 and rng is None:
        raise ValueError("a bouncing contact is random: pass rng")
    opens = takeoff + np.broadcast_to(np.asarray(opening_delay_s, dtype=np.float64), takeoff.shape)
    opens[1:] = np.maximum(opens[1:], landing[:-1] + instrument.closure_s)
    times, flight = _edges(opens, landing, instrument, rng)
    exact = times * instrument.rate_hz
    samples = np.ceil(exact - 4e-16 * np.abs(exact)).astype(np.int64)  # an event on a sample belongs to it
    # debounce: an edge counts where its level lasts for the dead time and is another one than before
    lasts = np.append(np.diff(samples) >= max(round(instrument.dead_time_s * instrument.rate_hz), 1), True)
    edges = np.flatnonzero(lasts)
    kind = edges % 2  # 0: an opening
    edges = edges[kind != np.concatenate([[1], kind[:-1]])]
    edges = edges[: edges.size // 2 * 2]  # a flight that has not ended is not shown
    at, of = samples[edges] / instrument.rate_hz, flight[edges]
    first, last = of[::2], of[1::2]
    false = (first < 0) & (last < 0)
    first, last = np.where(first < 0, last, first), np.where(last < 0, first, last)
    single = first[(first == last) & ~false]
    hidden = np.setdiff1d(np.arange(takeoff.size), single)
    return Observed(at[::2], at[1::2], np.where(false, -1, first), np.where(false, -1, last), hidden)


def _edges(
    opens: Floats, landing: Floats, instrument: Instrument, rng: np.random.Generator | None
) -> tuple[Floats, Integers]:
    """Times of alternating openings and closings, and the exact flight of each (-1: a bounce)."""
    seen = opens < landing  # a flight too low for the gap, or too short for the closure, never opens
    index = np.flatnonzero(seen)
    times = np.column_stack([opens[seen], landing[seen]]).ravel()
    flight = np.repeat(index, 2)
    if instrument.bounce_s > 0.0 and rng is not None:
        inside = np.sort(rng.uniform(0.0, instrument.bounce_s, (index.size, 2)), axis=1) + landing[seen][:, None]
        following = np.append(opens[seen][1:], np.inf)
        fits = inside[:, 1] < following
        times = np.concatenate([times, inside[fits].ravel()])
        flight = np.concatenate([flight, np.full(2 * int(fits.sum()), -1)])
        order = np.argsort(times, kind="stable")
        times, flight = times[order], flight[order]
    return times, flight
