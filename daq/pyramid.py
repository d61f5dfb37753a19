"""Extremes of a recording's samples, and stretches of it as a picture of given width needs them.

The file of a pyramid holds the least and the greatest code of every channel in each of some `MOST_BUCKETS` buckets: a
wide view is made of them, a narrow one of the samples. Buckets begin anew after every gap, so that none holds samples
from both sides of it. The file is a line of JSON, two NumPy arrays a channel, and the CRC-32 of all.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import tempfile
import zlib
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import CHUNK_SAMPLES
from daq.recording import Recording
from daq.recording.header import stored_id
from daq.setup.errors import InputError
from kernels import njit
from kernels.arrays import Floats, Integers

SMALLEST_BUCKET, MOST_BUCKETS = 64, 1 << 18  # samples; buckets of a recording without gaps
WIDEST = 8192  # columns of the widest picture
PIECE = 4 * CHUNK_SAMPLES  # samples read at a time
Extremes = tuple[NDArray[Any], NDArray[Any]]


@dataclass(frozen=True)
class Layout:
    """Places of a recording's extremes."""

    key: str  # hash of the channels, checksums and gaps that the pyramid was made of
    rate_hz: float
    n_samples: int
    # Name, type and scale (volts a code, volts at zero) of each channel
    channels: tuple[tuple[str, str, float, float], ...]
    gaps: tuple[tuple[int, int], ...]  # ``(first sample after it, samples lost)`` each

    @classmethod
    def of(cls, recording: Recording) -> Layout:
        """Layout for an open recording."""
        kinds = {name: recording.codes(name, 0, 0).dtype for name in recording.channels}
        channels = tuple((name, kinds[name].newbyteorder("<").str, *recording.scale(name)) for name in kinds)
        gaps = tuple((int(first), int(lost)) for first, lost in recording.gaps)
        return cls(pyramid_key(recording), recording.rate_hz, recording.n_samples, channels, gaps)

    @property
    def bucket(self) -> int:
        """Samples in a bucket."""
        return max(SMALLEST_BUCKET, -(-self.n_samples // MOST_BUCKETS))

    @cached_property
    def starts(self) -> Integers:
        """First sample of each stretch without gaps, and the number of samples, (s + 1,)."""
        inside = [first for first, _ in self.gaps if 0 < first < self.n_samples]
        return np.unique(np.array([0, *inside, self.n_samples], np.int64))

    @cached_property
    def lost_before(self) -> Integers:
        """Samples lost before each stretch, (s,)."""
        lost = np.zeros(len(self.starts) - 1, np.int64)
        for first, n in self.gaps:
            lost[np.searchsorted(self.starts[:-1], first) :] += n
        return lost

    @cached_property
    def places(self) -> int:
        """Samples from the first to the last, the lost ones included."""
        return self.n_samples + (int(self.lost_before[-1]) if len(self.lost_before) else 0)

    @cached_property
    def first_buckets(self) -> Integers:
        """The first bucket of each stretch, and the number of buckets, (s + 1,)."""
        return np.append(0, np.cumsum(-(-np.diff(self.starts) // self.bucket))).astype(np.int64)


def pyramid_key(recording: Recording) -> str:
    """Hash of a pyramid's source: the stored checksums (of a run that goes on: of its blocks), and the gaps."""
    blocks = "" if recording.frames is None else hashlib.sha256(recording.blocks["crc32"].tobytes()).hexdigest()
    made_of = [stored_id(recording), blocks, recording.channels, recording.n_samples, recording.gaps.tolist()]
    return hashlib.sha256(json.dumps(made_of).encode()).hexdigest()[:32]


def has_pyramid(path: Path, key: str) -> bool:
    """Whether the file ``path`` is a whole pyramid of the source with the hash ``key``."""
    found = _read(path)
    return found is not None and found[0].key == key


def _read(path: Path) -> tuple[Layout, list[Extremes]] | None:
    """Layout and extremes of each channel of a file; None where it is no sound pyramid."""
    try:
        data = path.read_bytes()
        if zlib.crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
            return None
        body = io.BytesIO(data[:-4])
        stored: dict[str, Any] = json.loads(body.readline())
        for name in ("channels", "gaps"):
            stored[name] = tuple(map(tuple, stored[name]))
        layout = Layout(**stored)
        return layout, [(np.load(body), np.load(body)) for _ in layout.channels]
    except (OSError, ValueError, TypeError, KeyError, EOFError):  # of an earlier version
        return None


def build_pyramid(recording: Recording, path: Path) -> None:
    """Write the pyramid of an open recording, which is read once, to ``path``, whole or not at all.

    Raises `OSError` when the disk refuses, `InputError` when samples do not read back.
    """
    layout = Layout.of(recording)
    stretches, begins, bucket = layout.starts, layout.first_buckets, layout.bucket
    extremes = [empty_extremes(int(begins[-1]), np.dtype(kind)) for _, kind, *_ in layout.channels]
    for start in range(0, recording.n_samples, PIECE):
        stop = min(start + PIECE, recording.n_samples)
        of = range(int(np.searchsorted(stretches, start, "right")) - 1, int(np.searchsorted(stretches, stop, "left")))
        for (name, kind, *_), (low, high) in zip(layout.channels, extremes, strict=True):
            codes = recording.codes(name, start, stop).astype(kind, copy=False)
            for k in of:  # no bucket holds samples of two stretches
                a, b = max(start, int(stretches[k])), min(stop, int(stretches[k + 1]))
                at, skipped = divmod(a - int(stretches[k]), bucket)
                at += int(begins[k])
                fold_samples(codes[a - start : b - start], skipped, bucket, low[at:], high[at:])
    body = io.BytesIO(json.dumps(dataclasses.asdict(layout)).encode() + b"\n")
    body.seek(0, io.SEEK_END)
    for x in (x for pair in extremes for x in pair):
        np.save(body, x)
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(body.getvalue() + zlib.crc32(body.getvalue()).to_bytes(4, "little"))
        Path(part).replace(path)
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise


@dataclass(frozen=True)
class View:
    """One stretch of a recording."""

    start_s: float  # its begin on the recording's time axis, lost samples included
    stop_s: float  # its end
    time_s: Floats  # times (n,) of the samples, or of the middles of the columns
    low_v: dict[str, Floats]  # by channel, the least voltage of each column, (n,), NaN where it has no sample
    high_v: dict[str, Floats]  # the greatest; the same array where the samples themselves are shown
    samples_per_point: float  # samples that one column stands for; 1 where the samples themselves are shown
    lost: Floats  # ``(start_s, stop_s, samples)`` (m, 3) of the gaps; those that touch within a column are one


class Pyramid:
    """A pyramid that was written to a file; raises `InputError` where the file is no pyramid."""

    def __init__(self, path: Path) -> None:
        found = _read(path)
        if found is None:
            raise InputError(f"{path}: wanted the extremes of a recording, found something else; remove the file")
        self.path, (self.layout, self._extremes) = path, found

    @property
    def duration_s(self) -> float:
        """Length of the recording, lost samples included."""
        return self.layout.places / self.layout.rate_hz

    def view(
        self, start_s: float, stop_s: float, width: int, opened: Callable[[], AbstractContextManager[Recording]]
    ) -> View:
        """Extremes in ``width`` columns between two times; the samples where there are no more than columns.

        Raises `InputError` for times that are no stretch of the recording, or a width out of range.

        The stretch is cut to the recording; ``width`` is 1 to `WIDEST` columns. ``opened`` opens the recording, where
        samples are needed.
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
        wide = 2 * layout.bucket <= per_column
        place, ranges = self._buckets(first, last) if wide else self._samples(first, last, opened)
        each = not wide and last - first <= 2 * width
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

    def _buckets(self, first: int, last: int) -> tuple[Floats, list[Extremes]]:
        """Middle places of the buckets that overlap places ``first`` to ``last``, and their extremes by channel."""
        layout, begins = self.layout, self.layout.first_buckets
        a, b = (self._bucket(place) for place in (first, last - 1))
        ids = np.arange(a, max(b + 1, a))
        stretch = np.searchsorted(begins, ids, "right") - 1
        sample = layout.starts[stretch] + layout.bucket * (ids - begins[stretch])
        ends = np.minimum(sample + layout.bucket, layout.starts[stretch + 1])
        place = np.clip(0.5 * (sample + ends) + layout.lost_before[stretch], first, last - 1)
        return place, [(low[a : max(b + 1, a)], high[a : max(b + 1, a)]) for low, high in self._extremes]

    def _stretch(self, place: int) -> int:
        """Stretch that holds a place, or the one before the gap that does."""
        layout = self.layout
        return max(int(np.searchsorted(layout.starts[:-1] + layout.lost_before, place, "right")) - 1, 0)

    def _bucket(self, place: int) -> int:
        """Bucket that holds a place; for one in a gap, the last before it."""
        layout, k = self.layout, self._stretch(place)
        sample = place - int(layout.lost_before[k]) - int(layout.starts[k])
        longest = int(layout.starts[k + 1] - layout.starts[k]) - 1
        return int(layout.first_buckets[k]) + min(max(sample, 0), longest) // layout.bucket

    def _samples(
        self, first: int, last: int, opened: Callable[[], AbstractContextManager[Recording]]
    ) -> tuple[Floats, list[Extremes]]:
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


def empty_extremes(n: int, dtype: np.dtype[Any]) -> Extremes:
    """Minima and maxima (n,) of no samples: the least is greater than the greatest."""
    limits = (np.inf, -np.inf) if dtype.kind == "f" else (np.iinfo(dtype).max, np.iinfo(dtype).min)
    return np.full(n, limits[0], dtype), np.full(n, limits[1], dtype)


@njit(nogil=True)
def fold_samples(codes: NDArray[Any], skipped: int, bucket: int, low: NDArray[Any], high: NDArray[Any]) -> None:
    """Widen the extremes ``low``, ``high`` (k,) of buckets by samples (n,) that do not jump over lost ones.

    A sample that is no number (NaN) is passed over; ``low > high``: none yet. ``skipped`` samples of the first bucket
    came before.
    """
    at, k, n = 0, 0, len(codes)
    end = min(bucket - skipped, n)
    while at < n:
        least, most = low[k], high[k]
        for i in range(at, end):
            x = codes[i]
            least = x if x < least else least
            most = x if x > most else most
        low[k], high[k] = least, most
        at, end, k = end, min(end + bucket, n), k + 1
