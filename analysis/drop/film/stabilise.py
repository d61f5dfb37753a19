"""Films of a camera held in the hand: the shift of each frame by phase correlation (Kuglin and Hines 1975)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film.video import Film, opencv
from analysis.drop.options.progress import Progress

Array = NDArray[np.float64]

_WIDTH = 640
_TILES = 3
_LEAST_SHIFT_PX = 0.3  # rms, at the width at which shifts are measured
_BETTER = 0.75  # of what differs from frame to frame, that may be left after moving frames back


def stabilised(film: Film, progress: Progress | None = None) -> Film:
    """The film with its frames moved back onto the first, where the camera moved; else the film as it is."""
    cv2 = opencv(film.path)
    shifts: list[tuple[float, float]] = []
    still: list[float] = []
    moved: list[float] = []
    first: NDArray[np.float32] | None = None
    factor = 1.0
    for number, frame in enumerate(film.frames()):
        factor = min(1.0, _WIDTH / frame.shape[1])
        size = (max(int(frame.shape[1] * factor), 8), max(int(frame.shape[0] * factor), 8))
        grey = cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0), dtype=np.float32)
        grey *= 128.0 / max(float(np.median(grey)), 1.0)  # mains flicker
        if first is None:
            first = grey
        dx, dy = _shift(first, grey, cv2)
        shifts.append((dx, dy))
        if number % 8 == 0:
            back = np.array([[1.0, 0.0, -dx], [0.0, 1.0, -dy]])
            still.append(float(np.median(np.abs(grey - first))))
            moved.append(float(np.median(np.abs(cv2.warpAffine(grey, back, size, flags=cv2.INTER_CUBIC) - first))))
        if progress is not None:
            progress("steadying", number + 1, film.count)
    table = np.array(shifts).reshape(-1, 2)
    shaken = float(np.hypot(*np.std(table, axis=0))) if len(table) else 0.0
    if shaken < _LEAST_SHIFT_PX or not np.median(moved) < _BETTER * np.median(still):
        return film
    return replace(film, shifts=table / factor)


def _shift(first: NDArray[np.float32], frame: NDArray[np.float32], cv2: Any) -> tuple[float, float]:
    """Median over tiles of the picture, of which the ball disturbs few."""
    rows, columns = first.shape[0] // _TILES, first.shape[1] // _TILES
    window = cv2.createHanningWindow((columns, rows), cv2.CV_32F)
    found = []
    for i in range(_TILES):
        for j in range(_TILES):
            part = (slice(i * rows, (i + 1) * rows), slice(j * columns, (j + 1) * columns))
            # copies: phaseCorrelate multiplies its arguments in place
            found.append(cv2.phaseCorrelate(first[part].copy(), frame[part].copy(), window)[0])
    dx, dy = np.median(np.array(found), axis=0)
    return float(dx), float(dy)
