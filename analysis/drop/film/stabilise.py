"""Films of a camera held in the hand: the shift of each frame by least squares (Lucas and Kanade 1981).

The whole picture is moved onto the first frame. Every pixel counts by its gradient, so the edge of a floor is enough
along the fall; pixels that something moved over count for nothing (Tukey's biweight).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.corrections import Progress
from analysis.drop.film.video import Film, opencv, smaller
from analysis.statistics import mad_sigma
from kernels.arrays import Floats, Integers

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
