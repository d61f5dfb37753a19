"""Accelerometer volts to what the plate really did: every tone of every step, against the drive.

The rule kept here: one pass over the recording serves plate and flights alike (`analysis.flights.scan`).
"""

from __future__ import annotations

from analysis.flights.scan import Progress, scan
from analysis.plate.motion import Line, PlateMotion, SlowMotion, StepPlate, Windows
from daq.recording import Recording

__all__ = ["Line", "PlateMotion", "SlowMotion", "StepPlate", "Windows", "plate_of"]


def plate_of(recording: Recording, *, progress: Progress | None = None) -> PlateMotion:
    """The plate in every step of a recording: see `analysis.plate.motion.StepPlate`."""
    return scan(recording, progress).plate
