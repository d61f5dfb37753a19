"""What of a film stands still: frames of a camera held in the hand brought onto the first, and the background.

The shift of each frame is found by least squares (Lucas and Kanade 1981): the whole picture is moved onto the first
frame. Every pixel counts by its gradient, so the edge of a floor is enough along the fall; pixels that something moved
over count for nothing (Tukey's biweight). The background is free of the ball that lingers in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.corrections import Progress
from analysis.drop.film.video import LEAST_FRAMES, Film, Image, opencv, smaller
from analysis.statistics import mad_sigma
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers

Grey = NDArray[np.float32]

_COARSE = 4.0  # by which pictures are made smaller first: steps of many pixels
_LINE = 64  # pixels that are looked up together
_TUKEY = 4.7
_LEAST_NOISE = 0.5  # levels
_ALIKE = 10.0  # neighbouring pixels that err alike: compression, noise that is no pixel's own
_STRIPS = 6


def stabilised(film: Film, progress: Progress | None = None) -> Film:
    """The film with its frames moved back onto the first, where the camera moved; else the film as it is.

    The result says whether the picture has edges that would show a motion along its columns.
    """
    cv2 = opencv(film.path)
    shifts: list[Floats] = []
    better: list[float] = []
    left: list[float] = []
    error: list[float] = []
    coarse: _Edges | None = None
    fine: _Edges | None = None
    factor = 1.0
    for number, frame in enumerate(film.frames()):
        # the search works on 640 columns at most
        factor = min(1.0, 640 / frame.shape[1])
        small, large = _grey(frame, factor / _COARSE, cv2), _grey(frame, factor, cv2)
        if coarse is None or fine is None:
            coarse, fine = _edges(small, cv2), _edges(large, cv2)
        before = shifts[-1] if shifts else np.zeros(2)
        shift = fine.shift_of(large, before)
        # half more than usually left: perhaps a step of many pixels
        if left and fine.difference(large, shift) > 1.5 * float(np.median(left)):
            roughly = fine.shift_of(large, _COARSE * coarse.shift_of(small, before / _COARSE))
            if fine.difference(large, roughly) < fine.difference(large, shift):
                shift = roughly
        shifts.append(shift)
        if number % 8 == 1:  # frames, of which one is looked at more closely
            better.append(fine.share_left(large, shift))
            left.append(fine.difference(large, shift))
            error.append(fine.error_down(large, shift))
        if progress is not None:
            progress("steadying", number + 1, film.count)
    table = np.array(shifts).reshape(-1, 2)
    watched = bool(error) and float(np.median(error)) < 0.25
    shaken = float(np.hypot(*np.std(table, axis=0))) if len(table) else 0.0
    # moving frames back must take away a quarter of what differs at edges, or the camera did not shake
    if shaken < 0.1 or not np.median(better) < 0.75:  # px rms, at the width of the search
        return replace(film, watched=watched)
    return replace(film, shifts=table / factor, watched=watched)


def _grey(frame: Any, factor: float, cv2: Any) -> Grey:
    """A frame in grey, smaller by ``factor``, of the usual brightness (mains flicker)."""
    grey = cv2.cvtColor(smaller(frame, factor, 16, cv2), cv2.COLOR_BGR2GRAY)
    soft = np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.0), dtype=np.float32)
    soft *= 128.0 / max(float(np.median(soft)), 1.0)
    return soft


def _edges(grey: Grey, cv2: Any) -> _Edges:
    """The pixels of the first frame that show a shift best, as many across as down."""
    down, across = np.gradient(grey)
    inside = np.zeros(grey.shape, dtype=bool)
    inside[4:-4, 4:-4] = True  # pixels of a margin
    chosen = np.zeros(grey.shape, dtype=bool)
    for slope in (np.abs(across), np.abs(down)):
        # the steepest 3 % of the pixels, across and down, show a motion best
        chosen |= inside & (slope >= np.quantile(slope[inside], 1.0 - 0.03))
    place = np.argwhere(chosen)
    row, column = np.resize(place, (-(-len(place) // _LINE) * _LINE, 2)).T  # whole lines; the first pixels again
    gradient = np.column_stack([np.asarray(slope)[row, column] for slope in (across, down)]).astype(np.float64)
    at_row, at_column = (part.astype(np.float32).reshape(-1, _LINE) for part in (row, column))
    strip = (column * _STRIPS // grey.shape[1]).astype(np.int64)
    return _Edges(at_row, at_column, grey[row, column].astype(np.float64), gradient, strip, cv2)


@dataclass(frozen=True)
class _Edges:
    """The first frame where it is steep: rows and columns (in lines of 64), brightness, gradients across and down."""

    row: Grey  # (pixels / 64, 64)
    column: Grey
    level: Floats  # (pixels,)
    gradient: Floats  # (pixels, 2)
    strip: Integers  # (pixels,) upright strip of the picture: what falls stays in a few of them
    cv2: Any

    def residual(self, grey: Grey, shift: Floats) -> Floats:
        """Brightness of a frame at the edges' places moved by ``shift``, less that of the first frame there."""
        column, row = self.column + np.float32(shift[0]), self.row + np.float32(shift[1])
        seen = self.cv2.remap(grey, column, row, self.cv2.INTER_CUBIC, borderMode=self.cv2.BORDER_REPLICATE)
        return np.asarray(seen.ravel() - self.level, dtype=np.float64)

    def difference(self, grey: Grey, shift: Floats) -> float:
        """Median difference of a frame from the first, levels."""
        return float(np.median(np.abs(self.residual(grey, shift))))

    def shift_of(self, grey: Grey, before: Floats) -> Floats:
        """Shift (across, down) of a frame, px; near that of the frame ``before`` in a direction that no edge shows."""
        shift = before
        for _ in range(15):  # of the least squares of a frame
            off = self.residual(grey, shift)
            size = max(mad_sigma(off), _LEAST_NOISE)
            weight = np.maximum(1.0 - (off / (_TUKEY * size)) ** 2, 0.0) ** 2
            weighted = self.gradient * weight[:, None]
            # where no edge shows it a hand moves by about a pixel from frame to frame
            prior = _ALIKE * size**2
            normal = weighted.T @ self.gradient + prior * np.eye(2)
            change = np.linalg.solve(normal, weighted.T @ off + prior * (shift - before))
            shift = shift - np.clip(change, -2.0, 2.0)  # px, of one step
            if float(np.abs(change).max()) < 5e-3:
                break
        return shift

    def error_down(self, grey: Grey, shift: Floats) -> float:
        """Standard error of a frame's shift down, px, from the gradients that it has in common with the first frame.

        Noise has none in common, so a bare wall has a large error however steep its noise is.
        """
        off, half = self.residual(grey, shift), np.array([0.0, 0.5])
        slope = self.residual(grey, shift + half) - self.residual(grey, shift - half)
        size = max(mad_sigma(off), _LEAST_NOISE)
        ours = np.abs(off) < _TUKEY * size
        each = np.bincount(self.strip[ours], self.gradient[ours, 1] * slope[ours], minlength=_STRIPS)
        common = _STRIPS * float(np.median(each))
        return size * float(np.sqrt(_ALIKE / max(common, 1e-9)))

    def share_left(self, grey: Grey, shift: Floats) -> float:
        """Share of a frame's difference that is left after moving it back, in the usual strip of the picture."""
        steep = np.hypot(self.gradient[:, 0], self.gradient[:, 1])
        before, after = (
            np.bincount(self.strip, steep * np.abs(self.residual(grey, at)), minlength=_STRIPS)
            for at in (np.zeros(2), shift)
        )
        return float(np.median(after / np.maximum(before, 1e-12)))


Picture = NDArray[np.float32]

SEARCH_WIDTH = 640  # frames are searched at this width, and measured at full size
_CHANGED_LEVELS = 20.0
_CUT_SHARE = 0.2
_MOST_SAMPLES = 31
_ENDS = 9  # first and last frames that are compared
_ROWS = 64  # of a picture that are held at once for all frames


@dataclass(frozen=True)
class Still:
    """The part of a film that stands still."""

    background: Picture  # (rows, columns, 3) median of frames in which something small moves
    small: Picture  # (rows, columns, 3) the same at `SEARCH_WIDTH`
    n_frames: int  # frames read
    repeated: Integers  # (k,) frames that show again what the frame before showed, while the ball moves


def still_of(film: Film, progress: Progress | None = None) -> Still:
    """The background of a film; raises `InputError` where nothing moves, or the film has a cut."""
    cv2 = opencv(film.path)
    small = []
    for number, frame in enumerate(film.frames()):
        # 320 columns show whether anything moves
        reduced = smaller(frame, min(1.0, 320 / frame.shape[1]), 8, cv2)
        small.append(cv2.cvtColor(reduced, cv2.COLOR_BGR2GRAY))
        if progress is not None:
            progress("looking", number + 1, film.count)
    stack = np.array(small, dtype=np.float32)
    if len(stack) < LEAST_FRAMES:
        raise InputError(f"{film.path}: {len(stack)} frames are too few for a drop")
    stack /= np.maximum(np.median(stack, axis=(1, 2), keepdims=True), 1.0) / max(float(np.median(stack)), 1.0)
    step = np.abs(np.diff(stack, axis=0))
    # a cut changes a large part of the picture at once, and for good
    for k in range(1, len(stack)):
        if float((step[k - 1] > _CHANGED_LEVELS).mean()) > _CUT_SHARE:
            before, after = np.median(stack[max(k - 4, 0) : k], axis=0), np.median(stack[k : k + 4], axis=0)
            if float((np.abs(after - before) > _CHANGED_LEVELS).mean()) > _CUT_SHARE:
                raise InputError(
                    f"{film.path}: a cut in the film between frames {k - 1} and {k}: a large part of the picture "
                    "changes at once; cut the clip so that it holds one drop seen by a camera at rest"
                )
    chosen = _clean_frames(stack, step, film)
    largest = step.max(axis=(1, 2))
    # repeated: a frame that differs from the one before by less than 0.6 levels and a tenth of what is usual
    same = largest < np.minimum(0.6, 0.1 * float(np.median(largest)))
    moves = largest > _CHANGED_LEVELS
    repeated = np.flatnonzero(same[1:-1] & moves[:-2] & moves[2:]) + 2  # those between two that differ
    background = _median([frame for number, frame in enumerate(film.frames()) if number in chosen])
    return _still(background, len(stack), repeated.astype(np.int64), film)


def _still(background: Picture, count: int, repeated: Integers, film: Film) -> Still:
    factor = min(1.0, SEARCH_WIDTH / background.shape[1])
    return Still(background, smaller(background, factor, 1, opencv(film.path)), count, repeated)


def _median(frames: Sequence[Image]) -> Picture:
    height = range(0, frames[0].shape[0], _ROWS)
    return np.concatenate([np.median(np.array([f[r : r + _ROWS] for f in frames]), axis=0) for r in height]).astype(
        np.float32
    )


def still_by_order(film: Film, still: Still) -> Still:
    """The background of a film that starts with the ball above where it ends.

    Where the first and the last frames differ, the upper parts are taken from the last, the lower from the first. So
    a block that covers one place for most of the film does not stay behind in the background.
    """
    cv2 = opencv(film.path)
    first: list[Image] = []
    last: list[Image] = []
    for frame in film.frames():
        if len(first) < _ENDS:
            first.append(frame)
        last = [*last[-(_ENDS - 1) :], frame]
    start = first[0].astype(np.float32)
    early = _median([f for f in first if float(np.percentile(np.abs(f - start), 99.9)) < _CHANGED_LEVELS])
    late = _median(last)
    change = cv2.GaussianBlur(np.abs(early - late).max(axis=2), (0, 0), 1.5)
    changed = (change > max(4.0 * mad_sigma(change), 6.0)).astype(np.uint8)  # levels
    mask = cv2.dilate(changed, np.ones((5, 5), np.uint8), iterations=2)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
    background = late.copy()
    big = [k for k in range(1, len(stats)) if stats[k, cv2.CC_STAT_AREA] > 2e-4 * mask.size]  # of the picture
    if len(big) >= 2:
        heights = centres[big, 1]
        middle = 0.5 * (float(heights.min()) + float(heights.max()))
        for k in big:
            if float(centres[k, 1]) > middle:  # rows count downward: here the ball is at the end
                background[labels == k] = early[labels == k]
    elif big:  # one region that holds both places: its upper half is from the end, its lower half from the start
        part = labels == big[0]
        rows = np.nonzero(part)[0]
        lower = rows > 0.5 * (int(rows.min()) + int(rows.max()))
        background[part] = np.where(lower[:, None], early[part], late[part])
    return _still(background, still.n_frames, still.repeated, film)


def _clean_frames(stack: Picture, step: Picture, film: Film) -> set[int]:
    """Frames to take the background from: something moves, but not a person through half of the picture.

    Of these, those that differ most from each other: where the ball lingers, few of them show it there.
    """
    changed = (np.abs(stack - np.median(stack, axis=0)) > _CHANGED_LEVELS).mean(axis=(1, 2))
    motion = step.max(axis=(1, 2))
    if float(np.percentile(motion, 98)) < _CHANGED_LEVELS:
        raise InputError(f"{film.path}: no motion: {len(stack)} frames show the same still scene")
    motion = np.append(motion, motion[-1])
    calm = np.flatnonzero(changed < max(0.06, float(np.percentile(changed, 25))))
    still, lively = np.percentile(motion[calm], [5, 95])
    busy = calm[motion[calm] >= still + 0.25 * (lively - still)]  # not the ball's rest: it would stay behind
    pool = busy if len(busy) >= 9 else calm
    chosen, coarse = [int(pool[0])], stack[pool][:, ::4, ::4]
    distance = np.full(len(pool), np.inf)
    while len(chosen) < min(_MOST_SAMPLES, len(pool)):
        differs: Bools = np.abs(coarse - stack[chosen[-1], ::4, ::4]) > _CHANGED_LEVELS
        distance = np.minimum(distance, differs.mean(axis=(1, 2)))
        distance[pool == chosen[-1]] = -1.0
        chosen.append(int(pool[int(distance.argmax())]))
    return set(chosen)
