"""Background of a film, free of the ball that lingers in it; and films in which nothing can be tracked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.corrections import Progress
from analysis.drop.film.video import LEAST_FRAMES, Film, Image, opencv, smaller
from analysis.statistics import mad_sigma
from daq.setup.errors import InputError
from kernels.arrays import Bools, Integers

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


def still_without(film: Film, still: Still, boxes: dict[int, tuple[float, float, float, float]]) -> Still:
    """The background from frames whose ball is known: each pixel's median over those in which no ball covers it.

    ``boxes``: x, y, width and height of the ball by frame number.
    """

    def span(centre: float, size: float, limit: int) -> slice:
        reach = 0.5 * size + max(0.12 * size, 4.0)
        return slice(max(int(centre - reach), 0), min(int(centre + reach) + 2, limit))

    numbers = sorted(boxes)
    chosen = {numbers[i] for i in np.unique(np.linspace(0, len(numbers) - 1, _MOST_SAMPLES).astype(int))}
    frames, covers = [], []
    for number, frame in enumerate(film.frames()):
        if number in chosen:
            x, y, wide, tall = boxes[number]
            cover = np.zeros(frame.shape[:2], dtype=bool)
            cover[span(y, tall, frame.shape[0]), span(x, wide, frame.shape[1])] = True
            frames.append(frame)
            covers.append(cover)
    background = still.background.copy()
    for r in range(0, background.shape[0], _ROWS):
        rows = slice(r, r + _ROWS)
        values = np.array([f[rows] for f in frames], dtype=np.float32)
        hidden = np.array([c[rows] for c in covers])
        values[hidden] = np.nan
        count = (~hidden).sum(axis=0)
        ordered = np.sort(values, axis=0)  # NaN last: far faster than nanmedian
        middle = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, len(frames) - 1)
        low, high = (np.take_along_axis(ordered, at[None, :, :, None], axis=0)[0] for at in middle)
        enough = count >= 3  # frames in which a pixel is seen without the ball
        background[rows][enough] = (0.5 * (low + high))[enough]
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
