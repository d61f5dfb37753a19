"""The frames file: what a recording is while the run lasts. Row-major int16 frames, a checksum a block.

Once `FrameWriter.append` has returned, killing the process cannot lose the block. Everything is created before the
first sample, the file is in HDF5's single-writer-multiple-readers mode, and each block is flushed (frames first, then
the row that acknowledges them). A row without its frames cannot exist; frames without a row are not part of the
recording. The end state is ``incomplete`` from the start.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.files.disk import in_words, sync_folder
from daq.files.frames.frame_file import (
    FRAME_BLOCKS,
    FRAME_END,
    FRAME_MARKS,
    FRAME_SIDE,
    FRAME_STEPS,
    FRAMES,
    ROW_CRC,
    sealed_dtype,
    sealed_rows,
)
from daq.files.frames.marked_frames import MarkLog, running_crcs
from daq.files.seal import text_crc
from daq.files.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE, Block, step_row
from daq.setup.errors import InputError

_END_BYTES = 4096


class FrameWriter:
    """Write a frames file; raises `InputError` when ``path`` exists, or its folder does not.

    ``channels`` are in the order of a frame; root ``attributes`` are written once, before the first sample.
    """

    def __init__(self, path: Path, channels: Sequence[str], attributes: Mapping[str, Any]) -> None:
        if not path.parent.is_dir():
            raise InputError(f"{path}: the folder {path.parent} does not exist; create it first.")
        try:
            self._file = h5py.File(path, "x", libver=("v110", "v110"))
        except OSError as error:
            if path.exists():
                raise InputError(f"{path}: exists already and is never overwritten; choose another name.") from error
            raise InputError(f"{path}: cannot be created ({error}).") from error
        self.path = path
        self.is_broken = False
        self._hdf5_descriptor = self._file.id.get_vfd_handle()
        self._identity = os.fstat(self._hdf5_descriptor).st_ino  # by which a file that was replaced is noticed
        try:
            self._lay_out(channels, attributes)
        except (OSError, RuntimeError) as error:
            self._let_go()
            with contextlib.suppress(OSError):
                path.unlink()
            raise InputError(f"{path}: cannot be created ({in_words(error)}).") from error

    def _lay_out(self, channels: Sequence[str], attributes: Mapping[str, Any]) -> None:
        """Create all that the file will hold (raises OSError or RuntimeError where the disk refuses)."""
        self.n_samples = self.n_lost = self.n_doubtful = 0
        self._n_channels = len(channels)
        self._n_blocks = self._n_steps = 0
        self._last_step_first = -1
        self._chunk_rows = max(1, 65536 // (2 * self._n_channels))
        shape = self._chunk_rows, self._n_channels
        self._frames = self._file.create_dataset(
            FRAMES, (0, self._n_channels), "<i2", maxshape=(None, self._n_channels), chunks=shape
        )
        self._blocks = self._table(FRAME_BLOCKS, BLOCK_DTYPE, 256)
        self._steps = self._table(FRAME_STEPS, STEP_DTYPE, 16)
        self._side = {table: self._table(FRAME_SIDE[table], dtype, 64) for table, dtype in SIDE_TABLES.items()}
        self._end = self._file.create_dataset(FRAME_END, (_END_BYTES,), "u1", chunks=(_END_BYTES,))
        self.end({"ended": "incomplete", "why": "", "ended_at": ""})
        self._frame_type = h5py.h5t.py_create(np.dtype("<i2"))
        self._row_type = h5py.h5t.py_create(sealed_dtype(BLOCK_DTYPE))
        attributes = dict(attributes) | {"attributes_crc32": text_crc(attributes)}
        self._file.attrs.update(attributes)
        self._log = MarkLog(attributes, self._n_channels, self._chunk_rows)
        page = self._log.page_bytes
        self._marks = self._file.create_dataset(FRAME_MARKS, (0,), "u1", maxshape=(None,), chunks=(page,))
        self._n_pages = 0
        self._file.flush()
        # single writer, multiple readers: every flush leaves a file that another process can open
        self._file.swmr_mode = True
        self._descriptor = os.open(self.path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        sync_folder(self.path.parent)  # a step that is synced later is of no use in a file without a name

    def _table(self, name: str, dtype: np.dtype[Any], chunk: int) -> Any:
        return self._file.create_dataset(name, (0,), sealed_dtype(dtype), maxshape=(None,), chunks=(chunk,))

    def append(self, *blocks: Block) -> None:
        """Write blocks that follow each other; when this returns they survive the end of the process.

        Raises `ValueError` when a block does not follow the one before, or has another number of channels; `OSError`
        when the disk refuses, or the file was removed: what was acknowledged before stays.
        """
        expected = self.n_samples
        for block in blocks:
            if block.codes.ndim != 2 or block.codes.shape[1] != self._n_channels:
                raise ValueError(f"wanted frames of {self._n_channels} channels, got an array of {block.codes.shape}")
            if block.first_sample != expected:
                raise ValueError(f"wanted a block that starts at sample {expected}, got {block.first_sample}")
            expected += len(block.codes)
        if self.has_vanished():
            raise OSError(f"{self.path}: was removed while it was being written; closing keeps a copy elsewhere")
        if blocks:
            with self._refusals():
                self._write(blocks)

    @contextlib.contextmanager
    def _refusals(self) -> Iterator[None]:
        """One error for both by which HDF5 reports a disk that refuses; it is the last that happens to the file."""
        if self.is_broken:
            raise OSError(f"{self.path}: the disk had refused")
        try:
            yield
        except (OSError, RuntimeError) as error:
            self._let_go()
            raise OSError(
                f"{self.path}: the disk refuses ({in_words(error)}); what was recorded before is safe"
            ) from error

    def _write(self, blocks: Sequence[Block]) -> None:
        """Frames first, then the rows that acknowledge them."""
        pieces = [np.ascontiguousarray(block.codes, "<i2") for block in blocks]
        frames = np.concatenate(pieces) if len(pieces) > 1 else pieces[0]
        crcs = [running_crcs(piece) for piece in pieces]
        rows = np.array(
            [
                (b.first_sample, len(c), b.flags, b.clock_ns, b.lost_before, b.lost_uncertainty, b.adc_ns, crc[-1])
                for b, c, crc in zip(blocks, pieces, crcs, strict=True)
            ],
            BLOCK_DTYPE,
        )
        # a kill between the two leaves frames without a row, which are no part of the recording
        _extend(self._frames, self.n_samples, frames, self._frame_type)
        _extend(self._blocks, self._n_blocks, sealed_rows(rows), self._row_type)
        for i, block in enumerate(blocks):
            self._log.add_block(self._n_blocks + i, rows[i : i + 1], crcs[i])
            self.n_lost += block.lost_before
            self.n_doubtful += block.lost_uncertainty
        self.n_samples += len(frames)
        self._n_blocks += len(rows)
        if self._log.n_chunks * self._chunk_rows < self.n_samples:
            self._write_marks()

    def _write_marks(self) -> None:
        """Write what the marks do not hold yet, and where the chunks of frames lie that were begun since."""
        for first in range(self._log.n_chunks * self._chunk_rows, self.n_samples, self._chunk_rows):
            self._log.add_chunk(self._frames.id.get_chunk_info_by_coord((first, 0)).byte_offset)
        for page in self._log.pages():
            # straight to the file, past HDF5's cache: nothing waits for a flush
            self._marks.id.set_extent(((self._n_pages + 1) * len(page),))
            self._marks.id.write_direct_chunk((self._n_pages * len(page),), page)
            self._n_pages += 1

    def mark_step(self, step: np.void | Mapping[str, Any]) -> None:
        """Write a step's row; one with the same ``first_sample`` as the last replaces it. Then sync to the disk."""
        row = step_row(step)
        with self._refusals():
            if int(row["first_sample"][0]) != self._last_step_first:
                self._steps.resize((self._n_steps + 1,))
                self._n_steps += 1
                self._last_step_first = int(row["first_sample"][0])
            self._steps[self._n_steps - 1 :] = sealed_rows(row)
            self._steps.id.flush()
            # the row above is written where the one before it stood, which a loss of power may leave half changed
            self._log.add_rows("steps", self._n_steps - 1, row)
            self._write_marks()
            os.fsync(self._descriptor)

    def mark_rows(self, table: str, rows: NDArray[np.void]) -> None:
        """Add rows to one of `daq.files.tables.SIDE_TABLES`."""
        dataset = self._side[table]
        with self._refusals():
            n = dataset.shape[0]
            dataset.resize((n + len(rows),))
            rows = rows.astype(SIDE_TABLES[table])
            dataset[n:] = sealed_rows(rows)
            dataset.id.flush()
            self._log.add_rows(table, n, rows)

    def _let_go(self) -> None:
        """Keep HDF5 from the file: it writes again what was refused, when it closes the file and when the process ends.

        It would crash the process there, or leave a file that claims to be whole. What it writes goes nowhere.
        """
        self.is_broken = True
        with contextlib.suppress(OSError):
            if os.fstat(self._hdf5_descriptor).st_ino == self._identity:  # it has not been closed
                nowhere = os.open(os.devnull, os.O_RDWR)
                os.dup2(nowhere, self._hdf5_descriptor)
                os.close(nowhere)

    def end(self, ending: Mapping[str, Any]) -> None:
        """Write how the run ended (JSON in bytes that have their place from the start: no kill can tear the file)."""

        def text_of(ending: Mapping[str, Any]) -> bytes:
            return json.dumps({**ending, ROW_CRC: text_crc(ending)}).encode()

        text = text_of(ending)
        # a reason too long for its place is cut: twelve bytes at most for a character of JSON
        if len(text) > _END_BYTES:
            text = text_of({**ending, "why": str(ending.get("why", ""))[: _END_BYTES // 12]})
        with self._refusals():
            self._end[:] = np.frombuffer(text.ljust(_END_BYTES), np.uint8)
            self._end.id.flush()
        if self.n_samples:
            self._write_marks()
            os.fsync(self._descriptor)  # a loss of power may undo the rename that follows

    @property
    def is_open(self) -> bool:
        """Whether `close` was not called yet."""
        return bool(self._file.id.valid)

    def has_vanished(self) -> bool:
        """Whether the file is no longer under its name (a name whose folder cannot be looked into is believed)."""
        try:
            return os.stat(self.path).st_ino != self._identity  # noqa: PTH116 (2 us; a Path costs more, every block)
        except FileNotFoundError:
            return True
        except OSError:
            return False

    def close(self) -> Path:
        """Close and say where the frames are: under the file's name, or in a copy where that name is gone.

        Raises `OSError` when the disk had refused: the file is left as a killed process leaves it, for `bench recover`.
        """
        vanished = self.has_vanished()
        try:
            self._file.close()
        except (OSError, RuntimeError) as error:
            self._let_go()
            raise OSError(f"{self.path}: could not be closed ({error})") from error
        finally:
            where = self.path
            if vanished:  # this process still holds the content: it is copied
                folder = where.parent if where.parent.is_dir() else Path(tempfile.gettempdir())
                where = folder / f"{where.stem}.rescued-{os.getpid()}{where.suffix}"
                try:
                    with where.open("xb") as copy:
                        os.lseek(self._descriptor, 0, os.SEEK_SET)
                        while piece := os.read(self._descriptor, 1 << 20):
                            copy.write(piece)
                except OSError:
                    if where.exists() and not where.stat().st_size:  # a part of it may still be recovered
                        where.unlink()
                    raise
            os.close(self._descriptor)
        if self.is_broken and not vanished:
            raise OSError(f"{self.path}: the disk had refused")
        return where


memory_space = functools.lru_cache(maxsize=16)(h5py.h5s.create_simple)  # of a block's shape


def _extend(dataset: Any, start: int, rows: NDArray[Any], memory_type: Any) -> None:
    """Append rows and flush, by HDF5's own calls: a third of the time that h5py's indexing takes, every block."""
    place, shape = dataset.id, rows.shape
    place.set_extent((start + len(rows), *shape[1:]))
    where = place.get_space()
    where.select_hyperslab((start,) + (0,) * (rows.ndim - 1), shape)
    place.write(memory_space(shape), where, rows, memory_type)
    place.flush()
