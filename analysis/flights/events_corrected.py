"""Events that the table of flights takes otherwise than found: impacts denied by the contact circuit, changes by hand.

An impact is denied where the circuit reads open and the ball was high above the plate: a knock on the bench, a glitch
of the converter or what a template leaves of a table's ringing looks like one. The flight around it decides: what turns
a ball that is high above the plate is strong; and no ball leaves more slowly than the plate, as it must have done
before a knock in mid-flight. What friction does to a flight stays below what is taken for a contradiction. Decisions
296 and 554.

A change by hand names an event by its time; the nearest one of its kind is meant. After it the contact circuit still
opens and closes by turns: of edges that follow one of their own kind the first counts. So a landing that is removed
joins two flights into one, unless the accelerometer shows its impact, which then splits them; a take-off that is
removed takes its flight away. Without a contact circuit there are no flights, and changes have no effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from analysis.events.edges import Edges
from analysis.events.impact_detection import Impacts
from analysis.events.levels import CLOSES, OPENS
from analysis.plate.motion import PlateMotion
from analysis.statistics import nearest
from daq.recording.notebook import EventChange
from kernels.arrays import Bools, Floats, Integers

StepsOf = Callable[[Floats, Floats], tuple[Integers, Bools]]
"""Step of each flight by its begin and end, -1 where that is of none, and whether the plate has settled there."""

TOO_WEAK = 4.0  # speed that an impact must have changed over the one that it shows, from which it is none
REST_S = 3e-4  # contact after which a ball is at rest on the plate
FRICTION = 0.1  # error of a speed where friction acts, as a part of a free flight's


class _Flight(NamedTuple):
    """A flight and a time between its ends, (m,) each."""

    begin_s: Floats
    time_s: Floats
    end_s: Floats


def undenied(
    plate: PlateMotion,
    g_mps2: float,
    steps_of: StepsOf,
    in_air: tuple[Floats, Floats, Bools],
    impacts: Impacts,
    reach_s: float,
    late_s: float,
) -> Impacts:
    """Impacts but those within an interval in the air that the contact circuit and the motion deny.

    ``in_air``: begin and end of the intervals, and which may be judged, (n,) each. An impact within ``reach_s`` of an
    end belongs to it. The plate's motion is ``late_s`` behind the contact's edges.
    """
    takeoff_s, landing_s, judged = in_air
    if takeoff_s.size == 0 or impacts.time_s.size == 0:
        return impacts
    host = np.searchsorted(takeoff_s, impacts.time_s - reach_s) - 1
    own = np.flatnonzero((host >= 0) & (impacts.time_s < landing_s[host] - reach_s) & judged[host])
    time_s, strength = impacts.time_s[own], impacts.strength[own]
    doubtful = denied(
        plate, g_mps2, steps_of, takeoff_s + late_s, landing_s + late_s, time_s + late_s, strength, host[own]
    )
    believed = np.ones(impacts.time_s.size, dtype=np.bool_)
    believed[own] = ~doubtful | np.isnan(strength)  # a person's has no strength
    columns = {name: getattr(impacts, name)[believed] for name in ("time_s", "uncertainty_s", "strength")}
    return replace(impacts, **columns)


def denied(
    plate: PlateMotion,
    g_mps2: float,
    steps_of: StepsOf,
    takeoff_s: Floats,
    landing_s: Floats,
    impact_s: Floats,
    strength: Floats,
    host: Integers,
) -> Bools:
    """Whether the flight that an impact would end did not end there.

    Shape (m,).

    Parameters
    ----------
    plate : PlateMotion
    g_mps2 : float
        Local gravity.
    steps_of : callable
    takeoff_s, landing_s : arrays, shape (n,)
        Intervals in the air by the contact circuit.
    impact_s, strength : arrays, shape (m,)
        Impacts within intervals, in order; the strength is NaN where it is not known.
    host : int array, shape (m,)
        The interval of each impact.
    """

    def flights(left: Integers) -> tuple[_Flight, Bools]:
        """The flights that the impacts ``left`` end, and whether each begins with its interval."""
        own, time_s = host[left], impact_s[left]
        first, last = np.diff(own, prepend=-1) != 0, np.diff(own, append=-1) != 0
        begin_s = np.where(first, takeoff_s[own], np.roll(time_s, 1))
        return _Flight(begin_s, time_s, np.where(last, landing_s[own], np.roll(time_s, -1))), first

    left = np.arange(impact_s.size)
    shown_mps = strength * _speed_of_strength(plate, g_mps2, steps_of, flights(left)[0], strength)
    rested = takeoff_s - np.append(-np.inf, landing_s[:-1]) > REST_S
    for weak in (True, False):  # what is too weak first: it would cut the flights of those after it
        while left.size:
            (flight, first), own = flights(left), host[left]
            step, settled = steps_of(flight.begin_s, flight.end_s)
            # a flight from one step into the next is of neither: the plate moves as between the two
            before, after = (np.where(step < 0, steps_of(x, x)[0], step) for x in (flight.begin_s, flight.end_s))
            lacks = [
                _lack(plate, g_mps2, k, flight, shown_mps[left]) if weak
                else _slowness(plate, g_mps2, k, flight, first & rested[own])
                for k in (before, after - (~settled & (step >= 0)))
            ]  # fmt: skip
            lack = np.nan_to_num(np.minimum(*lacks))  # a plate that settles moves as between the two
            order = np.lexsort((-lack if weak else left, own))
            order = order[lack[order] > 0.0]
            # only one of an interval, the worst or the first: without it, the others may be right
            gone = order[np.diff(own[order], prepend=-1) != 0]
            if not gone.size:
                break
            left = np.delete(left, gone)
    out = np.ones(impact_s.size, dtype=np.bool_)
    out[left] = False
    return out


def _speed_of_strength(
    plate: PlateMotion, g_mps2: float, steps_of: StepsOf, flight: _Flight, strength: Floats
) -> float:
    """Speed in m/s of a landing whose impact has strength 1, by the stronger half; NaN where too few show it."""
    step, settled = steps_of(flight.begin_s, flight.time_s)
    at_m, plate_mps, _ = _plate(plate, step, flight.time_s)
    lasted_s, rise_m = flight.time_s - flight.begin_s, at_m - _plate(plate, step, flight.begin_s)[0]
    speed = (plate_mps - rise_m / lasted_s + 0.5 * g_mps2 * lasted_s) / strength
    own = settled & np.isfinite(speed)
    strong = speed[own][strength[own] >= np.median(strength[own])] if own.any() else speed[own]
    return float(np.median(strong)) if strong.size >= 8 else float("nan")


def _plate(plate: PlateMotion, step: Integers, time_s: Floats) -> tuple[Floats, Floats, Floats]:
    """Place, m, velocity, m/s, and acceleration, m/s^2, of the plate; NaN where a step is -1 or was not fitted.

    A table's ringing below the forcing is in it: 7 cm/s of it were seen. Place and velocity may drift.
    """
    omega, z = plate.forcing_tones(step)
    own = z * np.exp(1j * omega * plate.true_time_s(time_s))
    turn = np.where(np.nan_to_num(omega) == 0.0, 1.0, 1j * omega)
    out = np.array([(own / turn**k).real.sum(axis=0) for k in (2, 1, 0)])
    for k in np.unique(step[np.isfinite(omega[0])]):
        at = step == k
        out[:, at] += [slow(time_s[at]) for slow in plate.steps[k].slow.path]
    return out[0], out[1], out[2]


def _lack(plate: PlateMotion, g_mps2: float, step: Integers, flight: _Flight, shown_mps: Floats) -> Floats:
    """Speed by which an impact in a flight is too weak, m/s; at most 0 where it is not.

    A ball that flew from the beginning to the end passed the time at a height. One that met the plate there instead was
    turned by that height over each of the two times of flight.
    """
    before_s, after_s = flight.time_s - flight.begin_s, flight.end_s - flight.time_s
    whole_s = before_s + after_s
    begin, at, end = (_plate(plate, step, time_s)[0] for time_s in flight)
    height = 0.5 * g_mps2 * before_s * after_s + (begin * after_s + end * before_s) / whole_s - at
    turned_mps = height * whole_s / np.maximum(before_s * after_s, 1e-12)
    return np.asarray(turned_mps - TOO_WEAK * shown_mps - FRICTION * 0.5 * g_mps2 * whole_s)


def _slowness(plate: PlateMotion, g_mps2: float, step: Integers, flight: _Flight, rested: Bools) -> Floats:
    """Speed by which a flight that ended at an impact began too slowly, m/s; at most 0 where it did not.

    Where the flight would have begun slowly even if it went on to its end, something else is wrong. A ball at rest left
    as the plate fell away, whatever held it back: while the plate falls away faster still, it does not come back.
    """
    begin_m, leaves_mps, begin_mps2 = _plate(plate, step, flight.begin_s)
    pull_mps2 = np.maximum(g_mps2, -begin_mps2)
    quarter_s = 0.5 * np.pi / plate.forcing_tones(step)[0][0]
    falls = (_plate(plate, step, flight.time_s)[2] < -pull_mps2) & (flight.time_s - flight.begin_s < quarter_s)
    rested = rested & falls
    pull_mps2 = np.where(rested, pull_mps2, g_mps2)

    def start_mps(end_s: Floats) -> Floats:
        """Velocity of a free flight to ``end_s`` at its start, relative to the plate."""
        lasted_s = np.maximum(end_s - flight.begin_s, 1e-9)
        rise_m = _plate(plate, step, end_s)[0] - begin_m
        return np.asarray(rise_m / lasted_s + 0.5 * pull_mps2 * lasted_s - leaves_mps)

    usual = 0.5 * g_mps2 * (flight.time_s - flight.begin_s)
    whole = -2.0 * start_mps(flight.end_s)
    # a friction of 0.5 g makes 0.1 of a free flight's; a plate known to some percent errs by less than 3 cm/s
    least = np.where(rested, np.maximum(0.0, whole - 0.03), np.maximum(np.maximum(0.3 * usual, 0.03), whole))
    return np.asarray(-start_mps(flight.time_s) - least)


NEAR_S = 1e-3  # an event that another version of the search finds, or finds with another corner, lies within this


def changed_edges(edges: Edges, changes: Sequence[EventChange], *, starts_open: bool, rate_hz: float) -> Edges:
    """Contact edges with the changes put in; a time given by hand is good to a sample."""
    if not any(one.kind in ("takeoff", "landing") for one in changes):
        return edges
    parts = []
    for name, kind in (("takeoff", OPENS), ("landing", CLOSES)):
        own = np.flatnonzero(edges.kind == kind)
        stay, given_s = _changed(edges.time_s[own], [one for one in changes if one.kind == name])
        sigma_s = np.full(given_s.size, 1.0 / rate_hz)
        parts.append((edges.time_s[own[stay]], edges.uncertainty_s[own[stay]], np.full(int(stay.sum()), kind, np.int8)))
        parts.append((given_s, sigma_s, np.full(given_s.size, kind, np.int8)))
    time_s, sigma_s, kinds = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(time_s, kind="stable")
    before = np.append(np.int8(OPENS if starts_open else CLOSES), kinds[order][:-1])
    turns = order[kinds[order] != before]
    return Edges(time_s[turns], sigma_s[turns], kinds[turns])


def changed_impacts(impacts: Impacts, changes: Sequence[EventChange], rate_hz: float) -> Impacts:
    """Impacts with the changes put in; one given by hand has no strength (NaN) and is good to a sample."""
    own = [one for one in changes if one.kind == "impact"]
    if not own:
        return impacts
    stay, given_s = _changed(impacts.time_s, own)
    time_s = np.concatenate([impacts.time_s[stay], given_s])
    sigma_s = np.concatenate([impacts.uncertainty_s[stay], np.full(given_s.size, 1.0 / rate_hz)])
    strength = np.concatenate([impacts.strength[stay], np.full(given_s.size, np.nan)])
    order = np.argsort(time_s, kind="stable")
    return replace(impacts, time_s=time_s[order], uncertainty_s=sigma_s[order], strength=strength[order])


def given_by_hand(time_s: Floats, changes: Sequence[EventChange]) -> Bools:
    """Which events stand where a person put them."""
    return np.isin(time_s, [one.now_s for one in changes if one.now_s is not None])


def _changed(time_s: Floats, changes: Sequence[EventChange]) -> tuple[Bools, Floats]:
    """Which of the events found stay, and times that a person gave, in order."""
    stay, given_s = np.ones(time_s.size, dtype=np.bool_), list[float]()
    for one in changes:
        if one.was_s is not None:
            # to a microsecond: it may be a time that a person gave
            again = next((t for t in given_s if abs(t - one.was_s) < 1e-6), None)
            left = np.flatnonzero(stay)
            if again is not None:
                given_s.remove(again)
            elif left.size:
                meant = left[nearest(time_s[left], np.array([one.was_s]))[0]]
                stay[meant] = abs(time_s[meant] - one.was_s) > NEAR_S
        if one.now_s is not None:
            given_s.append(one.now_s)
    return stay, np.sort(np.array(given_s))
