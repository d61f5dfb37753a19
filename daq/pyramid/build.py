"""Make the pyramid of a recording: one pass over its samples, in memory that does not depend on its length."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import CHUNK_SAMPLES
from daq.pyramid.layout import BUCKET, FACTOR, Layout, read_layout
from daq.recording import Recording
from daq.recording.identity import stored_id
from kernels import njit
from kernels.arrays import Integers

PIECE = 4 * CHUNK_SAMPLES
"""Samples read at a time."""
BUCKETS = 1 << 18
"""Buckets folded at a time into the next level."""


def pyramid_key(recording: Recording) -> str:
    """Hash of a pyramid's source: the stored checksums (of a run that goes on: of its blocks), and the gaps."""
    blocks = "" if recording.frames is None else hashlib.sha256(recording.blocks["crc32"].tobytes()).hexdigest()
    made_of = [stored_id(recording), blocks, recording.channels, recording.n_samples, recording.gaps.tolist()]
    return hashlib.sha256(json.dumps(made_of).encode()).hexdigest()[:32]


def has_pyramid(path: Path, key: str) -> bool:
    """Whether the file ``path`` is a whole pyramid of the source with the hash ``key``."""
    try:
        found = read_layout(path)
    except (OSError, ValueError, TypeError, KeyError):
        return False
    if found is None or found[0].key != key:
        return False
    crc = 0
    with path.open("rb") as raw:
        raw.seek(found[1])
        while piece := raw.read(1 << 20):
            crc = zlib.crc32(piece, crc)
    return crc == found[2]


def build_pyramid(recording: Recording, path: Path, progress: Callable[[float], None] | None = None) -> Layout:
    """Write the pyramid of an open recording to ``path``, whole or not at all.

    Parameters
    ----------
    recording
        Open; read once from its first sample to its last.
    path
        File to write; one that is there is replaced.
    progress
        Called with the part done, 0 to 1.

    Raises
    ------
    OSError
        When the disk refuses.
    InputError
        When samples do not read back.
    """
    layout = Layout.of(recording, pyramid_key(recording))
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "w+b") as file:
            begin = len(layout.header(0))
            file.truncate(begin + layout.body_bytes)
            _lowest(recording, layout, file, begin, progress)
            for level in range(1, layout.levels):
                for channel in range(len(layout.channels)):
                    _next(layout, file, begin, level, channel)
            _head(layout, file, begin)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return layout


def _head(layout: Layout, file: IO[bytes], begin: int) -> None:
    """Write the header, with the checksum of what follows it."""
    file.seek(begin)
    crc = 0
    while piece := file.read(1 << 20):
        crc = zlib.crc32(piece, crc)
    file.seek(0)
    file.write(layout.header(crc))


def _lowest(
    recording: Recording, layout: Layout, file: IO[bytes], begin: int, progress: Callable[[float], None] | None
) -> None:
    """The lowest level of all channels, piece by piece."""
    carried: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}
    for start in range(0, recording.n_samples, PIECE):
        stop = min(start + PIECE, recording.n_samples)
        for channel, (name, *_) in enumerate(layout.channels):
            codes = recording.codes(name, start, stop).astype(layout.dtype(channel), copy=False)
            first, low, high = _piece(layout, channel, codes, start, stop, carried)
            _write(file, begin + layout.offset(0, channel, 0), first, low)
            _write(file, begin + layout.offset(0, channel, 1), first, high)
        if progress is not None:
            progress(stop / recording.n_samples)


def _piece(
    layout: Layout,
    channel: int,
    codes: NDArray[Any],
    start: int,
    stop: int,
    carried: dict[int, tuple[NDArray[Any], NDArray[Any]]],
) -> tuple[int, NDArray[Any], NDArray[Any]]:
    """First bucket, minima and maxima of samples ``start`` to ``stop``; a bucket begun before goes on."""
    first, last = _bucket_of(layout, start), _bucket_of(layout, stop - 1)
    low, high = empty_extremes(last - first + 1, codes.dtype)
    if channel in carried:
        before, (was_low, was_high) = _bucket_of(layout, start - 1), carried[channel]
        if before == first:  # the piece before ended within this bucket
            low[:1], high[:1] = was_low, was_high
    stretches = layout.starts
    of = range(int(np.searchsorted(stretches, start, "right")) - 1, int(np.searchsorted(stretches, stop, "left")))
    for k in of:
        a, b = max(start, int(stretches[k])), min(stop, int(stretches[k + 1]))
        at = _bucket_of(layout, a) - first
        fold_samples(codes[a - start : b - start], (a - int(stretches[k])) % BUCKET, BUCKET, low[at:], high[at:])
    carried[channel] = low[-1:].copy(), high[-1:].copy()
    return first, low, high


def _bucket_of(layout: Layout, sample: int) -> int:
    """Bucket of the lowest level that holds a sample."""
    k = int(np.searchsorted(layout.starts, sample, "right")) - 1
    return int(layout.first_buckets[0][k]) + (sample - int(layout.starts[k])) // BUCKET


def empty_extremes(n: int, dtype: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Minima and maxima (n,) of no samples: the least is greater than the greatest."""
    limits = (np.inf, -np.inf) if dtype.kind == "f" else (np.iinfo(dtype).max, np.iinfo(dtype).min)
    return np.full(n, limits[0], dtype), np.full(n, limits[1], dtype)


def _next(layout: Layout, file: IO[bytes], begin: int, level: int, channel: int) -> None:
    """One level of one channel from the level below it."""
    below, here, dtype = layout.first_buckets[level - 1], layout.first_buckets[level], layout.dtype(channel)
    for first in range(0, int(here[-1]), BUCKETS):
        buckets = np.arange(first, min(first + BUCKETS, int(here[-1])))
        stretch = np.searchsorted(here, buckets, "right") - 1
        begins = below[stretch] + FACTOR * (buckets - here[stretch])
        ends = np.minimum(begins + FACTOR, below[stretch + 1])
        a, b = int(begins[0]), int(ends[-1])
        low, high = (
            read_extremes(file, begin + layout.offset(level - 1, channel, most), a, b, dtype) for most in (0, 1)
        )
        into = np.empty(len(buckets), dtype), np.empty(len(buckets), dtype)
        fold_buckets(low, high, begins - a, ends - a, *into)
        for most in (0, 1):
            _write(file, begin + layout.offset(level, channel, most), first, into[most])


def read_extremes(file: IO[bytes], offset: int, first: int, last: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Extremes ``first`` to ``last`` (exclusive) of those that begin at byte ``offset``."""
    file.seek(offset + first * dtype.itemsize)
    return np.frombuffer(file.read((last - first) * dtype.itemsize), dtype)


def _write(file: IO[bytes], offset: int, first: int, values: NDArray[Any]) -> None:
    """Write extremes from the bucket ``first`` on."""
    file.seek(offset + first * values.itemsize)
    file.write(values.tobytes())


@njit(nogil=True)
def fold_samples(codes: NDArray[Any], skipped: int, bucket: int, low: NDArray[Any], high: NDArray[Any]) -> None:
    """Widen the extremes ``low``, ``high`` (k,) of buckets by samples (n,) that do not jump over lost ones.

    Parameters
    ----------
    codes
        Samples; one that is no number (NaN) is passed over.
    skipped
        Samples of the first bucket that came before.
    bucket
        Samples a bucket.
    low, high
        Extremes so far; ``low > high``: none yet.
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


@njit(nogil=True)
def fold_buckets(
    low: NDArray[Any],
    high: NDArray[Any],
    begins: Integers,
    ends: Integers,
    into_low: NDArray[Any],
    into_high: NDArray[Any],
) -> None:
    """Extremes (k,) of the buckets ``begins[k]`` to ``ends[k]`` (exclusive) of ``low``, ``high``."""
    for k in range(len(begins)):
        least, most = low[begins[k]], high[begins[k]]
        for i in range(begins[k] + 1, ends[k]):
            least = low[i] if low[i] < least else least
            most = high[i] if high[i] > most else most
        into_low[k], into_high[k] = least, most
