"""Warnings about a recording: doubts about its instruments, uneven times, a sensor at its limit; no number changes."""

from __future__ import annotations

from analysis.plate.motion import PlateMotion
from daq.instrument.instrument import Instrument
from daq.recording import Recording


def plausibility_warnings(recording: Recording, plate: PlateMotion, instrument: Instrument | None) -> list[str]:
    """Warnings, one sentence each, about a recording whose plate motion is known."""
    found = []
    jitter = float(recording.attrs.get("jitter_s", 0.0)) * recording.rate_hz
    # an rms deviation of a sample from even sampling is worth a warning
    if jitter > 1.0:
        found.append(
            f"the file's times differ from {recording.rate_hz:.6g} samples/s by {jitter:.3g} samples rms, and samples "
            'are counted: "within one sample" is of the count, not of the times'
        )
    doubts = () if instrument is None else instrument.doubts
    return [*found, *(doubt.sentence for doubt in doubts), *plate.saturation_warnings()]
