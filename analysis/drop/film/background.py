"""What stands still in a film, free of the ball that lingers in it; and films in which nothing can be tracked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film.video import LEAST_FRAMES, Film, Image, opencv
from analysis.drop.options.progress import Progress
from analysis.statistics import MAD_TO_SIGMA
from daq.setup.errors import InputError

SEARCH_WIDTH = 640  # frames are searched at this width, and measured at full size
_SMALL_WIDTH = 320
_CHANGED_LEVELS = 20.0
_SAME_LEVELS = 0.6
_CUT_SHARE = 0.2
_MOST_SAMPLES = 31
_LIVELY_SHARE = 0.25
_ENDS = 9  # first and last frames that are compared
_LEAST_APART = 6.0  # levels
_LEAST_PART = 2e-4  # of the picture
_LEAST_CLEAR = 3  # frames in which a pixel is seen without the ball


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
    repeated : (k,) int64
        Frames that show again what the frame before showed, while the ball moves.
    """

    background: NDArray[np.float32]
    small: NDArray[np.float32]
    n_frames: int
    repeated: NDArray[np.int64]


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
    if len(stack) < LEAST_FRAMES:
        raise InputError(f"{film.path}: {len(stack)} frames are too few for a drop")
    stack /= np.maximum(np.median(stack, axis=(1, 2), keepdims=True), 1.0) / max(float(np.median(stack)), 1.0)
    _refuse_cut(stack, film)
    chosen = _clean_frames(stack, film)
    kept = [frame for number, frame in enumerate(film.frames()) if number in chosen]
    return _still(_median(kept), len(stack), _repeated(stack), film)


def _still(background: NDArray[np.float32], count: int, repeated: NDArray[np.int64], film: Film) -> Still:
    cv2 = opencv(film.path)
    factor = min(1.0, SEARCH_WIDTH / background.shape[1])
    size = (int(background.shape[1] * factor), int(background.shape[0] * factor))
    return Still(background, cv2.resize(background, size, interpolation=cv2.INTER_AREA), count, repeated)


def _median(frames: Sequence[Image]) -> NDArray[np.float32]:
    """Median of pictures, a few rows at a time."""
    rows = [np.median(np.array([f[r : r + 64] for f in frames]), axis=0) for r in range(0, frames[0].shape[0], 64)]
    return np.concatenate(rows).astype(np.float32)


def _repeated(stack: NDArray[np.float32]) -> NDArray[np.int64]:
    """Frames equal to the one before between frames that are not."""
    step = np.abs(np.diff(stack, axis=0)).max(axis=(1, 2))
    same = step < np.minimum(_SAME_LEVELS, 0.1 * float(np.median(step)))
    moves = step > _CHANGED_LEVELS
    inner = np.flatnonzero(same[1:-1] & moves[:-2] & moves[2:]) + 1
    return np.asarray(inner + 1, dtype=np.int64)


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
    early, late = first[0].astype(np.float32), _median(last)
    first = [f for f in first if float(np.percentile(np.abs(f.astype(np.float32) - early), 99.9)) < _CHANGED_LEVELS]
    early = _median(first)
    apart = cv2.GaussianBlur(np.abs(early - late).max(axis=2), (0, 0), 1.5)
    noise = MAD_TO_SIGMA * float(np.median(apart))
    brush = np.ones((5, 5), np.uint8)
    mask = cv2.dilate((apart > max(4.0 * noise, _LEAST_APART)).astype(np.uint8), brush, iterations=2)
    _, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
    background = late.copy()
    big = [k for k in range(1, len(stats)) if stats[k, cv2.CC_STAT_AREA] > _LEAST_PART * mask.size]
    if len(big) >= 2:
        heights = centres[big, 1]
        middle = 0.5 * (float(heights.min()) + float(heights.max()))
        for k in big:
            if float(centres[k, 1]) > middle:  # rows count downward: here the ball is at the end
                background[labels == k] = early[labels == k]
    elif len(big) == 1:
        background[labels == big[0]] = _split(early, late, labels == big[0])
    return _still(background, still.n_frames, still.repeated, film)


def _split(early: NDArray[np.float32], late: NDArray[np.float32], part: NDArray[np.bool_]) -> NDArray[np.float32]:
    """One region that holds both places: its upper half from the end, its lower half from the start."""
    rows = np.nonzero(part)[0]
    lower = rows > 0.5 * (int(rows.min()) + int(rows.max()))
    return np.where(lower[:, None], early[part], late[part])


def still_without(film: Film, still: Still, boxes: dict[int, tuple[float, float, float, float]]) -> Still:
    """The background from frames whose ball is known: each pixel's median over those in which no ball covers it.

    ``boxes``: x, y, width and height of the ball by frame number.
    """
    numbers = sorted(boxes)
    chosen = {numbers[i] for i in np.unique(np.linspace(0, len(numbers) - 1, _MOST_SAMPLES).astype(int))}
    frames, covers = [], []
    for number, frame in enumerate(film.frames()):
        if number in chosen:
            x, y, wide, tall = boxes[number]
            cover = np.zeros(frame.shape[:2], dtype=bool)
            cover[_span(y, tall, frame.shape[0]), _span(x, wide, frame.shape[1])] = True
            frames.append(frame)
            covers.append(cover)
    background = still.background.copy()
    for r in range(0, background.shape[0], 64):
        rows = slice(r, r + 64)
        values = np.array([f[rows] for f in frames], dtype=np.float32)
        hidden = np.array([c[rows] for c in covers])
        values[hidden] = np.nan
        enough = (~hidden).sum(axis=0) >= _LEAST_CLEAR
        ordered = np.sort(values, axis=0)  # NaN last
        count = (~hidden).sum(axis=0)
        low = np.take_along_axis(ordered, np.maximum((count - 1) // 2, 0)[None, :, :, None], axis=0)[0]
        upper = np.minimum(count // 2, len(frames) - 1)[None, :, :, None]
        high = np.take_along_axis(ordered, upper, axis=0)
        part = background[rows]
        part[enough] = (0.5 * (low + high[0]))[enough]
    return _still(background, still.n_frames, still.repeated, film)


def _span(centre: float, size: float, limit: int) -> slice:
    reach = 0.5 * size + max(0.12 * size, 4.0)
    return slice(max(int(centre - reach), 0), min(int(centre + reach) + 2, limit))


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
