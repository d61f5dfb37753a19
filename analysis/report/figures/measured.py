"""A recording as its figures take it: with flights, comparison and closed loop."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.flights.compare import Comparison, compare
from analysis.flights.table import Flights
from analysis.loop.result import ClosedLoop
from daq.recording import Recording


@dataclass(frozen=True)
class Measured:
    """An open recording and what was made of it."""

    recording: Recording  # open
    flights: Flights
    compared: Comparison | None = None  # with the model; None where no flight was seen
    loop: ClosedLoop | None = None  # None where the loop was not closed


def measured(
    recording: Recording, flights: Flights, compared: Comparison | None = None, loop: ClosedLoop | None = None
) -> Measured:
    """A recording with its flights, compared with the declared model unless ``compared`` is given."""
    if compared is None and len(flights):
        compared = compare(flights, recording.setup, steps_table=recording.steps)
    return Measured(recording, flights, compared, loop)
