"""Impacts within intervals in the air: those that turned the ball are believed, and those that cannot have are not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from analysis.flights.events_corrected import denied
from analysis.plate.motion import SlowMotion
from kernels.arrays import Bools, Floats, Integers

G, OMEGA, GAMMA = 9.81, 2.0 * np.pi * 27.3, 1.6
DT_S, NO_REBOUND_MPS = 1e-5, 1e-2
RINGS_RADPS = 2.0 * np.pi * 6.3


def marched(
    restitution: float, friction: float, seconds: float = 1.2, rings_mps2: float = 0.0
) -> tuple[Floats, Floats]:
    """Intervals without rest (n, 2), and the impacts within and at their ends (m, 2), time and change of speed."""
    height = speed = begin = 0.0
    resting = True
    intervals, impacts = [], []
    for i in range(int(seconds / DT_S)):
        t = i * DT_S
        free = -G + GAMMA * G * np.sin(OMEGA * t) - rings_mps2 * np.sin(RINGS_RADPS * t)
        if resting and free <= friction * G:
            continue
        if resting:
            resting, begin = False, t
        speed += (free - np.sign(speed or 1.0) * friction * G) * DT_S
        height += speed * DT_S
        if height < 0.0:
            impacts.append((t, -(1.0 + restitution) * speed))
            height, speed = 0.0, -restitution * speed
            if speed < NO_REBOUND_MPS and free <= friction * G:
                resting, speed = True, 0.0
                intervals.append((begin, t))
    return np.array(intervals), np.array(impacts)


def within(intervals: Floats, impacts: Floats) -> tuple[Floats, Integers]:
    """The impacts between the ends of an interval, and the interval of each."""
    host = np.searchsorted(intervals[:, 0], impacts[:, 0]) - 1
    own = (host < len(intervals)) & (impacts[:, 0] < intervals[host.clip(0, len(intervals) - 1), 1])
    return impacts[own], host[own]


def on_plate(
    intervals: Floats, impacts: Floats, host: Integers, rings_mps2: float = 0.0, across_s: float = np.inf
) -> Bools:
    """Which impacts are denied on a plate of one tone, a table's ringing below it, and another step after some time."""
    slow_s = np.arange(0.0, intervals[-1, 1], 9e-3)
    plate: Any = SimpleNamespace(
        true_time_s=lambda t: t,
        forcing_tones=lambda step: (np.where(step < 0, np.nan, OMEGA)[None], np.full((1, step.size), GAMMA * G * 1j)),
        steps=[SimpleNamespace(slow=SlowMotion(slow_s, rings_mps2 * np.sin(RINGS_RADPS * slow_s)))],
    )
    return denied(
        plate, G,
        lambda begin, end: (np.where((begin > across_s) & (begin < end), -1, 0), np.ones(begin.size, np.bool_)),
        intervals[:, 0], intervals[:, 1], impacts[:, 0], 5000.0 * impacts[:, 1], host,
    )  # fmt: skip


@pytest.mark.parametrize("friction", [0.0, 0.15])
def test_a_rebound_on_a_table_that_rings_is_believed(friction: float) -> None:
    """A ringing of 15 cm/s, which no tone of a step shows, makes no landing one that the ball left too slowly for."""
    intervals, impacts = marched(0.5, friction, 2.0, rings_mps2=6.0)
    true, host = within(intervals, impacts)
    assert len(true) >= 20
    assert not on_plate(intervals, true, host, 6.0).any()


@pytest.mark.parametrize("across_s", [np.inf, 0.6])
@pytest.mark.parametrize("friction", [0.0, 0.15])
@pytest.mark.parametrize("restitution", [0.25, 0.5])
def test_what_is_left_of_ringing_cuts_no_flight_and_a_rebound_does(
    restitution: float, friction: float, across_s: float
) -> None:
    """Bounces that the circuit does not show, and a thousandth to a hundredth of them in between: only these go, also
    in flights from one step into the next."""
    intervals, impacts = marched(restitution, friction)
    rng = np.random.default_rng(5)
    true, host = within(intervals, impacts)
    events = np.sort(np.concatenate([intervals.ravel(), true[:, 0]]))
    flights = np.column_stack([events[:-1], events[1:]])
    inside = (
        np.searchsorted(intervals[:, 1], flights[:, 0], "right") == np.searchsorted(intervals[:, 0], events[1:]) - 1
    )
    flights = flights[inside & (events[1:] - events[:-1] > 8e-3)]
    left = np.column_stack([
        flights[:, 0] + rng.uniform(1e-3, 4e-3, len(flights)),
        np.median(impacts[:, 1]) * rng.uniform(1e-3, 1e-2, len(flights)),
    ])  # fmt: skip
    every = np.concatenate([true, left])
    order = np.argsort(every[:, 0])
    host = np.searchsorted(intervals[:, 0], every[order, 0]) - 1
    found = on_plate(intervals, every[order], host, across_s=across_s)
    assert len(true) >= 20 and len(left) >= 20
    np.testing.assert_array_equal(found, order >= len(true))


@pytest.mark.parametrize("friction", [0.0, 0.15])
def test_no_impact_is_believed_just_after_a_ball_at_rest_has_left(friction: float) -> None:
    """A quarter of a millisecond after it leaves a plate that falls away ever faster no ball meets it again."""
    intervals, impacts = marched(0.0, friction)
    long = np.flatnonzero(intervals[:, 1] - intervals[:, 0] > 8e-3)
    left = np.column_stack([intervals[long, 0] + 2.5e-4, np.full(len(long), 1e-3 * np.median(impacts[:, 1]))])
    assert len(long) >= 10
    assert on_plate(intervals, left, long).all()
