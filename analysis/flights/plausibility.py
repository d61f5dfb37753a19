"""Warnings about a recording: a plate that does not follow the drive, uneven sample times. They change no number."""

from __future__ import annotations

import numpy as np

from analysis.plate.motion import PlateMotion
from daq.importers.diagnostics import GAMMAS, plate_warnings
from daq.recording import Recording

UNEVEN_SAMPLES = 1.0  # rms deviation of the file's times from even sampling, in samples, that is worth a warning


def plausibility_warnings(recording: Recording, plate: PlateMotion) -> list[str]:
    """Warnings, one sentence each, about a recording whose plate motion is known."""
    found = []
    jitter = float(recording.attrs.get("jitter_s", 0.0)) * recording.rate_hz
    if jitter > UNEVEN_SAMPLES:
        found.append(
            f"the file's times differ from {recording.rate_hz:.6g} samples/s by {jitter:.3g} samples rms, and samples "
            'are counted: "within one sample" is of the count, not of the times'
        )
    steps = [s for s in plate.steps if s is not None]
    if "drive" in recording.channels and steps:
        rows = [(s.gamma_drive, s.gamma, s.gamma_uncertainty) for s in steps]
        found += plate_warnings(np.array(rows, [(name, np.float64) for name in GAMMAS]), recording.setup)
    return [*found, *plate.saturation_warnings()]
