"""Events of a run on its page: those that were found, with their places in the scope, and changes by hand.

The scope's time counts lost samples, that of events does not (`daq.recording.reader.timestamps_ns`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.recording.event_changes import made_now
from daq.recording.notebook import Remarks, with_event
from kernels.arrays import Floats, Integers

if TYPE_CHECKING:
    from analysis.flights.table import Flights


def on_scope(time_s: Floats, gaps: Integers, rate_hz: float) -> Floats:
    """Times of events in the scope; ``gaps`` (n, 2) as of `daq.recording.Recording`."""
    lost = np.concatenate([[0], np.cumsum(gaps[:, 1])])
    return time_s + lost[np.searchsorted(gaps[:, 0], time_s * rate_hz, side="right")] / rate_hz


def on_recording(shown_s: float, gaps: Integers, rate_hz: float) -> float:
    """A time of the scope on the recording's axis; within a gap, its beginning."""
    before = np.concatenate([[0], np.cumsum(gaps[:, 1])])
    k = int(np.searchsorted(gaps[:, 0] + before[:-1], shown_s * rate_hz, side="right"))
    at_s = shown_s - before[k] / rate_hz
    return max(float(at_s), float(gaps[k - 1, 0]) / rate_hz) if k else float(at_s)


def events_of(flights: Flights, gaps: Integers, length_s: float) -> dict[str, list[Any]]:
    """Columns kind, at_s, shown_s and by_hand of all events in order; an impact within a flight is one event."""
    from analysis.flights.by_hand import given_by_hand
    from analysis.flights.table import FlightFlag

    rate_hz, heard = flights.plate.rate_hz, flights.has(FlightFlag.ACCELEROMETER)
    pause = np.append(flights.takeoff_s[1:], np.inf) - flights.landing_s
    impact = heard & np.append(heard[1:], False) & (pause * rate_hz < 1.0)
    takes_off = ~np.append(False, impact[:-1]) & (flights.takeoff_s > 0.0)
    lands = flights.landing_s < length_s
    kinds = np.where(impact, "impact", "landing")[lands]
    at_s = np.concatenate([flights.takeoff_s[takes_off], flights.landing_s[lands]])
    kind = np.concatenate([np.full(int(takes_off.sum()), "takeoff"), kinds])
    order = np.argsort(at_s, kind="stable")
    return {
        "kind": kind[order].tolist(), "at_s": np.round(at_s[order], 9).tolist(),
        "shown_s": np.round(on_scope(at_s[order], gaps, rate_hz), 9).tolist(),
        "by_hand": given_by_hand(at_s[order], flights.edges.by_hand).tolist(),
    }  # fmt: skip


def change_of(answer: dict[str, Any], recorded_s: Callable[[float], float]) -> Callable[[Remarks], Remarks]:
    """The change that a page asks for: ``undo``, or ``kind``, ``was_s`` and ``now_shown_s`` of an event.

    Raises `ValueError` or `KeyError` or `TypeError` or `InputError` where it asks for none.
    """
    if answer.get("undo") is True:
        return lambda now: with_event(now, None)
    was_s, shown_s = (None if answer[key] is None else float(answer[key]) for key in ("was_s", "now_shown_s"))
    change = made_now(answer["kind"], was_s, None if shown_s is None else round(recorded_s(shown_s), 9))
    return lambda now: with_event(now, change)
