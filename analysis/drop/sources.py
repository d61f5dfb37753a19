"""Any file of a drop test, told apart by its content: impact times, or the ball's path.

The rule kept here: the first bytes say what a file is; its name only helps where they do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.drop.flights import Clip
from analysis.drop.linking import ball_of
from analysis.drop.onsets import contact_onsets, read_wav, sound_onsets
from analysis.drop.readings import Points, read_table
from analysis.drop.rows import Drop
from analysis.drop.sequence import drops_of
from analysis.drop.tables import read_grids
from analysis.drop.tracking import Tracked, track_film
from analysis.drop.video import FILMS, Progress
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_OTHER_SOUND = {".mp3", ".m4a", ".aac", ".ogg", ".flac", ".wma", ".opus", ".caf", ".amr", ".aiff", ".aif"}
_OTHER_SOUND_STARTS = (b"ID3", b"OggS", b"fLaC", b"\xff\xfb", b"\xff\xf3", b"\xff\xf1", b"#!AMR", b"caff", b"FORM")


@dataclass(frozen=True)
class Path2D:
    """The ball's path in one file.

    Attributes
    ----------
    clip : Clip
    frame_s : float or None
        Seconds a frame, as the file states.
    metres : bool
        Heights are metres.
    tracked : Tracked or None
        For a film.
    """

    clip: Clip
    frame_s: float | None
    metres: bool
    tracked: Tracked | None = None


def load(path: Path, progress: Progress | None = None) -> Drop | Path2D:
    """The drop in a file; the first where there are several. Raises what `load_all` raises."""
    return load_all(path, progress)[0]


def load_all(path: Path, progress: Progress | None = None) -> list[Drop] | list[Path2D]:
    """Every drop in one file.

    Raises
    ------
    InputError
        Missing, of no kind this can read, or nothing usable in it.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.is_dir():
        return [_film(path, progress)]
    head = path.read_bytes()[:16] if path.stat().st_size < 1 << 20 else _head(path)
    if not head:
        raise InputError(f"{path}: the file is empty")
    if head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE":
        samples, rate = read_wav(path)
        times, strength = sound_onsets(samples, rate, str(path))
        return _drops(path, times, 1.0 / rate, strength)
    if path.suffix.lower() in _OTHER_SOUND or head[8:11] == b"M4A" or head.startswith(_OTHER_SOUND_STARTS):
        raise InputError(
            f"{path}: sound, but not WAV; only WAV is read (compression smears onsets): record as WAV, or convert it, "
            "for instance with: ffmpeg -i FILE drop.wav"
        )
    if head.startswith(b"\x89HDF"):
        times, uncertainty = contact_onsets(path)
        return _drops(path, times, uncertainty)
    if path.suffix.lower() in FILMS or head[:4] == b"RIFF" or head[4:8] == b"ftyp":
        return [_film(path, progress)]
    if path.suffix.lower() == ".wav":
        raise InputError(f"{path}: damaged: a WAV file starts with RIFF, this one does not; export it again")
    return _table(path)


def _drops(path: Path, times: Array, uncertainty_s: float = 0.0, strength: Array | None = None) -> list[Drop]:
    found = drops_of(times, str(path), uncertainty_s, strength)
    names = [path.name] if len(found) == 1 else [f"{path.name} ({k} of {len(found)})" for k in range(1, len(found) + 1)]
    return [Drop(name, bounces) for name, bounces in zip(names, found, strict=True)]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)


def _film(path: Path, progress: Progress | None) -> Path2D:
    tracked = track_film(path, progress)
    track = tracked.track
    clip = Clip(path.name, track.clock, track.height, track.acceleration)
    return Path2D(clip, 1.0 / tracked.fps if tracked.fps else None, metres=False, tracked=tracked)


def _table(path: Path) -> list[Drop] | list[Path2D]:
    found = read_table(read_grids(path), str(path))
    if not isinstance(found, Points):
        return _drops(path, found)
    track = ball_of(found.clock, found.x, found.y, str(path))
    steps = np.diff(np.unique(found.clock))
    frame_s = float(np.median(steps)) if found.in_seconds else 1.0
    clip = Clip(path.name, track.clock / frame_s, track.height, track.acceleration * frame_s**2)
    return [Path2D(clip, frame_s if found.in_seconds else None, found.metres)]
