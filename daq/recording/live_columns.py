"""Columns written in addition to the frames while a run lasts, so that closing it has little left to do.

They are a shortcut and no part of what makes a recording safe: the frames are written first and stay until the end.
Where the columns meet anything unexpected (no room to spare, a disk that refuses, samples that are not those of the
frames file) they are dropped, and closing writes them from the frames.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import CHUNK_SAMPLES, ColumnWriter
from daq.files.tables import Block
from daq.recording.reader import Recording, gaps_of, timestamps_ns
from daq.setup.errors import InputError
from kernels.arrays import Integers


class LiveColumns:
    """Columns of the blocks of a run, a chunk at a time, its ``channels`` in the order of a frame.

    ``begin`` makes the column file, when the first chunk is full: a short run has none. ``spare_bytes`` gives, for the
    samples so far, the bytes that the disk must have free for what is more important.
    """

    def __init__(
        self,
        begin: Callable[[], ColumnWriter],
        channels: Sequence[str],
        rate_hz: float,
        spare_bytes: Callable[[int], int],
    ) -> None:
        self._begin, self._channels, self._rate_hz, self._spare_bytes = begin, channels, rate_hz, spare_bytes
        self._columns: ColumnWriter | None = None
        self._waiting: NDArray[np.int16] = np.empty((CHUNK_SAMPLES, len(channels)), np.int16)
        self._n_waiting = 0
        self._n_samples = 0
        self._gaps: list[tuple[int, int]] = []
        self._dropped = False

    def append(self, *blocks: Block) -> None:
        """Take blocks whose frames are safe; never raises for what the disk refuses."""
        for block in blocks:
            if block.lost_before > 0:
                self._gaps.append((block.first_sample, block.lost_before))
            rest = block.codes
            while len(rest) and not self._dropped:
                n = min(len(rest), CHUNK_SAMPLES - self._n_waiting)
                self._waiting[self._n_waiting : self._n_waiting + n] = rest[:n]
                self._n_waiting, rest = self._n_waiting + n, rest[n:]
                if self._n_waiting == CHUNK_SAMPLES:
                    self._write()

    def _write(self) -> None:
        """Hand what waits to the column file; drop that where it cannot be."""
        start, stop = self._n_samples, self._n_samples + self._n_waiting
        stamps = timestamps_ns(start, stop, self._rate_hz, self._gap_rows())
        try:
            if self._columns is None:
                self._columns = self._begin()
            if shutil.disk_usage(self._columns.part.parent).free < self._spare_bytes(stop):
                self.drop()  # what is more important needs the room
                return
            waiting = self._waiting[: self._n_waiting]
            self._columns.append(stamps, {name: waiting[:, i] for i, name in enumerate(self._channels)})
        except (OSError, RuntimeError, InputError):
            self.drop()
            return
        self._n_samples, self._n_waiting = stop, 0

    def _gap_rows(self) -> Integers:
        return np.array(self._gaps, np.int64).reshape(-1, 2)

    def drop(self) -> None:
        """Remove the unfinished file, if there is one and it can be; whatever comes is passed over."""
        self._dropped, self._n_waiting = True, 0
        columns, self._columns = self._columns, None
        if columns is not None:
            with contextlib.suppress(OSError, RuntimeError):  # a file that cannot be removed is written over at the end
                columns.abandon()

    def finish(self, recording: Recording, attributes: dict[str, Any]) -> ColumnWriter | None:
        """The column file of a run that has ended, whole and checked; None where the frames must be asked.

        ``recording`` is the closed frames file: its tables are taken, its samples must be those that came.
        """
        frames = recording.frames
        came = self._n_samples + self._n_waiting  # samples that the columns were given
        whole = frames is not None and not frames.faults and not frames.lost and frames.n_samples == came
        if self._columns is None or not whole or not np.array_equal(gaps_of(recording.blocks), self._gap_rows()):
            self.drop()
            return None
        self._write()
        columns = self._columns
        try:
            if columns is not None:
                columns.check(recording.steps, recording.blocks, recording.side, **attributes)
        except (OSError, RuntimeError):
            self.drop()
            return None
        self._columns = None
        return columns
