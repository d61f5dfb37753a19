"""A stretch of a recording as a picture of given width needs it: extremes by column, or the samples themselves."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from daq.pyramid.build import empty_extremes, read_layout
from daq.recording import Recording
from daq.setup.errors import InputError
from kernels import njit
from kernels.arrays import Floats, Integers

WIDEST = 8192
"""Columns of the widest picture."""


@dataclass(frozen=True)
class View:
    """One stretch of a recording."""

    # start_s, stop_s: its ends on the recording's time axis, lost samples included
    start_s: float
    stop_s: float
    time_s: Floats  # times (n,) of the samples, or of the middles of the columns
    # low_v, high_v: by channel, the least and the greatest voltage (n,) of each column, NaN where it has no sample;
    # the same array where the samples themselves are shown
    low_v: dict[str, Floats]
    high_v: dict[str, Floats]
    samples_per_point: float  # samples that one column stands for; 1 where the samples themselves are shown
    lost: Floats  # ``(start_s, stop_s, samples)`` (m, 3) of the gaps; those that touch within a column are one


class Pyramid:
    """A pyramid on disk; the file is open only while a view is read.

    Raises
    ------
    InputError
        Where the file is no pyramid.
    """

    def __init__(self, path: Path) -> None:
        found = read_layout(path)
        if found is None:
            raise InputError(f"{path}: wanted the extremes of a recording, found something else; remove the file")
        self.path, (self.layout, self._begin, _) = path, found

    @property
    def duration_s(self) -> float:
        """Length of the recording, lost samples included."""
        return self.layout.places / self.layout.rate_hz

    def view(
        self, start_s: float, stop_s: float, width: int, opened: Callable[[], AbstractContextManager[Recording]]
    ) -> View:
        """Extremes in ``width`` columns between two times; the samples where there are no more than columns.

        Parameters
        ----------
        start_s, stop_s
            Cut to the recording.
        width
            Columns, 1 to `WIDEST`.
        opened
            Opens the recording, where samples are needed; closed again.

        Raises
        ------
        InputError
            For times that are no stretch of the recording, or a width out of range.
        """
        layout = self.layout
        if not 1 <= width <= WIDEST:
            raise InputError(f"width: wanted 1 to {WIDEST} columns, came {width}")
        if not (np.isfinite(start_s) and np.isfinite(stop_s) and start_s < stop_s):
            raise InputError(f"wanted a start before the stop, in seconds; came {start_s:g} and {stop_s:g}")
        first = max(int(np.floor(start_s * layout.rate_hz)), 0)
        last = min(int(np.ceil(stop_s * layout.rate_hz)) + 1, layout.places)
        if first >= last:
            raise InputError(f"the recording lasts {self.duration_s:.6g} s; came {start_s:g} to {stop_s:g} s")
        per_column = (last - first) / width
        levels = [k for k in range(layout.levels) if 2 * layout.bucket(k) <= per_column]
        if levels:
            place, ranges = self._buckets(levels[-1], first, last)
        else:
            place, ranges = self._samples(first, last, opened)
        each = not levels and last - first <= 2 * width
        low, high = {}, {}
        if not each:
            column = ((place - first) / per_column).astype(np.int64)
            place = np.asarray(first + (np.arange(width) + 0.5) * per_column, np.float64)
        for (name, _, factor, offset), (least, most) in zip(layout.channels, ranges, strict=True):
            if not each:
                into = empty_extremes(width, least.dtype)
                widen(least, most, column, *into)
                least, most = into
            ordered = [least, most] if factor >= 0 else [most, least]  # a negative scale exchanges them
            empty = least > most
            low[name], high[name] = (np.where(empty, np.nan, factor * x.astype(float) + offset) for x in ordered)
        ends, lost = (first / layout.rate_hz, last / layout.rate_hz), self._lost(first, last, per_column)
        return View(*ends, place / layout.rate_hz, low, high, 1.0 if each else per_column, lost)

    def _buckets(self, level: int, first: int, last: int) -> tuple[Floats, list[tuple[Any, Any]]]:
        """Middle places of the buckets that overlap places ``first`` to ``last``, and their extremes by channel."""
        layout, bucket = self.layout, self.layout.bucket(level)
        begins = layout.first_buckets[level]
        a, b = (self._bucket(level, place) for place in (first, last - 1))
        ids = np.arange(a, max(b + 1, a))
        stretch = np.searchsorted(begins, ids, "right") - 1
        sample = layout.starts[stretch] + bucket * (ids - begins[stretch])
        ends = np.minimum(sample + bucket, layout.starts[stretch + 1])
        place = np.clip(0.5 * (sample + ends) + layout.lost_before[stretch], first, last - 1)

        def read(file: BinaryIO, channel: int, most: int) -> NDArray[Any]:
            dtype = layout.dtype(channel)
            file.seek(self._begin + layout.offset(level, channel, most) + a * dtype.itemsize)
            return np.frombuffer(file.read(len(ids) * dtype.itemsize), dtype)

        with self.path.open("rb") as file:
            return place, [(read(file, c, 0), read(file, c, 1)) for c in range(len(layout.channels))]

    def _stretch(self, place: int) -> int:
        """Stretch that holds a place, or the one before the gap that does."""
        layout = self.layout
        return max(int(np.searchsorted(layout.starts[:-1] + layout.lost_before, place, "right")) - 1, 0)

    def _bucket(self, level: int, place: int) -> int:
        """Bucket of a level that holds a place; for one in a gap, the last before it."""
        layout, k = self.layout, self._stretch(place)
        sample = place - int(layout.lost_before[k]) - int(layout.starts[k])
        longest = int(layout.starts[k + 1] - layout.starts[k]) - 1
        return int(layout.first_buckets[level][k]) + min(max(sample, 0), longest) // layout.bucket(level)

    def _samples(
        self, first: int, last: int, opened: Callable[[], AbstractContextManager[Recording]]
    ) -> tuple[Floats, list[tuple[Any, Any]]]:
        """Places of the samples between two places, and their codes by channel."""
        layout = self.layout
        start, stop = (
            int(np.clip(place - layout.lost_before[k], layout.starts[k], layout.starts[k + 1]))
            for place, k in ((first, self._stretch(first)), (last, self._stretch(last - 1)))
        )
        sample = np.arange(start, stop)
        stretch = np.searchsorted(layout.starts, sample, "right") - 1
        place = (sample + layout.lost_before[stretch]).astype(float)
        with opened() as recording:
            if recording.n_samples != layout.n_samples:
                raise InputError(f"{recording.path}: has changed since its extremes were made; open it again")
            codes = [recording.codes(name, start, stop) for name, *_ in layout.channels]
        return place, [(x, x) for x in codes]

    def _lost(self, first: int, last: int, per_column: float) -> Floats:
        """Gaps between two places; those that touch within a column are one."""
        rows: list[list[float]] = []
        layout, before = self.layout, 0
        for sample, lost in layout.gaps:
            a, b = sample + before, sample + before + lost
            before += lost
            if b <= first or a >= last:
                continue
            if rows and a - rows[-1][1] < per_column:
                rows[-1][1:] = [b, rows[-1][2] + lost]
            else:
                rows.append([a, b, lost])
        out = np.array(rows, float).reshape(-1, 3)
        out[:, :2] /= layout.rate_hz
        return out


@njit(nogil=True)
def widen(
    low: NDArray[Any], high: NDArray[Any], column: Integers, into_low: NDArray[Any], into_high: NDArray[Any]
) -> None:
    """Widen the extremes of columns of a picture by buckets, or samples, that fall into ``column`` (n,) each."""
    for i in range(len(column)):
        k = column[i]
        if 0 <= k < len(into_low):
            into_low[k] = low[i] if low[i] < into_low[k] else into_low[k]
            into_high[k] = high[i] if high[i] > into_high[k] else into_high[k]
