"""Rebuild a verified recording from one that was cut off by a kill, a crash or a full disk, or that is damaged.

The file is only read; what is rebuilt is a new file, checked, marked as recovered. What cannot be read is a gap in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from daq.recording.opening import UNCHECKED
from daq.recording.verify import examine
from daq.recording.writer import columns_of
from daq.setup.clock import now_utc
from daq.setup.errors import InputError


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery: the file, its size, blocks of the frames that are gone, damage."""

    path: Path
    n_samples: int
    n_steps: int
    damaged_blocks: list[int]
    lost_samples: int = 0
    damage: list[str] = field(default_factory=list)
    is_less: bool = False  # something that had been recorded is not there


def default_out(path: Path) -> Path:
    """Default output of `recover`: ``NAME.recovered.h5`` in the folder of ``path``."""
    return path.with_name(f"{path.stem}.recovered{path.suffix}")


def recover(path: Path, out: Path | None = None) -> Recovery:
    """Write what is sound of ``path`` as a closed recording.

    Parameters
    ----------
    path
        Recording that was cut off, or is damaged.
    out
        File to create; the default is `default_out`.

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
        changed: dict[str, object] = {"recovered": True, "recovered_at": now_utc(), "recovered_from": path.name}
        if recording.stored["ended"] == "incomplete":
            changed |= {"ended": "stopped", "why": f"cut off after {recording.n_samples} samples, recovered"}
        if damage:
            changed["damage"] = "\n".join(damage)
        attributes = recording.stored | {"channels": list(recording.channels)} | changed
        for key, value in attributes.items():
            if isinstance(value, str):  # damaged text may not encode
                attributes[key] = value.encode(errors="replace").decode()
        columns_of(recording, out, attributes).rename()
        lost = int(recording.gaps[:, 1].sum())
        n_samples, n_steps = recording.n_samples, len(recording.steps)
        return Recovery(out, n_samples, n_steps, list(looked.bad_blocks), lost, damage, recording.is_less)
