"""What an exported file says of its recording beside the samples, in plain numbers and texts."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from daq.export.resample import Resampled
from daq.recording.reader import Recording
from daq.setup.errors import InputError

KEPT = (
    "started", "ended", "why", "note", "backend", "simulated", "software_version", "software_commit",
    "scenario_sha256", "imported_from", "setup_json", "profile_text", "extra_json",
)  # fmt: skip
EXTRA = "interchange"  # the extra of this package that brings the libraries


def facts(recording: Recording | Resampled) -> dict[str, str | float | int]:
    """Rate, provenance, profile, and lost samples as JSON pairs ``[first sample after, samples lost]``."""
    stored = recording.stored
    kept = {name: _plain(stored[name]) for name in KEPT if name in stored}
    gaps = json.dumps(recording.gaps.tolist())
    return {"source": "shakerbench recording", "rate_hz": float(recording.rate_hz), "gaps_json": gaps, **kept}


def _plain(value: Any) -> str | float | int:
    if isinstance(value, bool):
        return int(value)
    return value if isinstance(value, (str, int, float)) else json.dumps(value)


def step_columns(recording: Recording | Resampled) -> dict[str, np.ndarray]:
    """Columns of the step table, by name."""
    steps = recording.steps
    return {name: np.ascontiguousarray(steps[name]) for name in steps.dtype.names or ()}


def missing(package: str, form: str) -> InputError:
    """The error where a library is not installed."""
    return InputError(
        f"{form} needs the package {package}: pip install {package}, or pip install 'shakerbench[{EXTRA}]'"
    )
