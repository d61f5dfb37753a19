"""The moving things in every frame of a film, to a tenth of a pixel.

A position is the centre of the area that differs from what stands still, with soft edges that
saturate at half of the contrast. So texture, a rod across the block and a change of brightness do not pull it, and
motion blur, which is the same at both ends, moves it to the middle of the exposure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from analysis.drop.film.background import SEARCH_WIDTH, Still, still_by_order, still_of, still_without
from analysis.drop.film.linking import Track, ball_of
from analysis.drop.film.stabilise import stabilised
from analysis.drop.film.video import Film, Image, open_film, opencv, part_of
from analysis.drop.options.corrections import NOTHING, Corrections
from analysis.drop.options.progress import Progress
from analysis.statistics import MAD_TO_SIGMA
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_NOISE_SIGMAS = 6.0
_LEAST_CONTRAST = 10.0
_MOST_BLOBS = 12
_SAME_SPAN = 0.6  # of their heights, that two parts beside a rod have in common; less than all where it leans
_UNSTEADY = 0.12  # spread of a spot's height beyond which its background is suspected
_STAMP_LEVELS = 40.0
_WIDEST = 0.6  # of the picture: more is a person, or the light
_LEAST_AREA = 9.0  # of search pixels
_SHADOW_SHARE = 0.4  # of a spot's contrast: what is fainter is its shadow or its reflection


@dataclass(frozen=True)
class Tracked:
    """The ball in a film.

    Attributes
    ----------
    track : Track
        In pixels and frames.
    x_px, y_px : (n,) float64
        Centre of each of the track's points in the picture.
    width_px, tall_px : (n,) float64
        Size of the moving area of each.
    background : (rows, columns, 3) uint8
    composite : (rows, columns, 3) uint8
        The ball stamped from every few frames onto the background.
    fps : float or None
        As the file states.
    n_frames, first : int
        Frames that were used, and the number of the first in the file.
    lost : (m,) int64
        Frames between the track's first and last in which the ball was not found.
    watched : bool
        The picture has edges that show whether the camera moved along its columns.
    """

    track: Track
    x_px: Array
    y_px: Array
    width_px: Array
    tall_px: Array
    background: Image
    composite: Image
    fps: float | None
    n_frames: int
    lost: NDArray[np.int64]
    remarks: tuple[str, ...] = ()
    watched: bool = True
    first: int = 0


def track_film(path: Path, progress: Progress | None = None, corrections: Corrections = NOTHING) -> Tracked:
    """Find and follow the ball in a film or a folder of pictures.

    Raises
    ------
    InputError
        Damaged, cut, without motion, without free flight, or with two things in it.
    """
    film = stabilised(part_of(open_film(path), corrections), progress)
    still = still_of(film, progress)
    best = _attempt(film, still, corrections, progress)
    if isinstance(best, InputError) or best.unsteady > _UNSTEADY:
        other = _attempt(film, still_by_order(film, still), corrections, progress)
        if not isinstance(other, InputError):
            boxes = {int(row[0]): (row[1], row[2], row[3], row[4]) for row in other.size}
            again = _attempt(film, still_without(film, other.still, boxes), corrections, progress)
            if not isinstance(again, InputError) and again.unsteady <= other.unsteady:
                other = again
            if isinstance(best, InputError) or other.unsteady < best.unsteady:
                best = other
    if isinstance(best, InputError):
        raise best
    track, size, still = best.track, best.size, best.still
    lost = np.setdiff1d(np.arange(track.clock[0], track.clock[-1] + 1).astype(np.int64), track.clock.astype(np.int64))
    lost = np.setdiff1d(lost, still.repeated)
    remarks, fps = track.remarks, film.fps
    if film.shifts is not None:
        moved = float(np.abs(film.shifts - np.median(film.shifts, axis=0)).max())
        remarks = (*remarks, f"the camera moved by up to {moved:.1f} px; frames were moved back onto the first")
    if len(still.repeated):
        track, fps, words = _without_repeats(track, still.repeated, film.fps, still.n_frames)
        remarks = (*remarks, words)
    return Tracked(
        track,
        size[:, 1],
        size[:, 2],
        size[:, 3],
        size[:, 4],
        still.background.astype(np.uint8),
        _composite(film, still, best.track, size),
        fps,
        still.n_frames,
        lost,
        remarks,
        film.watched,
        film.first,
    )


@dataclass(frozen=True)
class _Attempt:
    """The ball as found against one background; ``size``: number, x, y, width, height of each of its spots."""

    still: Still
    track: Track
    size: Array

    @property
    def unsteady(self) -> float:
        """Spread of the spot's height over its median: a ball that overlaps its own ghost changes its size."""
        low, middle, high = np.percentile(self.size[:, 4], [10, 50, 90])
        return float((high - low) / max(middle, 1.0))


def _attempt(film: Film, still: Still, corrections: Corrections, progress: Progress | None) -> _Attempt | InputError:
    """Spots of all frames against one background, and the ball among them; the error where there is none."""
    points: list[tuple[float, ...]] = []
    for number, frame in enumerate(film.frames()):
        if number not in still.repeated:
            points += [(float(number), *blob) for blob in blobs_in(frame, still, film.path)]
        if progress is not None:
            progress("tracking", number + 1, film.count)
    if len(points) < 7:
        return InputError(f"{film.path}: no motion: {len(points)} moving spots in {still.n_frames} frames")
    table = np.array(points)
    if corrections.ignore_s:
        table = table[corrections.keeps((table[:, 0] + film.first) / (film.fps or 1.0), 0.6 / (film.fps or 1.0))]
    try:
        track = ball_of(table[:, 0], table[:, 1], table[:, 2], str(film.path), corrections.axis_deg)
    except InputError as error:
        return error
    return _Attempt(still, track, table[track.index])


def _without_repeats(
    track: Track, repeated: NDArray[np.int64], fps: float | None, count: int
) -> tuple[Track, float | None, str]:
    """The track on the clock on which its flights are smoother: that of all frames, or that of the unlike ones."""
    own = track.clock - np.searchsorted(repeated, track.clock, side="right")
    words = f"{len(repeated)} frames show again what the frame before showed; they are left out"
    if jitter_on(own, track.height) < 0.8 * jitter_on(track.clock, track.height):
        share = 1.0 - len(repeated) / count
        faster = replace(track, clock=own, acceleration=track.acceleration / share**2)
        return faster, fps * share if fps else None, words + ", and the others are taken at even intervals"
    return track, fps, words


def jitter_on(clock: Array, height: Array) -> float:
    """Median departure of each sample from the parabola through its four neighbours."""
    t, h = sliding_window_view(clock, 5), sliding_window_view(height, 5)
    off = []
    for times, values in zip(t, h, strict=True):
        near = [0, 1, 3, 4]
        off.append(values[2] - np.polyval(np.polyfit(times[near] - times[2], values[near], 2), 0.0))
    return float(np.median(np.abs(off))) if off else 0.0


def blobs_in(frame: Image, still: Still, path: Path) -> list[tuple[float, float, float, float]]:
    """Moving spots of a frame: x, y (pixels, downward), width and height."""
    cv2 = opencv(path)
    rows, columns = frame.shape[:2]
    factor = min(1.0, SEARCH_WIDTH / columns)
    size = (int(columns * factor), int(rows * factor))
    small = cv2.resize(frame, size, interpolation=cv2.INTER_AREA)
    gain = _row_gain(small, still.small)
    coarse = cv2.GaussianBlur(_difference(small, still.small, gain), (0, 0), 0.8)
    noise = MAD_TO_SIGMA * float(np.median(coarse))
    limit = max(_NOISE_SIGMAS * noise, _LEAST_CONTRAST)
    full_gain = np.interp(np.arange(rows) * factor, np.arange(size[1]), gain).astype(np.float32)
    found = []
    for label, (x, y, wide, tall, area) in _spots(coarse, limit, cv2):
        inside = x > 0 and y > 0 and x + wide < size[0] and y + tall < size[1]
        if area >= _LEAST_AREA and inside and wide < _WIDEST * size[0]:
            found.append(_centre((frame, still.background, full_gain), label, (x, y, wide, tall), factor, limit, cv2))
    return [blob for blob in found if blob is not None]


def _spots(coarse: NDArray[np.float32], limit: float, cv2: Any) -> list[tuple[NDArray[np.bool_], list[int]]]:
    """Connected spots above ``limit``; each cut again at a share of its own contrast, which leaves shadows behind."""
    reach = max(3, round(0.012 * coarse.shape[1])) | 1
    brush = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    found = []
    outer, first, _ = _parts(coarse > limit, brush, cv2)
    for spot in outer:
        x, y, wide, tall, _ = first[spot]
        box = (slice(y, y + tall), slice(x, x + wide))
        inside = coarse[box]
        own = outer[spot][box]
        contrast = float(np.percentile(inside[own], 97))
        inner, boxes, shape = _parts(own & (inside > max(limit, _SHADOW_SHARE * contrast)), brush, cv2)
        for part in inner:
            label = np.zeros(coarse.shape, dtype=bool)
            label[box] = inner[part].reshape(shape)
            u, v, w, t, area = boxes[part]
            found.append((label, [u + x, v + y, w, t, area]))
    return _joined(sorted(found, key=lambda spot: -spot[1][4])[:_MOST_BLOBS])


def _joined(spots: list[tuple[NDArray[np.bool_], list[int]]]) -> list[tuple[NDArray[np.bool_], list[int]]]:
    """Spots side by side with the same top and bottom are one block with a rod in front of it."""
    out: list[tuple[NDArray[np.bool_], list[int]]] = []
    for label, (x, y, wide, tall, area) in spots:
        for k, (other, (u, v, w, t, size)) in enumerate(out):
            shared = min(y + tall, v + t) - max(y, v)
            gap = max(x, u) - min(x + wide, u + w)
            if shared >= _SAME_SPAN * max(tall, t) and 0 <= gap <= 0.5 * min(wide, w):
                left, top = min(x, u), min(y, v)
                box = [left, top, max(x + wide, u + w) - left, max(y + tall, v + t) - top, area + size]
                out[k] = (other | label, box)
                break
        else:
            out.append((label, [x, y, wide, tall, area]))
    return out


def _parts(
    mask: NDArray[np.bool_], brush: Any, cv2: Any
) -> tuple[dict[int, NDArray[np.bool_]], dict[int, list[int]], tuple[int, ...]]:
    """Connected parts of a mask, small gaps closed: masks, boxes (x, y, width, height, area), and the shape."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, brush)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    order = [int(k) for k in 1 + np.argsort(stats[1:, cv2.CC_STAT_AREA])[::-1][:_MOST_BLOBS]]
    big = [k for k in order if stats[k, cv2.CC_STAT_AREA] >= _LEAST_AREA]
    return {k: labels == k for k in big}, {k: [int(v) for v in stats[k]] for k in big}, mask.shape


def _row_gain(frame: Image, background: NDArray[np.float32]) -> NDArray[np.float32]:
    """Brightness of each row against the background: mains flicker, banded or not."""
    step = max(frame.shape[1] // 96, 1)
    ratio = np.median((frame[:, ::step].astype(np.float32) + 4.0) / (background[:, ::step] + 4.0), axis=(1, 2))
    window = min(len(ratio) // 2 * 2 - 1, 31)
    padded = np.pad(ratio, window // 2, mode="edge")
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1)
    return np.asarray(np.clip(smooth, 0.3, 3.0), dtype=np.float32)


def _difference(frame: Image, background: NDArray[np.float32], gain: NDArray[np.float32]) -> NDArray[np.float32]:
    """Largest difference of the three colours from the background, at the background's brightness."""
    difference = np.abs(frame.astype(np.float32) / gain[:, None, None] - background)
    return np.asarray(difference.max(axis=2), dtype=np.float32)


def _centre(
    pictures: tuple[Image, NDArray[np.float32], NDArray[np.float32]],
    label: NDArray[np.bool_],
    box: tuple[int, int, int, int],
    factor: float,
    limit: float,
    cv2: Any,
) -> tuple[float, float, float, float] | None:
    """Centre and size of one spot at full size, from soft-edged weights."""
    frame, background, gain = pictures
    pad = 3
    x0, y0 = max(int(box[0] / factor) - pad, 0), max(int(box[1] / factor) - pad, 0)
    x1 = min(int((box[0] + box[2]) / factor) + pad + 1, frame.shape[1])
    y1 = min(int((box[1] + box[3]) / factor) + pad + 1, frame.shape[0])
    part = _difference(frame[y0:y1, x0:x1], background[y0:y1, x0:x1], gain[y0:y1])
    part = cv2.GaussianBlur(part, (0, 0), 0.7)
    near = cv2.dilate(label.astype(np.uint8), np.ones((3, 3), np.uint8))
    near = near[
        np.minimum((np.arange(y0, y1) * factor).astype(int), near.shape[0] - 1)[:, None],
        np.minimum((np.arange(x0, x1) * factor).astype(int), near.shape[1] - 1),
    ].astype(bool)
    contrast = float(np.percentile(part[near], 80)) if near.any() else 0.0
    floor = max(0.5 * limit, 0.5 * _SHADOW_SHARE * contrast)
    top = max(0.6 * contrast, floor + 1.0)
    weight = np.where(near, np.clip((part - floor) / (top - floor), 0.0, 1.0), 0.0)
    total = float(weight.sum())
    if total <= 4.0:
        return None
    columns, rows = weight.sum(axis=0), weight.sum(axis=1)
    x = float(columns @ np.arange(x0, x1)) / total
    y = float(rows @ np.arange(y0, y1)) / total
    return x, y, float((columns > 0.5).sum()), float((rows > 0.5).sum())


def _composite(film: Film, still: Still, track: Track, size: Array) -> Image:
    """The background with the ball stamped from up to forty frames of its track."""
    picture = still.background.astype(np.uint8).copy()
    chosen = np.linspace(0, len(track.clock) - 1, min(40, len(track.clock))).astype(int)
    stamps = {int(track.clock[i]): i for i in chosen}
    for number, frame in enumerate(film.frames()):
        if number in stamps:
            _, x, y, wide, tall = size[stamps[number]]
            rows = slice(max(int(y - tall * 0.6), 0), int(y + tall * 0.6) + 1)
            columns = slice(max(int(x - wide * 0.6), 0), int(x + wide * 0.6) + 1)
            box = frame[rows, columns]
            ball = np.abs(box.astype(np.float32) - still.background[rows, columns]).max(axis=2) > _STAMP_LEVELS
            picture[rows, columns][ball] = box[ball]
    return picture
