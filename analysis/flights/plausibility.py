"""Warnings about a recording: instruments in doubt, uneven times, a sensor at its limit, events changed by hand."""

from __future__ import annotations

from analysis.flights.table import Flights
from daq.instrument.instrument import Instrument
from daq.recording import Recording
from daq.recording.event_changes import in_words


def plausibility_warnings(recording: Recording, flights: Flights, instrument: Instrument | None) -> list[str]:
    """Warnings, one sentence each, about a recording whose flights are known; no number changes."""
    found = []
    jitter = float(recording.attrs.get("jitter_s", 0.0)) * recording.rate_hz
    # an rms deviation of a sample from even sampling is worth a warning
    if jitter > 1.0:
        found.append(
            f"the file's times differ from {recording.rate_hz:.6g} samples/s by {jitter:.3g} samples rms, and samples "
            'are counted: "within one sample" is of the count, not of the times'
        )
    doubts = () if instrument is None else instrument.doubts
    odd = (*flights.plate.saturation_warnings(), *in_words(flights.edges.by_hand))
    return [*found, *(doubt.sentence for doubt in doubts), *odd]
