"""Make the pyramid of a recording: one pass over its samples. Memory holds the extremes, a thirtieth of them."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import zlib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import CHUNK_SAMPLES
from daq.pyramid.layout import BUCKET, FACTOR, Layout, read_layout
from daq.recording import Recording
from daq.recording.identity import stored_id
from kernels import njit

PIECE = 4 * CHUNK_SAMPLES
"""Samples read at a time."""


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
    with path.open("rb") as raw:
        raw.seek(found[1])
        return zlib.crc32(raw.read()) == found[2]


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
    stretches, begins = layout.starts, layout.first_buckets
    extremes = [empty_extremes(int(begins[0][-1]), layout.dtype(c)) for c in range(len(layout.channels))]
    for start in range(0, recording.n_samples, PIECE):
        stop = min(start + PIECE, recording.n_samples)
        of = range(int(np.searchsorted(stretches, start, "right")) - 1, int(np.searchsorted(stretches, stop, "left")))
        for (name, dtype, *_), (low, high) in zip(layout.channels, extremes, strict=True):
            codes = recording.codes(name, start, stop).astype(dtype, copy=False)
            for k in of:  # no bucket holds samples of two stretches
                a, b = max(start, int(stretches[k])), min(stop, int(stretches[k + 1]))
                at, skipped = divmod(a - int(stretches[k]), BUCKET)
                at += int(begins[0][k])
                fold_samples(codes[a - start : b - start], skipped, BUCKET, low[at:], high[at:])
        if progress is not None:
            progress(stop / recording.n_samples)
    body = [x.tobytes() for pair in extremes for x in pair]
    for below, here in pairwise(begins):
        buckets = np.arange(int(here[-1]))
        stretch = np.searchsorted(here, buckets, "right") - 1
        first = below[stretch] + FACTOR * (buckets - here[stretch])
        extremes = [(np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)) for low, high in extremes]
        body += [x.tobytes() for pair in extremes for x in pair]
    crc = 0
    for part in body:
        crc = zlib.crc32(part, crc)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines([layout.header(crc), *body])
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return layout


def empty_extremes(n: int, dtype: np.dtype[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Minima and maxima (n,) of no samples: the least is greater than the greatest."""
    limits = (np.inf, -np.inf) if dtype.kind == "f" else (np.iinfo(dtype).max, np.iinfo(dtype).min)
    return np.full(n, limits[0], dtype), np.full(n, limits[1], dtype)


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
