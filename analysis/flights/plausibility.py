"""What a person should know before believing an analysis: a plate that does not follow the drive, uneven times.

The rule kept here: a doubt is a sentence; it changes no number.
"""

from __future__ import annotations

import numpy as np

from analysis.plate.measure import PlateMotion
from daq.importers.diagnostics import GAMMAS, plate_warnings
from daq.recording import Recording

UNEVEN_SAMPLES = 1.0


def doubts(recording: Recording, plate: PlateMotion) -> list[str]:
    """Doubts about a recording whose plate motion is known."""
    said = []
    jitter = float(recording.attrs.get("jitter_s", 0.0)) * recording.rate_hz
    if jitter > UNEVEN_SAMPLES:
        said.append(
            f"the file's times differ from {recording.rate_hz:.6g} samples/s by {jitter:.3g} samples rms, and samples "
            'are counted: "within one sample" is of the count, not of the times'
        )
    steps = [s for s in plate.steps if s is not None]
    if "drive" in recording.channels and steps:
        rows = [(s.gamma_drive, s.gamma, s.gamma_uncertainty) for s in steps]
        said += plate_warnings(np.array(rows, [(name, np.float64) for name in GAMMAS]), recording.setup)
    return said
