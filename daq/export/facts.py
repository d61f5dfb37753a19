"""Facts of a recording that every exported file states, in plain numbers and texts; and the pieces that are written."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from daq.export.resample import Resampled
from daq.files.column_file import CHUNK_SAMPLES
from daq.recording.reader import Recording
from daq.setup.errors import InputError

STORED = (
    "started", "ended", "why", "note", "backend", "simulated", "software_version", "software_commit",
    "scenario_sha256", "imported_from", "setup_json", "profile_text", "extra_json",
)  # fmt: skip
EXTRA = "interchange"  # the extra of this package that brings the libraries
Progress = Callable[[int], None]


def facts(recording: Recording | Resampled) -> dict[str, str | float | int]:
    """Rate, provenance, profile, and lost samples as JSON pairs ``[first sample after, samples lost]``."""
    gaps = json.dumps(recording.gaps.tolist())
    out: dict[str, str | float | int] = {"source": "shakerbench recording"}
    out |= {"rate_hz": float(recording.rate_hz), "gaps_json": gaps}
    for name in STORED:
        if name in recording.stored:
            value = recording.stored[name]
            value = int(value) if isinstance(value, bool) else value
            out[name] = value if isinstance(value, (str, int, float)) else json.dumps(value)
    return out


def step_columns(recording: Recording | Resampled) -> dict[str, np.ndarray]:
    """Columns of the step table, by name."""
    steps = recording.steps
    return {name: np.ascontiguousarray(steps[name]) for name in steps.dtype.names or ()}


def pieces(n: int, rows: int = CHUNK_SAMPLES) -> list[tuple[int, int]]:
    """Ranges of samples that are read at once."""
    return [(a, min(a + rows, n)) for a in range(0, n, rows)]


def missing(package: str, form: str) -> InputError:
    """The error where a library is not installed."""
    return InputError(
        f"{form} needs the package {package}: pip install {package}, or pip install 'shakerbench[{EXTRA}]'"
    )
