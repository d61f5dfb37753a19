"""Films of a camera held in the hand: the shift of each frame by least squares (Lucas and Kanade 1981).

The whole picture is moved onto the first frame. Every pixel counts by its gradient, so the edge of a floor is enough
along the fall; pixels that something moved over count for nothing (Tukey's biweight).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film.video import Film, opencv
from analysis.drop.options.progress import Progress
from analysis.statistics import MAD_TO_SIGMA

Array = NDArray[np.float64]
Grey = NDArray[np.float32]

_WIDTH = 640
_COARSE = 4.0  # by which pictures are made smaller first: steps of many pixels
_LEAST_SHIFT_PX = 0.1  # rms, at the width at which shifts are measured
_BETTER = 0.75  # of what differs from frame to frame at edges, that may be left after moving frames back
_EDGES = 0.03  # of the pixels, those with the steepest gradients across, and as many down
_MARGIN = 4  # pixels
_LINE = 64  # pixels that are looked up together
_TUKEY = 4.7
_LEAST_NOISE = 0.5  # levels
_STEP_PX = 1.0  # standard deviation of the hand's motion from frame to frame, where no edge shows it
_ALIKE = 10.0  # neighbouring pixels that err alike: compression, noise that is no pixel's own
_STRIPS = 6
_STEPS, _LONGEST_STEP_PX, _ARRIVED_PX = 15, 2.0, 5e-3
_EVERY = 8  # frames, of which one is looked at more closely
_WATCHED_PX = 0.25
_LOST = 1.5  # times what usually is left: perhaps a step of many pixels


@dataclass(frozen=True)
class _Edges:
    """The first frame where it is steep: rows and columns (in lines of 64), brightness, gradients across and down."""

    row: Grey  # (pixels / 64, 64)
    column: Grey
    level: Array  # (pixels,)
    gradient: Array  # (pixels, 2)
    strip: NDArray[np.int64]  # (pixels,) upright strip of the picture: what falls stays in a few of them


def stabilised(film: Film, progress: Progress | None = None) -> Film:
    """The film with its frames moved back onto the first, where the camera moved; else the film as it is.

    The result tells whether the picture has edges that would show a motion along its columns.
    """
    cv2 = opencv(film.path)
    shifts: list[Array] = []
    better: list[float] = []
    left: list[float] = []
    error: list[float] = []
    coarse: _Edges | None = None
    fine: _Edges | None = None
    factor = 1.0
    for number, frame in enumerate(film.frames()):
        factor = min(1.0, _WIDTH / frame.shape[1])
        small, large = _grey(frame, factor / _COARSE, cv2), _grey(frame, factor, cv2)
        if coarse is None or fine is None:
            coarse, fine = _edges(small), _edges(large)
        before = shifts[-1] if shifts else np.zeros(2)
        shift = _shift(fine, large, before, cv2)
        if left and _apart(fine, large, shift, cv2) > _LOST * float(np.median(left)):
            roughly = _shift(fine, large, _COARSE * _shift(coarse, small, before / _COARSE, cv2), cv2)
            shift = min((shift, roughly), key=lambda s: _apart(fine, large, s, cv2))
        shifts.append(shift)
        if number % _EVERY == 1:
            better.append(_left_of(fine, large, shift, cv2))
            left.append(_apart(fine, large, shift, cv2))
            error.append(_error_down(fine, large, shift, cv2))
        if progress is not None:
            progress("steadying", number + 1, film.count)
    table = np.array(shifts).reshape(-1, 2)
    watched = bool(error) and float(np.median(error)) < _WATCHED_PX
    shaken = float(np.hypot(*np.std(table, axis=0))) if len(table) else 0.0
    if shaken < _LEAST_SHIFT_PX or not np.median(better) < _BETTER:
        return replace(film, watched=watched)
    return replace(film, shifts=table / factor, watched=watched)


def _grey(frame: Any, factor: float, cv2: Any) -> Grey:
    """A frame in grey, smaller by ``factor``, of the usual brightness (mains flicker)."""
    size = (max(int(frame.shape[1] * factor), 16), max(int(frame.shape[0] * factor), 16))
    grey = cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    soft = np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.0), dtype=np.float32)
    soft *= 128.0 / max(float(np.median(soft)), 1.0)
    return soft


def _edges(grey: Grey) -> _Edges:
    """The pixels of the first frame that show a shift best, as many across as down."""
    down, across = np.gradient(grey)
    inside = np.zeros(grey.shape, dtype=bool)
    inside[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN] = True
    chosen = np.zeros(grey.shape, dtype=bool)
    for slope in (np.abs(across), np.abs(down)):
        chosen |= inside & (slope >= np.quantile(slope[inside], 1.0 - _EDGES))
    place = np.argwhere(chosen)
    row, column = np.resize(place, (-(-len(place) // _LINE) * _LINE, 2)).T  # whole lines; the first pixels again
    gradient = np.column_stack([np.asarray(slope)[row, column] for slope in (across, down)]).astype(np.float64)
    lines = [part.astype(np.float32).reshape(-1, _LINE) for part in (row, column)]
    strip = (column * _STRIPS // grey.shape[1]).astype(np.int64)
    return _Edges(lines[0], lines[1], grey[row, column].astype(np.float64), gradient, strip)


def _shift(edges: _Edges, grey: Grey, before: Array, cv2: Any) -> Array:
    """Shift (across, down) of a frame, px; near that of the frame ``before`` in a direction that no edge shows."""
    shift = before
    for _ in range(_STEPS):
        off = _residual(edges, grey, shift, cv2)
        size = max(MAD_TO_SIGMA * float(np.median(np.abs(off))), _LEAST_NOISE)
        weight = np.maximum(1.0 - (off / (_TUKEY * size)) ** 2, 0.0) ** 2
        weighted = edges.gradient * weight[:, None]
        prior = _ALIKE * (size / _STEP_PX) ** 2
        normal = weighted.T @ edges.gradient + prior * np.eye(2)
        change = np.linalg.solve(normal, weighted.T @ off + prior * (shift - before))
        shift = shift - np.clip(change, -_LONGEST_STEP_PX, _LONGEST_STEP_PX)
        if float(np.abs(change).max()) < _ARRIVED_PX:
            break
    return shift


def _residual(edges: _Edges, grey: Grey, shift: Array, cv2: Any) -> Array:
    """What the frame shows at the edges' places moved by ``shift``, less what the first frame showed there."""
    column, row = edges.column + np.float32(shift[0]), edges.row + np.float32(shift[1])
    seen = cv2.remap(grey, column, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen.ravel() - edges.level, dtype=np.float64)


def _error_down(edges: _Edges, grey: Grey, shift: Array, cv2: Any) -> float:
    """Standard error of a frame's shift down, px, from the gradients that it has in common with the first frame.

    Noise has none in common, so a bare wall has a large error however steep its noise is.
    """
    off = _residual(edges, grey, shift, cv2)
    slope = _residual(edges, grey, shift + np.array([0.0, 0.5]), cv2)
    slope = slope - _residual(edges, grey, shift - np.array([0.0, 0.5]), cv2)
    size = max(MAD_TO_SIGMA * float(np.median(np.abs(off))), _LEAST_NOISE)
    ours = np.abs(off) < _TUKEY * size
    each = np.bincount(edges.strip[ours], edges.gradient[ours, 1] * slope[ours], minlength=_STRIPS)
    common = _STRIPS * float(np.median(each))
    return size * float(np.sqrt(_ALIKE / max(common, 1e-9)))


def _apart(edges: _Edges, grey: Grey, shift: Array, cv2: Any) -> float:
    """Median difference of a frame from the first at the edges, levels."""
    return float(np.median(np.abs(_residual(edges, grey, shift, cv2))))


def _left_of(edges: _Edges, grey: Grey, shift: Array, cv2: Any) -> float:
    """Share of the difference at edges that is left after moving a frame back, in the usual strip of the picture."""
    steep = np.hypot(edges.gradient[:, 0], edges.gradient[:, 1])
    before, after = (
        np.bincount(edges.strip, steep * np.abs(_residual(edges, grey, at, cv2)), minlength=_STRIPS)
        for at in (np.zeros(2), shift)
    )
    return float(np.median(after / np.maximum(before, 1e-12)))
