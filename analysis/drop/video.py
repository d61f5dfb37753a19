"""Frames from a video file or a folder of pictures, and what stands still in them.

The rule kept here: one frame in memory at a time. What is wrong with a film (damaged, cut, nothing in it) is found
before anything is measured in it, and said.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.setup.errors import InputError

Image = NDArray[np.uint8]
Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}
FILMS = {".avi", ".mp4", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".wmv", ".webm", ".3gp", ".mts", ".cine", ".gif"}
SEARCH_WIDTH = 640  # frames are searched at this width, and measured at full size
_SMALL_WIDTH = 320
_CHANGED_LEVELS = 20.0
_CUT_SHARE = 0.2
_MOST_SAMPLES = 31
_LEAST_FRAMES = 12
_LIVELY_SHARE = 0.25


@dataclass(frozen=True)
class Film:
    """A film that can be read again and again.

    Attributes
    ----------
    path : Path
        A file, or a folder of pictures.
    fps : float or None
        Frame rate that the file states (playback rate: not what a slow-motion camera filmed at).
    count : int
        Frames stated by the file, or pictures found.
    """

    path: Path
    fps: float | None
    count: int

    def frames(self) -> Iterator[Image]:
        """All frames in order, (rows, columns, 3) uint8.

        Raises
        ------
        InputError
            A frame that cannot be decoded or has another size than the first.
        """
        first: tuple[int, ...] | None = None
        for number, frame in enumerate(self._decoded()):
            if first is not None and frame.shape != first:
                raise InputError(f"{self.path}: frame {number} has another size than the first; use frames of one film")
            first = frame.shape
            yield frame

    def _decoded(self) -> Iterator[Any]:
        cv2 = opencv(self.path)
        if self.path.is_dir():
            for name in _pictures(self.path):
                picture = cv2.imdecode(np.frombuffer(name.read_bytes(), dtype=np.uint8), cv2.IMREAD_COLOR)
                if picture is None:
                    raise InputError(f"{name}: damaged picture")
                yield picture
            return
        reader = cv2.VideoCapture(str(self.path))
        try:
            read = 0
            while True:
                ok, frame = reader.read()
                if not ok:
                    break
                read += 1
                yield frame
        finally:
            reader.release()
        if read < 0.8 * self.count:
            raise InputError(
                f"{self.path}: damaged: {read} of {self.count} frames could be read; copy it again or re-encode it"
            )


def opencv(path: Path) -> Any:
    """The module ``cv2``, an extra.

    Raises
    ------
    InputError
        Not installed.
    """
    try:
        import cv2
    except ImportError as error:
        raise InputError(f"{path}: reading a film needs the extra: pip install 'shakerbench[video]'") from error
    return cv2


def open_film(path: Path) -> Film:
    """A film or a folder of pictures.

    Raises
    ------
    InputError
        Not a film, no frames, or too few of them.
    """
    cv2 = opencv(path)
    if path.is_dir():
        count, fps = len(_pictures(path)), None
    else:
        reader = cv2.VideoCapture(str(path))
        opened = reader.isOpened()
        count, rate = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)), float(reader.get(cv2.CAP_PROP_FPS))
        reader.release()
        if not opened or count <= 0:
            raise InputError(f"{path}: cannot be read as a film; it is damaged, or of a kind this OpenCV cannot decode")
        fps = rate if np.isfinite(rate) and rate > 0 else None
    if count < _LEAST_FRAMES:
        raise InputError(f"{path}: {count} frames are too few for a drop; at least {_LEAST_FRAMES} are needed")
    return Film(path, fps, count)


def _pictures(folder: Path) -> list[Path]:
    found = [p for p in folder.iterdir() if p.suffix.lower() in PICTURES]
    return sorted(found, key=lambda p: [int(x) if x.isdigit() else x for x in re.split(r"(\d+)", p.name)])


@dataclass(frozen=True)
class Still:
    """What stands still.

    Attributes
    ----------
    background : (rows, columns, 3) float32
        Median of frames in which something small moves.
    small : (rows, columns, 3) float32
        The same at `SEARCH_WIDTH`.
    n_frames : int
        Frames read.
    """

    background: NDArray[np.float32]
    small: NDArray[np.float32]
    n_frames: int


def still_of(film: Film, progress: Progress | None = None) -> Still:
    """The background of a film.

    Raises
    ------
    InputError
        Nothing moves, or the film has a cut.
    """
    cv2 = opencv(film.path)
    small = []
    for number, frame in enumerate(film.frames()):
        factor = min(1.0, _SMALL_WIDTH / frame.shape[1])
        size = (max(int(frame.shape[1] * factor), 8), max(int(frame.shape[0] * factor), 8))
        grey = cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        small.append(grey)
        if progress is not None:
            progress("looking", number + 1, film.count)
    stack = np.array(small, dtype=np.float32)
    if len(stack) < _LEAST_FRAMES:
        raise InputError(f"{film.path}: {len(stack)} frames are too few for a drop")
    stack /= np.maximum(np.median(stack, axis=(1, 2), keepdims=True), 1.0) / max(float(np.median(stack)), 1.0)
    _refuse_cut(stack, film)
    chosen = _clean_frames(stack, film)
    kept = [frame for number, frame in enumerate(film.frames()) if number in chosen]
    rows = [np.median(np.array([f[r : r + 64] for f in kept]), axis=0) for r in range(0, kept[0].shape[0], 64)]
    background = np.concatenate(rows).astype(np.float32)
    factor = min(1.0, SEARCH_WIDTH / background.shape[1])
    size = (int(background.shape[1] * factor), int(background.shape[0] * factor))
    return Still(background, cv2.resize(background, size, interpolation=cv2.INTER_AREA), len(stack))


def _refuse_cut(stack: NDArray[np.float32], film: Film) -> None:
    """A cut changes a large part of the picture at once, and for good."""
    for k in range(1, len(stack)):
        if float((np.abs(stack[k] - stack[k - 1]) > _CHANGED_LEVELS).mean()) > _CUT_SHARE:
            before, after = np.median(stack[max(k - 4, 0) : k], axis=0), np.median(stack[k : k + 4], axis=0)
            if float((np.abs(after - before) > _CHANGED_LEVELS).mean()) > _CUT_SHARE:
                raise InputError(
                    f"{film.path}: a cut in the film between frames {k - 1} and {k}: a large part of the picture "
                    "changes at once; cut the clip so that it holds one drop seen by a camera at rest"
                )


def _clean_frames(stack: NDArray[np.float32], film: Film) -> set[int]:
    """Frames to take the background from: something moves, but not a person through half of the picture."""
    usual = np.median(stack, axis=0)
    changed = (np.abs(stack - usual) > _CHANGED_LEVELS).mean(axis=(1, 2))
    step = np.abs(np.diff(stack, axis=0)).max(axis=(1, 2))
    if float(np.percentile(step, 98)) < _CHANGED_LEVELS:
        raise InputError(f"{film.path}: no motion: {len(stack)} frames show the same still scene")
    motion = np.append(step, step[-1])
    calm = np.flatnonzero(changed < max(0.06, float(np.percentile(changed, 25))))
    still, lively = np.percentile(motion[calm], [5, 95])
    busy = calm[motion[calm] >= still + _LIVELY_SHARE * (lively - still)]  # not the ball's rest: it would stay behind
    pick = busy if len(busy) >= 9 else calm
    return _unlike(stack, pick)


def _unlike(stack: NDArray[np.float32], pool: NDArray[np.intp]) -> set[int]:
    """Frames of the pool that differ most from each other: where the ball lingers, few of them show it there."""
    chosen, coarse = [int(pool[0])], stack[pool][:, ::4, ::4]
    apart = np.full(len(pool), np.inf)
    while len(chosen) < min(_MOST_SAMPLES, len(pool)):
        changed = np.abs(coarse - stack[chosen[-1], ::4, ::4]) > _CHANGED_LEVELS
        apart = np.minimum(apart, changed.mean(axis=(1, 2)))
        apart[pool == chosen[-1]] = -1.0
        chosen.append(int(pool[int(apart.argmax())]))
    return set(chosen)
