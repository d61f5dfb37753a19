"""Any file of a drop test, told apart by its content: impact times, or the ball's path.

The rule kept here: the first bytes say what a file is; its name only helps where they do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.drop.flights import Clip
from analysis.drop.linking import ball_of
from analysis.drop.onsets import contact_onsets, read_wav, sound_onsets
from analysis.drop.readings import Points, read_table
from analysis.drop.rows import Drop
from analysis.drop.sequence import bounces_of
from analysis.drop.tables import read_grids
from analysis.drop.tracking import Tracked, track_film
from analysis.drop.video import FILMS, Progress
from daq.errors import InputError

_OTHER_SOUND = {".mp3", ".m4a", ".aac", ".ogg", ".flac", ".wma", ".opus"}


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
    """Read one file.

    Raises
    ------
    InputError
        Missing, of no kind this can read, or nothing usable in it.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.is_dir():
        return _film(path, progress)
    head = path.read_bytes()[:16] if path.stat().st_size < 1 << 20 else _head(path)
    if not head:
        raise InputError(f"{path}: the file is empty")
    if head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE":
        samples, rate = read_wav(path)
        times, strength = sound_onsets(samples, rate, str(path))
        return Drop(path.name, bounces_of(times, str(path), 1.0 / rate, strength))
    if head.startswith(b"\x89HDF"):
        times, uncertainty = contact_onsets(path)
        return Drop(path.name, bounces_of(times, str(path), uncertainty))
    if path.suffix.lower() in FILMS or head[:4] == b"RIFF" or head[4:8] == b"ftyp":
        return _film(path, progress)
    if path.suffix.lower() == ".wav":
        raise InputError(f"{path}: damaged: a WAV file starts with RIFF, this one does not; export it again")
    if path.suffix.lower() in _OTHER_SOUND:
        raise InputError(f"{path}: compressed sound is not read (its onsets are smeared); export it as PCM WAV")
    return _table(path)


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)


def _film(path: Path, progress: Progress | None) -> Path2D:
    tracked = track_film(path, progress)
    track = tracked.track
    clip = Clip(path.name, track.clock, track.height, track.acceleration)
    return Path2D(clip, 1.0 / tracked.fps if tracked.fps else None, metres=False, tracked=tracked)


def _table(path: Path) -> Drop | Path2D:
    found = read_table(read_grids(path), str(path))
    if not isinstance(found, Points):
        return Drop(path.name, bounces_of(found, str(path)))
    track = ball_of(found.clock, found.x, found.y, str(path))
    steps = np.diff(np.unique(found.clock))
    frame_s = float(np.median(steps)) if found.in_seconds else 1.0
    clip = Clip(path.name, track.clock / frame_s, track.height, track.acceleration * frame_s**2)
    return Path2D(clip, frame_s if found.in_seconds else None, found.metres)
