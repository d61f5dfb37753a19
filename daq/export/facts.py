"""What every exported file holds: columns, facts in plain numbers and texts, and the pieces that are written."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.export.resample import Resampled
from daq.files.column_file import CHUNK_SAMPLES
from daq.recording.reader import Recording
from kernels.arrays import Floats

STORED = (
    "started", "ended", "why", "note", "backend", "simulated", "software_version", "software_commit",
    "scenario_sha256", "imported_from", "setup_json", "profile_text", "extra_json",
)  # fmt: skip
Progress = Callable[[int], None]


def columns(recording: Recording | Resampled) -> dict[str, Callable[[int, int], Floats]]:
    """``time_s`` and one column in volts a channel, by name: what gives samples ``start`` to ``stop``."""
    volts = {f"{name}_v": partial(recording.read_v, name) for name in recording.channels}
    return {"time_s": lambda a, b: np.asarray(recording.timestamps_ns(a, b) * 1e-9, np.float64), **volts}


def facts(recording: Recording | Resampled) -> dict[str, str | float | int]:
    """Rate, provenance, profile, and lost samples as JSON pairs ``[first sample after, samples lost]``."""
    out: dict[str, str | float | int] = {
        "source": "shakerbench recording",
        "rate_hz": float(recording.rate_hz),
        "gaps_json": json.dumps(recording.gaps.tolist()),
    }
    stored = {name: recording.stored[name] for name in STORED if name in recording.stored}
    return out | {name: int(value) if isinstance(value, bool) else value for name, value in stored.items()}


def step_columns(recording: Recording | Resampled) -> dict[str, NDArray[Any]]:
    """Columns of the step table, by name."""
    return {name: np.ascontiguousarray(recording.steps[name]) for name in recording.steps.dtype.names or ()}


def pieces(n: int, rows: int = CHUNK_SAMPLES) -> list[tuple[int, int]]:
    """Ranges of samples that are read at once."""
    return [(a, min(a + rows, n)) for a in range(0, n, rows)]
