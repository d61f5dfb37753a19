"""Any file of a drop test, recognised by its first bytes: impact times, or the ball's path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from analysis.drop.corrections import NOTHING, Corrections, Progress
from analysis.drop.falls.fit import is_fall
from analysis.drop.film.track import Clip, ball_of, near_impacts
from analysis.drop.film.tracking import Tracked, track_film
from analysis.drop.film.video import FILMS
from analysis.drop.read.readings import Points, read_tables
from analysis.drop.times.impact_chain import Onsets, drops_of, unheard
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.onsets import contact_onsets, onsets_of_file
from daq.files.wav import is_wav
from daq.importers.tables import read_sheets
from daq.setup.errors import InputError
from kernels.arrays import Floats

T = TypeVar("T")

_OTHER_SOUND = {".mp3", ".m4a", ".aac", ".ogg", ".flac", ".wma", ".opus", ".caf", ".amr", ".aiff", ".aif"}
_OTHER_SOUND_STARTS = (b"ID3", b"OggS", b"fLaC", b"\xff\xfb", b"\xff\xf3", b"\xff\xf1", b"#!AMR", b"caff", b"FORM")
_HDF5 = b"\x89HDF"
_IGNORE_REACH_S = 0.02


@dataclass(frozen=True)
class Path2D:
    """The ball's path in one file."""

    clip: Clip
    frame_s: float | None  # seconds a frame, as the file states
    metres: bool  # heights are metres
    tracked: Tracked | None = None  # for a film
    remarks: tuple[str, ...] = ()  # what was noticed
    not_read: tuple[str, ...] = ()  # what of the file was not read, with the reason (with the file's first path)
    # (n,) (n,) times, s (frames where no clock is known), and heights of a fall without a bounce, as the table has them
    fall: tuple[Floats, Floats] | None = None

    @property
    def name(self) -> str:
        """The file it came from."""
        return self.clip.name


class Known:
    """Onsets and tracks found already, which are slow and which no correction of an impact moves."""

    def __init__(self) -> None:
        self._made: dict[object, Any] = {}

    def made(self, path: Path, what: object, make: Callable[[], T]) -> T:
        """The result of ``make`` for a file as it is now; made once. ``what``: all else that it depends on."""
        state = path.stat()
        key = (path, state.st_size, state.st_mtime_ns, what)
        if key not in self._made:
            self._made[key] = make()
        found: T = self._made[key]
        return found


def load_all(
    path: Path, progress: Progress | None = None, corrections: Corrections = NOTHING, known: Known | None = None
) -> list[Drop] | list[Path2D]:
    """Every drop in one file, as ``corrections`` leave it.

    Raises `InputError` for a file that is missing, of no kind that is read, or without anything usable.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    known = known or Known()
    if path.is_dir():
        return [_film(path, progress, corrections, known)]
    head = _head(path)
    if not head:
        raise InputError(f"{path}: the file is empty")
    if (heard := _heard(path, known, progress)) is not None:
        return _drops(path, heard, corrections)
    if path.suffix.lower() in _OTHER_SOUND or head[8:11] == b"M4A" or head.startswith(_OTHER_SOUND_STARTS):
        raise InputError(
            f"{path}: sound, but not WAV; only WAV is read (compression smears onsets): record as WAV, or convert it, "
            "for instance with: ffmpeg -i FILE drop.wav"
        )
    if path.suffix.lower() in FILMS or head[:4] == b"RIFF" or head[4:8] == b"ftyp":
        return [_film(path, progress, corrections, known)]
    if path.suffix.lower() == ".wav":
        raise InputError(f"{path}: damaged: a WAV file starts with RIFF, this one does not; export it again")
    return _table(path, corrections)


def events_in(path: Path, corrections: Corrections, known: Known) -> Floats:
    """Every event of a sound, a contact circuit or a table of times, as corrected, whether a ball's or not; else none.

    Raises `InputError` where nothing in the file can be read.
    """
    if not path.is_file():
        return np.empty(0)
    if (heard := _heard(path, known)) is not None:
        times = heard.times_s
    elif path.suffix.lower() not in FILMS:
        found = [item for _, item in read_tables(read_sheets(path), str(path)).found]
        times = found[0] if len(found) == 1 and not isinstance(found[0], Points) else np.empty(0)
    else:
        return np.empty(0)
    return np.sort(np.concatenate([times[corrections.keeps(times, _IGNORE_REACH_S)], corrections.add_s]))


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)


def _heard(path: Path, known: Known, progress: Progress | None = None) -> Onsets | None:
    """Events of a sound or of a contact circuit; None for a file of another kind."""
    if is_wav(path):
        return known.made(path, "onsets", lambda: onsets_of_file(path, progress))
    if _head(path).startswith(_HDF5):
        return unheard(known.made(path, "contact", lambda: contact_onsets(path)))
    return None


def _drops(path: Path, events: Onsets, corrections: Corrections) -> list[Drop]:
    """Every drop among the events of a file, those that a person added included."""
    added = np.array(corrections.add_s)
    # an impact that a person added is worth three that were only heard
    by_hand = Onsets(added, np.full(len(added), 3.0), np.full(len(added), np.nan))
    heard = events.part(corrections.keeps(events.times_s, _IGNORE_REACH_S))
    used = Onsets(*(np.concatenate(both) for both in zip(heard, by_hand, strict=True)))
    found = drops_of(used, str(path))
    numbers = [f" ({k + 1} of {len(found)})" if len(found) > 1 else "" for k in range(len(found))]
    impacts = np.concatenate([bounces.impacts_s for bounces in found])
    said = tuple(
        f"{path.name}: no flight of the ball begins or ends at the impact added at {when:.4f} s"
        for when in corrections.add_s
        if np.abs(impacts - when).min() > 1e-9
    )
    drops = [Drop(path.name + n, bounces, sound=is_wav(path)) for n, bounces in zip(numbers, found, strict=True)]
    return [replace(drops[0], remarks=said, events_s=np.sort(used.times_s)), *drops[1:]]


def _film(path: Path, progress: Progress | None, corrections: Corrections, known: Known) -> Path2D:
    """The ball's path in a film; a time to be left out is an impact's, or else a frame's, which is not followed."""

    def tracked_without(ignore_s: tuple[float, ...]) -> Tracked:
        own = replace(corrections, ignore_s=ignore_s, add_s=())
        return known.made(path, own, lambda: track_film(path, progress, own))

    def clip_of(tracked: Tracked) -> Clip:
        track = tracked.track
        return Clip(path.name, track.clock + tracked.first, track.height, track.acceleration, track.x, tracked.watched)

    try:
        tracked = tracked_without(())
        frames = _frames_meant(clip_of(tracked), tracked.fps, corrections)
    except InputError:
        if not corrections.ignore_s:
            raise
        frames = corrections.ignore_s  # perhaps a frame that leads the tracker astray is among them
    if frames:
        tracked = tracked_without(frames)
    frame_s = 1.0 / tracked.fps if tracked.fps else None
    return Path2D(_corrected(clip_of(tracked), frame_s, corrections), frame_s, False, tracked, tracked.remarks)


def _frames_meant(clip: Clip, fps: float | None, corrections: Corrections) -> tuple[float, ...]:
    """The ignored times that are of frames, not of impacts."""
    meant = near_impacts(clip, np.array(corrections.ignore_s) * (fps or 1.0))
    return tuple(t for t, own in zip(corrections.ignore_s, meant, strict=True) if not own)


def _corrected(clip: Clip, frame_s: float | None, corrections: Corrections) -> Clip:
    """The clip with what a person said about its impacts."""
    step = frame_s or 1.0
    gone, added = (tuple(t / step for t in times) for times in (corrections.ignore_s, corrections.add_s))
    return replace(clip, no_impact=gone, impact=added)


def _table(path: Path, corrections: Corrections) -> list[Drop] | list[Path2D]:
    """Every drop of a table; one that is refused is named, and the others are read."""
    contents = read_tables(read_sheets(path), str(path))
    if corrections.add_s and len(contents.found) > 1:
        raise InputError(
            f"{path}: holds {len(contents.found)} drops, each with times of its own, so an impact to be added could "
            "belong to any; give each drop a file"
        )
    drops: list[Drop] = []
    paths: list[Path2D] = []
    not_read = list(contents.not_read)
    refused: InputError | None = None
    for number, (label, item) in enumerate(contents.found):
        label = label or str(number + 1)
        name = path.name if len(contents.found) == 1 else f"{path.name} ({label})"
        try:
            if isinstance(item, Points):
                paths.append(_path(item, name, corrections))
            else:
                read = _drops(path, unheard(item), corrections)
                more = [f" {k + 1} of {len(read)}" if len(read) > 1 else "" for k in range(len(read))]
                drops += [replace(drop, name=name + words) for drop, words in zip(read, more, strict=True)]
        except InputError as error:
            why = str(error)
            # steps of five seconds are no times of impacts in seconds
            if not isinstance(item, Points) and len(item) > 1 and np.median(np.diff(np.sort(item))) > 5.0:
                hint = ". Are these milliseconds or microseconds? Then say so in the heading: time (ms)"
                error = InputError(why + hint)
            refused = refused or error
            bare = why.removeprefix(f"{path}: ").removeprefix(f"{path.name}: ")  # without the file's name in front
            bare = bare.split("): ", 1)[-1] if bare.startswith(f"{path.name} (") else bare
            not_read.append(f"{label}: {bare}")
    if refused is not None and not drops and not paths:
        raise refused
    said = tuple(f"{path.name}: not read: {words}" for words in not_read)
    if drops:
        return [replace(drops[0], not_read=said), *drops[1:]]
    return [replace(paths[0], not_read=said), *paths[1:]]


def _path(found: Points, name: str, corrections: Corrections) -> Path2D:
    """The ball's path among points of a table; a time to be left out is an impact's, or else a sample's."""
    frame_s = 1.0
    used = corrections.keeps(found.clock, 1e-6)
    time, height = found.clock[used], found.y[used]
    if not corrections.add_s and (way := is_fall(time, height)):
        clip = Clip(name, time, way * height, 0.0)
        return Path2D(clip, 1.0 if found.in_seconds else None, found.metres, fall=(time, way * height))
    if found.in_seconds:  # times may be rounded: the whole time over the number of steps
        steps = np.diff(np.unique(found.clock))
        frame_s = float(steps.sum() / np.maximum(np.round(steps / np.median(steps)), 1.0).sum())
    clip, remarks = _clip(found, name, replace(corrections, ignore_s=()), frame_s)
    if corrections.ignore_s:
        frames = _frames_meant(clip, 1.0 / frame_s, corrections)
        clip, remarks = _clip(found, name, replace(corrections, ignore_s=frames), frame_s)
    stated_s = frame_s if found.in_seconds else None
    return Path2D(_corrected(clip, stated_s, corrections), stated_s, found.metres, remarks=remarks)


def _clip(found: Points, name: str, corrections: Corrections, frame_s: float) -> tuple[Clip, tuple[str, ...]]:
    """The ball among the points that are left, on whole frames but for rounding, and what was noticed."""
    used = corrections.keeps(found.clock, 0.6 * frame_s)
    if corrections.region is not None:
        left, top, right, bottom = corrections.region
        used &= (found.x >= left) & (found.x <= right) & (found.y >= top) & (found.y <= bottom)
    track = ball_of(found.clock[used], found.x[used], found.y[used], name, corrections.axis_deg)
    frames = (track.clock - track.clock[0]) / frame_s
    whole = np.round(frames)
    frames = whole if np.abs(frames - whole).max() < 0.1 else frames
    clip = Clip(name, track.clock[0] / frame_s + frames, track.height, track.acceleration * frame_s**2)
    return clip, track.remarks
