"""Rebuild a verified recording from one that was cut off: by a kill, a crash, or a full disk.

The rule kept here: the file that was cut off is only read; what is rebuilt is a new file, checked, marked as recovered.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from daq.recording.frame_file import is_being_written, is_whole
from daq.recording.reader import open_recording
from daq.recording.writer import columns_from_frames, now_utc
from daq.setup.errors import InputError


@dataclass(frozen=True)
class Recovery:
    """What was recovered: into which file, how much, and which blocks do not fit their checksum."""

    path: Path
    n_samples: int
    n_steps: int
    damaged_blocks: list[int]


def default_out(path: Path) -> Path:
    """Where `recover` writes when nobody says: ``NAME.recovered.h5`` beside ``path``."""
    return path.with_name(f"{path.stem}.recovered{path.suffix}")


def recover(path: Path, out: Path | None = None) -> Recovery:
    """Write the acknowledged blocks of ``path`` as a closed recording.

    Parameters
    ----------
    path
        Recording that was cut off.
    out
        File to create; the default is ``NAME.recovered.h5`` beside it.

    Raises
    ------
    InputError
        When ``path`` is closed already, holds nothing, or cannot be read; when ``out`` exists.
    OSError
        When the disk refuses.
    """
    out = out if out is not None else default_out(path)
    if path.is_file() and is_being_written(path) and not is_whole(path):
        raise InputError(f"{path}: is shorter than its index says; a copy that broke off cannot be recovered.")
    with open_recording(path) as recording:
        if recording.frames is None:
            raise InputError(f"{path}: was closed properly; there is nothing to recover.")
        n_samples, n_steps = recording.n_samples, len(recording.steps)
        if n_samples == 0:
            raise InputError(f"{path}: no block had been recorded when it was cut off.")
        changed: dict[str, object] = {"recovered": True, "recovered_at": now_utc(), "recovered_from": path.name}
        if recording.attrs["ended"] == "incomplete":
            changed |= {"ended": "stopped", "why": f"cut off after {n_samples} samples, recovered"}
    damaged = columns_from_frames(path, out, **changed)
    return Recovery(out, n_samples, n_steps, damaged)
