"""Frames from a video file or a folder of pictures, one in memory at a time."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.corrections import Corrections
from daq.setup.errors import InputError
from kernels.arrays import Floats

Image = NDArray[np.uint8]

PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}
FILMS = {".avi", ".mp4", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".wmv", ".webm", ".3gp", ".mts", ".cine", ".gif"}
LEAST_FRAMES = 12


@dataclass(frozen=True)
class Film:
    """A film that can be read again and again."""

    path: Path  # a file, or a folder of pictures
    fps: float | None  # frame rate that the file states (playback rate: not what a slow-motion camera filmed at)
    count: int  # frames stated by the file, or pictures found
    first: int = 0  # frame that is used
    last: int = 1 << 60  # last frame that is used; a large number: to the end
    # (left, top, right, bottom) of the part of the picture that is used, pixels
    region: tuple[int, int, int, int] | None = None
    # (n, 2) by which each used frame is off the first, across and down, px; frames are moved back by it
    shifts: Floats | None = None
    watched: bool = True  # edges in the picture show whether the camera moved along its columns

    def frames(self) -> Iterator[Image]:
        """The frames that are used, in order, (rows, columns, 3) uint8.

        Raises `InputError` for a frame that cannot be decoded or has another size than the first.
        """
        shape: tuple[int, ...] | None = None
        for number, frame in enumerate(self._decoded()):
            if shape is not None and frame.shape != shape:
                raise InputError(f"{self.path}: frame {number} has another size than the first; use frames of one film")
            shape = frame.shape
            if number > self.last:
                break
            if number >= self.first:
                left, top, right, bottom = self.region or (0, 0, frame.shape[1], frame.shape[0])
                yield self._steady(np.ascontiguousarray(frame[top:bottom, left:right]), number - self.first)

    def _steady(self, frame: Image, number: int) -> Image:
        if self.shifts is None or number >= len(self.shifts):
            return frame
        cv2 = opencv(self.path)
        back = np.column_stack([np.eye(2), -self.shifts[number]])
        size = (frame.shape[1], frame.shape[0])
        moved: Image = cv2.warpAffine(frame, back, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return moved

    def _decoded(self) -> Iterator[Any]:
        cv2 = opencv(self.path)
        if self.path.is_dir():
            for name in _pictures(self.path):
                picture = cv2.imdecode(np.frombuffer(name.read_bytes(), dtype=np.uint8), cv2.IMREAD_COLOR)
                if picture is None:
                    raise InputError(f"{name}: damaged picture")
                yield picture
            return
        reader, read = cv2.VideoCapture(str(self.path)), 0
        try:
            while (got := reader.read())[0]:
                read += 1
                yield got[1]
        finally:
            reader.release()
        if read < 0.8 * self.count:  # of the frames that a file states
            raise InputError(
                f"{self.path}: damaged: {read} of {self.count} frames could be read; copy it again or re-encode it"
            )


def opencv(path: Path) -> Any:
    """The module ``cv2``, an extra; raises `InputError` where it is not installed."""
    try:
        import cv2
    except ImportError as error:
        raise InputError(f"{path}: reading a film needs the extra: pip install 'shakerbench[video]'") from error
    return cv2


def smaller(frame: Any, factor: float, least: int, cv2: Any) -> Any:
    """A picture made smaller by ``factor``, at least so many pixels wide and high."""
    size = (max(int(frame.shape[1] * factor), least), max(int(frame.shape[0] * factor), least))
    return cv2.resize(frame, size, interpolation=cv2.INTER_AREA)


def open_film(path: Path) -> Film:
    """A film or a folder of pictures; raises `InputError` where it is none, or has too few frames."""
    cv2 = opencv(path)
    if path.is_dir():
        count, fps = len(_pictures(path)), None
    else:
        reader = cv2.VideoCapture(str(path))
        is_open = reader.isOpened()
        count, rate = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)), float(reader.get(cv2.CAP_PROP_FPS))
        reader.release()
        if not is_open or count <= 0:
            raise InputError(f"{path}: cannot be read as a film; it is damaged, or of a kind this OpenCV cannot decode")
        fps = rate if np.isfinite(rate) and rate > 0 else None
    if count < LEAST_FRAMES:
        raise InputError(f"{path}: {count} frames are too few for a drop; at least {LEAST_FRAMES} are needed")
    return Film(path, fps, count)


def part_of(film: Film, corrections: Corrections) -> Film:
    """The film between two times and within a region of the picture; raises `InputError` where nothing is left."""
    fps, end = film.fps or 1.0, film.count - 1
    first = 0 if corrections.from_s is None else max(round(corrections.from_s * fps), 0)
    last = end if corrections.until_s is None else min(round(corrections.until_s * fps), end)
    if last - first + 1 < LEAST_FRAMES:
        raise InputError(f"{film.path}: --from and --until leave {max(last - first + 1, 0)} of {film.count} frames")
    if corrections.until_s is None:
        last = film.last  # a file may hold more frames than it states
    part = replace(film, first=first, last=last, region=corrections.region)
    if corrections.region is not None:
        shape = next(part.frames()).shape
        if min(shape[:2]) < 16:  # pixels
            raise InputError(f"{film.path}: --region leaves {shape[1]} x {shape[0]} pixels of the picture")
    return part


def _pictures(folder: Path) -> list[Path]:
    """The pictures of a folder in the order of their numbers."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in PICTURES]
    return sorted(found, key=lambda p: [int(x) if x.isdigit() else x for x in re.split(r"(\d+)", p.name)])
