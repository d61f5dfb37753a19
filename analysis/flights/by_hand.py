"""Contact edges and impacts as a person corrected them.

A change names an event by its time; the nearest one of its kind is meant. After it the contact circuit still opens and
closes by turns: of edges that follow one of their own kind the first counts. So a landing that is removed joins
two flights into one, unless the accelerometer shows its impact, which then splits them; a take-off that is removed
takes its flight away. Without a contact circuit there are no flights, and changes have no effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from analysis.events.crossings import CLOSES, OPENS
from analysis.events.edges import Edges
from analysis.events.impact_detection import Impacts
from analysis.statistics import nearest
from daq.recording.event_changes import EventChange
from kernels.arrays import Bools, Floats

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
