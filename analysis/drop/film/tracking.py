"""Moving things in every frame of a film, to a tenth of a pixel.

A position is the centre of the area that differs from what stands still, with soft edges that saturate at half of the
contrast. So texture, a rod across the block and a change of brightness do not pull it, and motion blur, which is the
same at both ends, moves it to the middle of the exposure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from analysis.drop.corrections import NOTHING, Corrections, Progress
from analysis.drop.film.background import SEARCH_WIDTH, Picture, Still, stabilised, still_by_order, still_of
from analysis.drop.film.track import Track, ball_of, parabolas
from analysis.drop.film.video import Film, Image, open_film, opencv, part_of, smaller
from analysis.statistics import mad_sigma
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers

_MOST_BLOBS = 12
_LEAST_AREA = 9.0  # of search pixels
_SHADOW_SHARE = 0.4  # of a spot's contrast: what is fainter is its shadow or its reflection


@dataclass(frozen=True)
class Tracked:
    """The ball in a film."""

    track: Track  # in pixels and frames
    x_px: Floats  # centre of each of the track's points in the picture, (n,)
    y_px: Floats  # the same, (n,)
    width_px: Floats  # width of the moving area of each, (n,)
    tall_px: Floats  # its height, (n,)
    composite: Image  # (rows, columns, 3) the ball stamped from every few frames onto the background
    fps: float | None  # as the file states
    lost: Integers  # (m,) frames between the track's first and last in which the ball was not found
    remarks: tuple[str, ...] = ()  # what was noticed
    watched: bool = True  # the picture has edges that show whether the camera moved along its columns
    first: int = 0  # number of the first frame used in the file


def track_film(path: Path, progress: Progress | None = None, corrections: Corrections = NOTHING) -> Tracked:
    """Find and follow the ball in a film or a folder of pictures.

    Raises `InputError` for a film that is damaged, cut, without motion, without free flight, or with two things in it.
    """
    film = stabilised(part_of(open_film(path), corrections), progress)
    usual = still_of(film, progress)
    best = _attempt(film, usual, corrections, progress)
    # a spot whose height spreads by 12 %: its background is suspected, and one is tried that is free of the ball
    if isinstance(best, InputError) or best.unsteady > 0.12:
        other = _attempt(film, still_by_order(film, usual), corrections, progress)
        if isinstance(other, _Attempt) and (isinstance(best, InputError) or other.unsteady < best.unsteady):
            best = other
    if isinstance(best, InputError):
        raise best
    track, still = best.track, best.still
    frames = track.clock.astype(np.int64)
    lost = np.setdiff1d(np.setdiff1d(np.arange(frames[0], frames[-1] + 1), frames), still.repeated)
    remarks, fps = track.remarks, film.fps
    if film.shifts is not None:
        moved = float(np.abs(film.shifts - np.median(film.shifts, axis=0)).max())
        remarks = (*remarks, f"the camera moved by up to {moved:.1f} px; frames were moved back onto the first")
    if len(still.repeated):
        words = f"{len(still.repeated)} frames show again what the frame before showed; they are left out"
        own = track.clock - np.searchsorted(still.repeated, track.clock, side="right")
        uneven, even = (np.median(parabolas(clock, track.height).residual) for clock in (track.clock, own))
        if even < 0.8 * uneven:
            share = 1.0 - len(still.repeated) / still.n_frames
            track = replace(track, clock=own, acceleration=track.acceleration / share**2)
            fps = fps * share if fps else None
            words += ", and the others are taken at even intervals"
        remarks = (*remarks, words)
    x, y, width, tall = best.size[:, 1:].T
    return Tracked(track, x, y, width, tall, _composite(film, best), fps, lost, remarks, film.watched, film.first)


@dataclass(frozen=True)
class _Attempt:
    """The ball as found against one background; ``size``: number, x, y, width, height of each of its spots."""

    still: Still
    track: Track
    size: Floats

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


class _Spot(NamedTuple):
    """A connected area of the searched picture."""

    mask: Bools  # of the whole picture
    left: int
    top: int
    wide: int
    tall: int
    area: int


def blobs_in(frame: Image, still: Still, path: Path) -> list[tuple[float, float, float, float]]:
    """Moving spots of a frame: x, y (pixels, downward), width and height."""
    cv2 = opencv(path)
    factor = min(1.0, SEARCH_WIDTH / frame.shape[1])
    small = smaller(frame, factor, 1, cv2)
    # brightness of each row against the background: mains flicker, banded or not
    columns_step = max(small.shape[1] // 96, 1)
    seen, rest = small[:, ::columns_step].astype(np.float32) + 4.0, still.small[:, ::columns_step] + 4.0
    ratio = np.median(seen / rest, axis=(1, 2))
    window = min(len(ratio) // 2 * 2 - 1, 31)
    smooth = np.median(sliding_window_view(np.pad(ratio, window // 2, mode="edge"), window), axis=1)
    gain = np.asarray(np.clip(smooth, 0.3, 3.0), dtype=np.float32)
    coarse = cv2.GaussianBlur(_difference(small, still.small, gain), (0, 0), 0.8)
    # six sigma of the noise, and ten levels at least
    limit = max(6.0 * mad_sigma(coarse), 10.0)
    rows, columns = coarse.shape
    full_gain = np.interp(np.arange(frame.shape[0]) * factor, np.arange(rows), gain).astype(np.float32)
    found = []
    for spot in _spots(coarse, limit, cv2):
        inside = spot.left > 0 and spot.top > 0 and spot.left + spot.wide < columns and spot.top + spot.tall < rows
        # wider than 60 % of the picture is a person, or the light
        if spot.area >= _LEAST_AREA and inside and spot.wide < 0.6 * columns:
            found.append(_centre(frame, still.background, full_gain, spot, factor, limit, cv2))
    return [blob for blob in found if blob is not None]


def _spots(coarse: Picture, limit: float, cv2: Any) -> list[_Spot]:
    """Connected spots above ``limit``; each cut again at a share of its own contrast, which leaves shadows behind.

    Spots next to each other with the same top and bottom are one block with a rod in front of it.
    """
    reach = max(3, round(0.012 * coarse.shape[1])) | 1
    brush = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    found: list[_Spot] = []
    for outer in _parts(coarse > limit, brush, cv2):
        box = (slice(outer.top, outer.top + outer.tall), slice(outer.left, outer.left + outer.wide))
        inside, own = coarse[box], outer.mask[box]
        contrast = float(np.percentile(inside[own], 97))
        for inner in _parts(own & (inside > max(limit, _SHADOW_SHARE * contrast)), brush, cv2):
            mask = np.zeros(coarse.shape, dtype=bool)
            mask[box] = inner.mask
            found.append(_Spot(mask, inner.left + outer.left, inner.top + outer.top, *inner[3:]))
    joined: list[_Spot] = []
    for a in sorted(found, key=lambda spot: -spot.area)[:_MOST_BLOBS]:
        for k, b in enumerate(joined):
            shared = min(a.top + a.tall, b.top + b.tall) - max(a.top, b.top)
            gap = max(a.left, b.left) - min(a.left + a.wide, b.left + b.wide)
            # two parts on both sides of a rod share 60 % of their heights: less than all, if it leans
            if shared >= 0.6 * max(a.tall, b.tall) and 0 <= gap <= 0.5 * min(a.wide, b.wide):
                left, top = min(a.left, b.left), min(a.top, b.top)
                wide = max(a.left + a.wide, b.left + b.wide) - left
                tall = max(a.top + a.tall, b.top + b.tall) - top
                joined[k] = _Spot(a.mask | b.mask, left, top, wide, tall, a.area + b.area)
                break
        else:
            joined.append(a)
    return joined


def _parts(mask: Bools, brush: Any, cv2: Any) -> list[_Spot]:
    """Connected parts of a mask, small gaps closed, the largest first."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, brush)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    order = 1 + np.argsort(stats[1:, cv2.CC_STAT_AREA])[::-1][:_MOST_BLOBS]
    return [
        _Spot(labels == k, *(int(v) for v in stats[k]))
        for k in order.tolist()
        if stats[k, cv2.CC_STAT_AREA] >= _LEAST_AREA
    ]


def _difference(frame: Image, background: Picture, gain: Picture) -> Picture:
    """Largest difference of the three colours from the background, at the background's brightness."""
    difference = np.abs(frame.astype(np.float32) / gain[:, None, None] - background)
    return np.asarray(difference.max(axis=2), dtype=np.float32)


def _centre(
    frame: Image, background: Picture, gain: Picture, spot: _Spot, factor: float, limit: float, cv2: Any
) -> tuple[float, float, float, float] | None:
    """Centre and size of one spot at full size, from soft-edged weights."""
    pad = 3
    x0, y0 = max(int(spot.left / factor) - pad, 0), max(int(spot.top / factor) - pad, 0)
    x1 = min(int((spot.left + spot.wide) / factor) + pad + 1, frame.shape[1])
    y1 = min(int((spot.top + spot.tall) / factor) + pad + 1, frame.shape[0])
    part = _difference(frame[y0:y1, x0:x1], background[y0:y1, x0:x1], gain[y0:y1])
    part = cv2.GaussianBlur(part, (0, 0), 0.7)
    near = cv2.dilate(spot.mask.astype(np.uint8), np.ones((3, 3), np.uint8))
    rows, columns = np.arange(y0, y1), np.arange(x0, x1)
    at_row = np.minimum((rows * factor).astype(int), near.shape[0] - 1)
    at_column = np.minimum((columns * factor).astype(int), near.shape[1] - 1)
    near = near[at_row[:, None], at_column].astype(bool)
    contrast = float(np.percentile(part[near], 80)) if near.any() else 0.0
    floor = max(0.5 * limit, 0.5 * _SHADOW_SHARE * contrast)
    top = max(0.6 * contrast, floor + 1.0)
    weight = np.where(near, np.clip((part - floor) / (top - floor), 0.0, 1.0), 0.0)
    total = float(weight.sum())
    if total <= 4.0:
        return None
    across, down = weight.sum(axis=0), weight.sum(axis=1)
    x, y = float(across @ columns) / total, float(down @ rows) / total
    return x, y, float((across > 0.5).sum()), float((down > 0.5).sum())


def _composite(film: Film, best: _Attempt) -> Image:
    """The background with the ball stamped from some frames of its track."""
    still, clock = best.still.background, best.track.clock
    picture = still.astype(np.uint8)
    chosen = np.linspace(0, len(clock) - 1, min(40, len(clock))).astype(int)
    stamps = {int(clock[i]): best.size[i] for i in chosen}
    for number, frame in enumerate(film.frames()):
        if number in stamps:
            _, x, y, wide, tall = stamps[number]
            rows = slice(max(int(y - tall * 0.6), 0), int(y + tall * 0.6) + 1)
            columns = slice(max(int(x - wide * 0.6), 0), int(x + wide * 0.6) + 1)
            box = frame[rows, columns]
            ball = np.abs(box.astype(np.float32) - still[rows, columns]).max(axis=2) > 40.0
            picture[rows, columns][ball] = box[ball]
    return picture
