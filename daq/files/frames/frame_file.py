"""Reader of a frames file: a recording while the run lasts, or one that was cut off.

Only acknowledged blocks count, and rows that fit their checksum. Faults are listed; what they touch is left out.
"""

from __future__ import annotations

import functools
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.disk import PatchedFile, dataset_of, refuse_claims
from daq.files.seal import text_crc
from daq.files.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE, crc32
from daq.setup.errors import InputError
from kernels.arrays import Bools

FRAMES, FRAME_BLOCKS, FRAME_STEPS = "frames", "frame_blocks", "frame_steps"
FRAME_SIDE = {"drive_changes": "frame_drive", "clock_readings": "frame_clock", "clock_map": "frame_clock_map",
              "notes": "frame_notes"}  # fmt: skip
FRAME_END = "frame_end"
FRAME_MARKS = "frame_marks"
ROW_CRC = "row_crc32"
_SUPERBLOCK_BYTES = 48  # of versions 2 and 3


@functools.cache
def sealed_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Rows of ``dtype``, each with the CRC-32 of its bytes."""
    return np.dtype([*((name, dtype[name]) for name in dtype.names or ()), (ROW_CRC, "<u4")])


def sealed_rows(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Rows, each with the CRC-32 of its bytes."""
    held, size = rows.tobytes(), rows.dtype.itemsize
    pieces = [held[at : at + size] for at in range(0, len(held), size)]
    sealed = b"".join([piece + zlib.crc32(piece).to_bytes(4, "little") for piece in pieces])
    return np.frombuffer(sealed, sealed_dtype(rows.dtype))


def is_being_written(path: Path) -> bool:
    """Whether the file is in single-writer-multiple-readers mode: a run is on, or was cut off.

    HDF5 file format, superblock version 3: byte 8 is the version, bit 2 of byte 11 the mode.
    """
    head = _superblock(path)
    return len(head) == _SUPERBLOCK_BYTES and head[8] >= 3 and bool(head[11] & 4)


def is_cut_short(path: Path) -> bool:
    """Whether the file is shorter than it says: HDF5 could not write its end, or a copy was not finished.

    HDF5 file format, superblock versions 2 and 3: bytes 28 to 35 are the address of the end of the file.
    """
    return path.stat().st_size < stated_bytes(path)


def stated_bytes(path: Path) -> int:
    """End of HDF5's part of the file, as the file states it; 0 where it does not."""
    head = _superblock(path)
    end = int.from_bytes(head[28:36], "little")
    return end if len(head) == _SUPERBLOCK_BYTES and head[8] >= 2 and end < 2**64 - 1 else 0


def _superblock(path: Path) -> bytes:
    with path.open("rb") as raw:
        return raw.read(_SUPERBLOCK_BYTES)


def as_if_ended(path: Path) -> PatchedFile:
    """A frames file as if its writer had closed it, so that HDF5 does not wait for tables that are damaged.

    A reader of a file in single-writer-multiple-readers mode repeats what does not read, ever more slowly. The
    superblock (version 3) is read with the mode's bits cleared, the file's own length, and the checksum of that.
    """
    head = bytearray(_superblock(path))
    if len(head) < _SUPERBLOCK_BYTES:
        return PatchedFile(path)
    head[11] &= ~5
    head[28:36] = path.stat().st_size.to_bytes(8, "little")
    head[44:] = lookup3(bytes(head[:44])).to_bytes(4, "little")
    return PatchedFile(path, [(0, bytes(head))])


def lookup3(data: bytes) -> int:
    """HDF5's checksum of metadata (Jenkins 2006, ``hashlittle`` with a start of 0)."""
    a = b = c = (0xDEADBEEF + len(data)) & 0xFFFFFFFF
    pieces = [data[at : at + 12] for at in range(0, max(len(data), 1), 12)]
    for piece in pieces:
        words = [int.from_bytes(piece[at : at + 4], "little") for at in (0, 4, 8)]
        a, b, c = ((x + word) & 0xFFFFFFFF for x, word in zip((a, b, c), words, strict=True))
        if piece is not pieces[-1]:
            for turn in (4, 6, 8, 16, 19, 4):
                a = ((a - c) ^ _turned(c, turn)) & 0xFFFFFFFF
                a, b, c = b, (c + b) & 0xFFFFFFFF, a
    for turn in (14, 11, 25, 16, 4, 14, 24):
        a, b, c = b, ((c ^ b) - _turned(b, turn)) & 0xFFFFFFFF, a
    return b


def _turned(x: int, bits: int) -> int:
    return (x << bits | x >> (32 - bits)) & 0xFFFFFFFF


class FrameFile:
    """Read a frames file, finished or not; only acknowledged blocks count.

    ``file`` is open and holds `FRAMES`; the tables ``without`` cannot be read and are taken as empty. Raises
    `InputError` when a table is none, or claims more than the file holds.
    """

    def __init__(self, file: Any, path: Path, without: Sequence[str] = ()) -> None:
        self._frames = dataset_of(file, FRAMES, path, dimensions=2)
        self.faults: list[str] = []
        self.lost: list[tuple[int, int]] = []
        text = table_of(file, FRAME_END, np.dtype("u1"), path)[0].tobytes()
        try:
            self.ending: dict[str, Any] = dict(json.loads(text))
            if ROW_CRC in self.ending and self.ending.pop(ROW_CRC) != text_crc(self.ending):
                raise ValueError(ROW_CRC)
        except (ValueError, TypeError):
            self.faults.append("how the run ended differs from what was written: it is taken as cut off")
            self.ending = {"ended": "incomplete", "why": "", "ended_at": ""}
        stored = min(self._frames.shape[0], self._frames.id.get_num_chunks() * self._frames.chunks[0])
        self.blocks: NDArray[np.void] = self._whole_blocks(*table_of(file, FRAME_BLOCKS, BLOCK_DTYPE, path), stored)
        self.n_samples = int(self.blocks[-1]["first_sample"] + self.blocks[-1]["n_samples"]) if len(self.blocks) else 0

        def sound(name: str, dtype: np.dtype[Any]) -> NDArray[np.void]:
            if name not in file or name in without:
                return np.zeros(0, dtype)
            rows, intact = table_of(file, name, dtype, path)
            self.faults += [f"{name}: row {i} differs from what was written" for i in np.flatnonzero(~intact)]
            return rows[intact]

        steps = sound(FRAME_STEPS, STEP_DTYPE)
        self.steps: NDArray[np.void] = steps[steps["first_sample"] < self.n_samples].copy()
        self.steps["n_samples"] = np.minimum(self.steps["n_samples"], self.n_samples - self.steps["first_sample"])
        self.side = {table: sound(FRAME_SIDE[table], dtype) for table, dtype in SIDE_TABLES.items()}
        self._held = (0, 0, np.zeros((0, self._frames.shape[1]), np.int16))

    def _whole_blocks(self, rows: NDArray[np.void], intact: Bools, stored: int) -> NDArray[np.void]:
        """Blocks that follow each other and whose frames are there; where a row differs, its samples are lost."""
        rows, at = rows.copy(), 0
        n_whole = int(np.flatnonzero(intact)[-1]) + 1 if intact.any() else 0
        if not intact.all():
            self.faults += [
                f"block {i}: its row differs from what was written; its samples are left out, and what was lost before "
                "it is not known" for i in np.flatnonzero(~intact)
            ]  # fmt: skip
        for i in np.flatnonzero(~intact[:n_whole]):
            follows = rows[i + 1 : n_whole][intact[i + 1 : n_whole]]["first_sample"]
            at = int(rows[i - 1]["first_sample"] + rows[i - 1]["n_samples"]) if i else 0
            n = int(follows[0]) - at if intact[i + 1] else 1
            rows[i] = np.zeros((), rows.dtype)
            rows[i]["first_sample"], rows[i]["n_samples"] = at, n
            self.lost.append((at, at + n))
        rows = rows[:n_whole]
        ends = rows["first_sample"] + rows["n_samples"]
        starts = np.concatenate([[0], ends[:-1]]) if len(rows) else ends
        whole = (rows["first_sample"] == starts) & (rows["n_samples"] > 0) & (ends <= stored)
        return rows if whole.all() else rows[: int(np.argmin(whole))]

    def rows(self, start: int, stop: int) -> NDArray[np.int16]:
        """Frames ``start`` to ``stop``, int16 ``(n, channels)``; the last range that was read stays in memory."""
        stop = min(stop, self.n_samples)
        if (start, stop) != self._held[:2]:
            self._held = (start, stop, self._frames[start:stop])
        return self._held[2]

    def damaged(self, n_samples: int) -> list[int]:
        """Blocks whose frames do not fit their checksum, read about ``n_samples`` at a time."""
        bad, first = [], self.blocks["first_sample"].tolist()
        ends = (self.blocks["first_sample"] + self.blocks["n_samples"]).tolist()
        begin = 0
        for k, crc in enumerate(self.blocks["crc32"].tolist()):
            if k == begin:  # the next blocks, in one go
                last = min(int(np.searchsorted(ends, first[k] + n_samples)), len(ends) - 1)
                rows, start, begin = self.rows(first[k], ends[last]), first[k], last + 1
            if crc32(rows[first[k] - start : ends[k] - start]) != crc:
                bad.append(k)
        return bad


def table_of(file: Any, name: str, dtype: np.dtype[Any], path: Path) -> tuple[NDArray[Any], Bools]:
    """A table of a frames file, and which rows are as they were written (raises InputError: not of ``dtype``)."""
    dataset = dataset_of(file, name, path)
    refuse_claims(dataset, path, streamed=False)
    if dataset.dtype == dtype:  # by an earlier version: rows without a checksum
        return dataset[()], np.ones(len(dataset), np.bool_)
    if dtype.names is None or dataset.dtype != sealed_dtype(dtype):
        raise InputError(f"{path}: /{name}: damaged: wanted rows of {dtype}, found {dataset.dtype}")
    sealed = dataset[()]
    rows = np.zeros(len(sealed), dtype)
    for field in dtype.names:
        rows[field] = sealed[field]
    held, size = rows.tobytes(), dtype.itemsize
    stored = sealed[ROW_CRC].tolist()
    intact = [zlib.crc32(held[k * size : (k + 1) * size]) == crc for k, crc in enumerate(stored)]
    return rows, np.array(intact, np.bool_)
