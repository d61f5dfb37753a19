"""Any file of a drop test, told apart by its first bytes: impact times, or the ball's path."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film.flights import Clip
from analysis.drop.film.linking import ball_of
from analysis.drop.film.tracking import Tracked, track_film
from analysis.drop.film.video import FILMS
from analysis.drop.options.corrections import NOTHING, Corrections
from analysis.drop.options.progress import Progress
from analysis.drop.read.contents import read_tables
from analysis.drop.read.readings import Points
from analysis.drop.read.tables import read_grids
from analysis.drop.times.impact_chain import drops_of
from analysis.drop.times.one_ahead import Drop
from analysis.drop.times.onsets import Onsets, contact_onsets, onsets_of_file
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_OTHER_SOUND = {".mp3", ".m4a", ".aac", ".ogg", ".flac", ".wma", ".opus", ".caf", ".amr", ".aiff", ".aif"}
_OTHER_SOUND_STARTS = (b"ID3", b"OggS", b"fLaC", b"\xff\xfb", b"\xff\xf3", b"\xff\xf1", b"#!AMR", b"caff", b"FORM")


_IGNORE_REACH_S = 0.02
_LONGEST_STEP_S = 5.0
_ROUNDED_FRAMES = 0.1


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
    remarks, not_read : tuple of str
        What was noticed, and what of the file was not read, with the reason (with the file's first path).
    """

    clip: Clip
    frame_s: float | None
    metres: bool
    tracked: Tracked | None = None
    remarks: tuple[str, ...] = ()
    not_read: tuple[str, ...] = ()


def load(path: Path, progress: Progress | None = None, corrections: Corrections = NOTHING) -> Drop | Path2D:
    """The drop in a file; the first where there are several. Raises what `load_all` raises."""
    return load_all(path, progress, corrections)[0]


def load_all(
    path: Path, progress: Progress | None = None, corrections: Corrections = NOTHING
) -> list[Drop] | list[Path2D]:
    """Every drop in one file, less what ``corrections`` leave out.

    Raises
    ------
    InputError
        Missing, of no kind this can read, or nothing usable in it.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if path.is_dir():
        return [_film(path, progress, corrections)]
    head = _head(path)
    if not head:
        raise InputError(f"{path}: the file is empty")
    if head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE":
        onsets, rate_hz = onsets_of_file(path, progress)
        return _drops(path, onsets, 1.0 / rate_hz, corrections, sound=True)
    if path.suffix.lower() in _OTHER_SOUND or head[8:11] == b"M4A" or head.startswith(_OTHER_SOUND_STARTS):
        raise InputError(
            f"{path}: sound, but not WAV; only WAV is read (compression smears onsets): record as WAV, or convert it, "
            "for instance with: ffmpeg -i FILE drop.wav"
        )
    if head.startswith(b"\x89HDF"):
        times, uncertainty = contact_onsets(path)
        return _drops(path, Onsets(times, np.ones(len(times)), np.full(len(times), np.nan)), uncertainty, corrections)
    if path.suffix.lower() in FILMS or head[:4] == b"RIFF" or head[4:8] == b"ftyp":
        return [_film(path, progress, corrections)]
    if path.suffix.lower() == ".wav":
        raise InputError(f"{path}: damaged: a WAV file starts with RIFF, this one does not; export it again")
    return _table(path, corrections)


def _drops(
    path: Path, events: Onsets, uncertainty_s: float, corrections: Corrections, sound: bool = False
) -> list[Drop]:
    kept = corrections.keeps(events.times_s, _IGNORE_REACH_S)
    found = drops_of(events.times_s[kept], str(path), uncertainty_s, events.strength[kept], events.loudness[kept])
    names = [path.name] if len(found) == 1 else [f"{path.name} ({k} of {len(found)})" for k in range(1, len(found) + 1)]
    return [Drop(name, bounces, file=path, sound=sound) for name, bounces in zip(names, found, strict=True)]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)


def _film(path: Path, progress: Progress | None, corrections: Corrections) -> Path2D:
    tracked = track_film(path, progress, corrections)
    track = tracked.track
    clip = Clip(path.name, track.clock, track.height, track.acceleration, track.x, tracked.watched)
    frame_s = 1.0 / tracked.fps if tracked.fps else None
    return Path2D(clip, frame_s, metres=False, tracked=tracked, remarks=tracked.remarks)


def _table(path: Path, corrections: Corrections) -> list[Drop] | list[Path2D]:
    """Every drop of a table; one that is refused is named, and the others are read."""
    contents = read_tables(read_grids(path), str(path))
    drops: list[Drop] = []
    paths: list[Path2D] = []
    not_read = list(contents.not_read)
    refused: InputError | None = None
    for number, (label, item) in enumerate(contents.found):
        name = path.name if len(contents.found) == 1 else f"{path.name} ({label or number + 1})"
        try:
            if isinstance(item, Points):
                paths.append(_path(item, name, corrections))
                continue
            read = _drops(path, Onsets(item, np.ones(len(item)), np.full(len(item), np.nan)), 0.0, corrections)
        except InputError as error:
            refused = refused or (error if isinstance(item, Points) else _in_milliseconds(error, item))
            not_read.append(f"{label or number + 1}: {_without(str(error), path)}")
            continue
        more = "" if len(read) == 1 else " {} of " + str(len(read))
        drops += [replace(drop, name=name + more.format(k + 1)) for k, drop in enumerate(read)]
    if refused is not None and not drops and not paths:
        raise refused
    said = tuple(f"{path.name}: not read: {words}" for words in not_read)
    if drops:
        return [replace(drops[0], not_read=said), *drops[1:]]
    return [replace(paths[0], not_read=said), *paths[1:]]


def _in_milliseconds(error: InputError, times: Array) -> InputError:
    """The error with a hint, where the numbers would be seconds too long for any flight."""
    if len(times) > 1 and float(np.median(np.diff(np.sort(times)))) > _LONGEST_STEP_S:
        return InputError(f"{error}. Are these milliseconds? Then say so in the heading: time (ms)")
    return error


def _without(words: str, path: Path) -> str:
    """A reason without the file's name in front."""
    for start in (f"{path}: ", f"{path.name}: "):
        words = words.removeprefix(start)
    return re.sub(r"^.*?\): ", "", words) if words.startswith(f"{path.name} (") else words


def _path(found: Points, name: str, corrections: Corrections) -> Path2D:
    frame_s = _frame_s(found.clock) if found.in_seconds else 1.0
    kept = corrections.keeps(found.clock, 0.6 * frame_s)
    if corrections.region is not None:
        left, top, right, bottom = corrections.region
        kept &= (found.x >= left) & (found.x <= right) & (found.y >= top) & (found.y <= bottom)
    track = ball_of(found.clock[kept], found.x[kept], found.y[kept], name, corrections.axis_deg)
    clip = Clip(name, _in_frames(track.clock, frame_s), track.height, track.acceleration * frame_s**2)
    return Path2D(clip, frame_s if found.in_seconds else None, found.metres, remarks=track.remarks)


def _frame_s(clock: Array) -> float:
    """Seconds a frame from times that may be rounded: the whole time over the number of steps."""
    times = np.unique(clock)
    steps = np.diff(times)
    usual = float(np.median(steps))
    return float(steps.sum() / np.maximum(np.round(steps / usual), 1.0).sum())


def _in_frames(clock: Array, frame_s: float) -> Array:
    """Times in frames from the first; on whole frames where all are there but for rounding."""
    frames = (clock - clock[0]) / frame_s
    whole = np.round(frames)
    rounded = bool(np.abs(frames - whole).max() < _ROUNDED_FRAMES)
    return np.asarray(clock[0] / frame_s + (whole if rounded else frames))
