"""What a ball does in the long run at one gamma: cycles, chaos, coexisting attractors.

A cycle with a reset is closed exactly (the threshold repeats); a locked cycle is the root of its
own equation (Newton) and stable by its multiplier; what is neither within `MAX_FLIGHTS` flights is called chaotic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from kernels.arrays import Bools, Floats
from kernels.errors import InputError
from model.flight.branches import TWO_PI
from model.orbits.cycles import repeating

MAX_FLIGHTS = 4096
FEW_FLIGHTS = 256  # tried first: most orbits have arrived by then
LONGEST_LOCKED = 64  # flights of the longest cycle without a reset that is looked for
NEAR = 0.2  # how closely the tail of an orbit repeats before Newton is tried, in phase
ARRIVED = 1e-6  # distance from a locked cycle at which an orbit has reached it
SLOW = 0.97  # a multiplier beyond which an orbit may still be on its way after `MAX_FLIGHTS`
CHAOS_SHOWN = 64  # flights shown of an orbit that never closes


Kind = Literal["periodic", "chattering", "chaotic"]


@dataclass(frozen=True)
class State:
    """A ball at the plate: folded phase, and speed off the plate (0: at rest), in units g/w."""

    phase: float = 0.0
    speed: float = 0.0


@dataclass(frozen=True)
class Path:
    """Flights one after another, arrays of equal length."""

    tau: Floats  # flight times, 1/w
    phase: Floats  # of take-offs, folded, radians
    speed: Floats  # of impacts, relative to the plate, g/w
    reset: Bools  # flights that start from rest
    chatter: Bools  # flights that are bounces of a completed chatter
    first: int  # where the cycle starts; -1 when nothing repeated
    periods: int  # its length in forcing periods
    last: State  # after the last flight


@dataclass(frozen=True)
class LockedCycle:
    """A cycle that never sticks: a root of ``T^n(x) = x``; ``start`` is the speed at take-off, ``speed`` at impact."""

    phase: Floats
    start: Floats
    tau: Floats
    speed: Floats
    periods: int
    multiplier: float
    """The Floquet multiplier largest in size (real part where complex)."""


def locked_cycle(flights: Floats, periods: int, multipliers: Iterable[complex]) -> LockedCycle:
    """The cycle of ``flights`` (4, n), entered at its smallest phase; rows: time, phase, impact and take-off speed."""
    largest = complex(max(multipliers, key=abs))
    size = largest.real if largest.imag == 0.0 else math.copysign(abs(largest), largest.real)
    phase = np.mod(flights[1], TWO_PI)
    turn = -int(np.argmin(phase))
    tau, phase, speed, start = (np.roll(row, turn) for row in (flights[0], phase, flights[2], flights[3]))
    return LockedCycle(phase, start, tau, speed, periods, size)


@dataclass(frozen=True)
class Attractor:
    """Where an orbit ends."""

    kind: Kind  # ``chattering``: a cycle in which an infinity of ever smaller bounces ends in rest
    period: int | None  # in forcing periods; None when chaotic
    flights: int  # of one cycle; chaotic: those shown
    resets: int  # how many of them start from rest
    locked: bool  # a cycle that never sticks
    # one cycle, from the reset flight on where there is one; the last `CHAOS_SHOWN` flights when chaotic
    tau: Floats  # flight times, 1/w
    phase: Floats  # of take-offs, radians
    speed: Floats  # of impacts, g/w
    multiplier: float | None  # Floquet's: 0 with a reset, None when chaotic
    last: State  # in which it was left, from which a sweep goes on

    @property
    def label(self) -> str:
        """For a person: which of the look-alikes it is."""
        if self.flights == 0:
            return "at rest on the plate"
        if self.kind == "chaotic":
            return "chaotic"
        how = "locked" if self.locked else f"with {'chatter' if self.kind == 'chattering' else 'reset'}"
        return f"{self.flights}-cycle {how}, period {self.period}"


class Ball(Protocol):
    """A ball on a plate of known tones, at any gamma."""

    def fly(self, gamma: float, start: State, max_flights: int) -> Path:
        """Fly from ``start`` until a threshold repeats or ``max_flights`` are flown; none when it never leaves."""
        ...

    def close(self, gamma: float, near: State, n: int) -> LockedCycle | None:
        """The cycle of ``n`` flights that never sticks nearest to ``near`` (just after an impact), if there is one."""
        ...


Close = Callable[[float, State, int], LockedCycle | None]
"""Maps (parameter, a state near, flights) to the locked cycle there."""


AT_REST = State()


def attractor(ball: Ball, gamma: float, start: State = AT_REST, max_flights: int = MAX_FLIGHTS) -> Attractor:
    """Where the orbit from ``start`` ends; raises `InputError` if gamma is negative or not finite."""
    if not (math.isfinite(gamma) and gamma >= 0.0):
        raise InputError(f"gamma must be finite and not negative, not {gamma}")
    none = np.empty(0)
    for flights in sorted({min(FEW_FLIGHTS, max_flights), max_flights}):
        path = ball.fly(gamma, start, flights)
        if path.tau.size == 0:
            return Attractor("periodic", 1, 0, 0, False, none, none, none, 0.0, path.last)
        if path.first >= 0:
            repeated = slice(path.first, None)
            reset = path.reset[repeated]
            # several resets: begin at the one with the smallest phase, so that the order does not depend on the start
            starts = np.flatnonzero(reset)
            shift = -int(starts[np.argmin(np.mod(path.phase[repeated][starts], TWO_PI))])
            tau, phase, speed = (np.roll(x[repeated], shift) for x in (path.tau, path.phase, path.speed))
            phase, resets = np.mod(phase, TWO_PI), int(reset.sum())
            kind: Kind = "chattering" if bool(path.chatter[repeated].any()) else "periodic"
            # a reset forgets where the ball came from: no shift survives it, the multiplier is 0
            return Attractor(kind, path.periods, tau.size, resets, False, tau, phase, speed, 0.0, path.last)
        cycle = _locked(ball, gamma, path)
        if cycle is not None:
            return Attractor(
                "periodic", cycle.periods, cycle.tau.size, 0, True, cycle.tau, cycle.phase, cycle.speed,
                cycle.multiplier, path.last,
            )  # fmt: skip
    tau, phase, speed = (x[-CHAOS_SHOWN:] for x in (path.tau, path.phase, path.speed))
    resets = int(path.reset[-CHAOS_SHOWN:].sum())
    return Attractor("chaotic", None, tau.size, resets, False, tau, phase, speed, None, path.last)


def _locked(ball: Ball, gamma: float, path: Path) -> LockedCycle | None:
    """The stable cycle to which the path tends, if it tends to one."""
    phase, speed = path.phase, path.speed
    for n in range(1, min(LONGEST_LOCKED, phase.size // 4) + 1):
        if not repeating(phase, speed, phase.size, n, NEAR):
            continue
        middle = phase.size // 2
        # an orbit that leaves an unstable cycle repeats worse at its end than in its middle
        late = _distance(phase[-1 - n], phase[-1]) + abs(speed[-1] - speed[-1 - n])
        early = _distance(phase[middle - n], phase[middle]) + abs(speed[middle] - speed[middle - n])
        cycle = ball.close(gamma, path.last, n) if late <= max(early, ARRIVED) else None
        cycle = cycle or _just_doubled(ball, gamma, path.last, n)
        if cycle is None or not abs(cycle.multiplier) < 1.0:
            continue
        off = min(_distance(p, phase[-1]) for p in cycle.phase)
        if off < ARRIVED or (abs(cycle.multiplier) > SLOW and off < NEAR):
            return cycle
    return None


def _just_doubled(ball: Ball, gamma: float, last: State, n: int) -> LockedCycle | None:
    """The cycle of ``n`` flights that has just parted from one of half as many.

    There an orbit comes or goes for longer than it is flown, and Newton falls back onto the unstable half: so the
    double is looked for at ever smaller and larger parts of the orbit's distance from the half.
    """
    half = ball.close(gamma, last, n // 2) if n % 2 == 0 else None
    # near a doubling an orbit goes so slowly to the new cycle that it looks like the old one, or like neither
    if half is None or not -1.1 < half.multiplier < -1.0:
        return None
    nearest = int(np.argmin([_distance(p, last.phase) for p in half.phase]))
    phase, speed = float(half.phase[nearest]), float(half.start[nearest])
    off = math.remainder(last.phase - phase, TWO_PI), last.speed - speed
    most = NEAR / max(abs(off[0]) + abs(off[1]), 1e-9)
    for part in most * 0.5 ** np.arange(24):
        cycle = ball.close(gamma, State(phase + part * off[0], max(speed + part * off[1], 0.0)), n)
        if cycle is not None and abs(cycle.multiplier) < 1.0:
            return cycle
    return None


def state_of(cycle: LockedCycle) -> State:
    """A state on the cycle, just after an impact."""
    return State(float(cycle.phase[0]), float(cycle.start[0]))


def doubling_near(close: Close, gamma: float, cycle: LockedCycle, reach: float) -> tuple[float, LockedCycle] | None:
    """Secant for ``multiplier = -1`` from ``gamma``, each cycle found from the one before."""
    n = cycle.tau.size
    here, old, last = gamma, gamma - 1e-6, None
    first = close(old, state_of(cycle), n)
    if first is None:
        return None
    miss_old = first.multiplier + 1.0
    for _ in range(60):
        new = close(here, state_of(last or first), n)
        if new is None or abs(here - gamma) > reach:
            return None
        last, miss = new, new.multiplier + 1.0
        if abs(miss) < 1e-12 or abs(here - old) < 1e-14:
            return here, new
        if miss == miss_old:  # the multiplier does not depend on gamma here: no doubling to be located
            return None
        old, miss_old, here = here, miss, here - miss * (here - old) / (miss - miss_old)
    return None


def _distance(phase: float, other: float) -> float:
    return abs(math.remainder(phase - other, TWO_PI))


def sweep(ball: Ball, gammas: Iterable[float], start: State = AT_REST) -> list[Attractor]:
    """Step through ``gammas`` in the order given, each from the state in which the one before was left."""
    found = []
    for gamma in gammas:
        found.append(attractor(ball, gamma, start))
        start = found[-1].last
    return found
