"""Rebuild a verified recording from one that was cut off by a kill, a crash or a full disk, or that is damaged.

The file is only read; what is rebuilt is a new file, checked, marked as recovered. What cannot be
read is a gap in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from daq.files.column_file import CHUNK_SAMPLES, ColumnWriter
from daq.recording.opening import UNCHECKED
from daq.recording.reader import Recording
from daq.recording.survey import examine
from daq.recording.writer import now_utc
from daq.setup.errors import InputError


@dataclass(frozen=True)
class Recovery:
    """What was recovered: into which file, how much, which blocks of the frames are gone, what was damaged.

    ``is_less``: something that had been recorded is not there.
    """

    path: Path
    n_samples: int
    n_steps: int
    damaged_blocks: list[int]
    lost_samples: int = 0
    damage: list[str] = field(default_factory=list)
    is_less: bool = False


def default_out(path: Path) -> Path:
    """Where `recover` writes when nobody says: ``NAME.recovered.h5`` beside ``path``."""
    return path.with_name(f"{path.stem}.recovered{path.suffix}")


def recover(path: Path, out: Path | None = None) -> Recovery:
    """Write what is sound of ``path`` as a closed recording.

    Parameters
    ----------
    path
        Recording that was cut off, or is damaged.
    out
        File to create; the default is ``NAME.recovered.h5`` beside it.

    Raises
    ------
    InputError
        When ``path`` is closed and sound already, holds nothing, or cannot be read; when ``out`` exists.
    OSError
        When the disk refuses.
    """
    out = out if out is not None else default_out(path)
    recording, looked = examine(path)
    with recording:
        damage = [line for line in recording.damage if line != UNCHECKED]
        if recording.frames is None and not damage:
            raise InputError(f"{path}: was closed properly and is sound; there is nothing to recover.")
        if recording.n_samples == 0:
            raise InputError(f"{path}: no block had been recorded when it was cut off, or none can be read.")
        return _rebuilt(recording, out, damage, looked.bad_blocks)


def _rebuilt(recording: Recording, out: Path, damage: list[str], bad: list[int]) -> Recovery:
    """Write the recovered file."""
    n_samples, path = recording.n_samples, recording.path
    changed: dict[str, object] = {"recovered": True, "recovered_at": now_utc(), "recovered_from": path.name}
    if recording.stored["ended"] == "incomplete":
        changed |= {"ended": "stopped", "why": f"cut off after {n_samples} samples, recovered"}
    if damage:
        changed["damage"] = "\n".join(damage)
    dtypes = {name: recording.codes(name, 0, 1).dtype for name in recording.channels}
    scales = {name: recording.scale(name) for name in recording.channels}
    plain = {k: v.encode(errors="replace").decode() if isinstance(v, str) else v for k, v in recording.stored.items()}
    attributes = plain | {"channels": list(recording.channels)} | changed
    writer = ColumnWriter(out, recording.setup, dtypes, scales, attributes)
    try:
        for start in range(0, n_samples, CHUNK_SAMPLES):
            stop = min(start + CHUNK_SAMPLES, n_samples)
            columns = {name: recording.codes(name, start, stop) for name in recording.channels}
            writer.append(recording.timestamps_ns(start, stop), columns)
        writer.check(recording.steps, recording.blocks, recording.side)
    except BaseException:
        writer.abandon()
        raise
    writer.rename()
    lost = int(recording.gaps[:, 1].sum())
    return Recovery(out, n_samples, len(recording.steps), bad, lost, damage, recording.is_less)
