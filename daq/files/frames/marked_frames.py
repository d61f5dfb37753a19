"""Reader of a frames file by its marks, without HDF5: for one whose tables or indexes are damaged.

Every piece of frames (some hundred bytes) is compared with its checksum; what does not fit is left out.
"""

from __future__ import annotations

import json
import mmap
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.disk import mapped
from daq.files.frames.frame_file import ROW_CRC
from daq.files.frames.frame_marks import MAGIC, piece_rows, read_marks, rows_after
from daq.files.seal import text_crc
from daq.files.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE, crc32, joined

_ENDING = b'{"ended": '


class MarkedFrames:
    """A frames file as its marks describe it; `daq.files.frames.frame_file.FrameFile` is the same through HDF5.

    Raises `LookupError` when the file has no marks.

    ``data`` are a file's bytes, as `mapped` gives them; ``further`` rows of tables, read by another way, are added.

    Attributes
    ----------
    attrs
        Root attributes.
    blocks, steps, side, ending, n_samples
        As of a frames file; a block of which nothing is known has a row with its place only.
    lost
        Samples that are gone or differ, as ``(first, one past the last)``.
    bad_blocks
        Numbers of the blocks that they belong to.
    faults
        A line for each range of them.
    """

    def __init__(self, data: Any, further: Mapping[str, NDArray[np.void]] | None = None) -> None:
        self._data = data
        marks = read_marks(data)
        if marks is None:
            self.close()
            raise LookupError("a file without marks")
        self._marks = marks
        self.attrs = marks.attributes
        self.faults: list[str] = []
        self.lost: list[tuple[int, int]] = []
        self.blocks, crcs = self._block_table()
        self.n_samples = int(self.blocks["n_samples"].sum())
        for chunk in range(-(-self.n_samples // marks.chunk_rows)):
            if chunk not in marks.addresses:
                self._seek(chunk)
        self.bad_blocks = [i for i in range(len(self.blocks)) if self._compare(i, crcs[i])]
        self.lost = joined(self.lost)
        self.faults += [f"samples {a} to {b - 1} are gone, or differ from what was recorded" for a, b in self.lost]
        steps = self._table("steps", STEP_DTYPE, further or {})
        self.steps: NDArray[np.void] = steps[steps["first_sample"] < self.n_samples]
        self.steps["n_samples"] = np.minimum(self.steps["n_samples"], self.n_samples - self.steps["first_sample"])
        self.side = {name: self._table(name, dtype, further or {}) for name, dtype in SIDE_TABLES.items()}
        self.ending = self._ending()
        self._held = (0, 0, np.zeros((0, marks.n_channels), np.int16))

    def _block_table(self) -> tuple[NDArray[np.void], list[tuple[int, ...]]]:
        """Rows of all blocks in order, and their running checksums; blocks without a row are joined into one."""
        known, rows, crcs = self._marks.rows["blocks"], list[NDArray[np.void]](), list[tuple[int, ...]]()
        lengths = [int(n) for n in {int(row["n_samples"][0]) for row in known.values()}]
        at = 0

        def follow() -> None:
            """Blocks that no mark holds: the table itself may have their rows."""
            nonlocal at
            for row in rows_after(self._data, at, lengths, BLOCK_DTYPE.itemsize):
                rows.append(row)
                crcs.append(())
                at += int(row["n_samples"][0])

        for number in sorted(known):
            first, n = int(known[number]["first_sample"][0]), int(known[number]["n_samples"][0])
            if first > at:
                follow()
            if first > at:
                gone = f"samples {at} to {first - 1}: no row of their blocks is left"
                self.faults.append(f"{gone}; what was lost before them is not known")
                row = np.zeros(1, BLOCK_DTYPE)
                row["first_sample"], row["n_samples"] = at, first - at
                rows.append(row)
                crcs.append(())
                self.lost.append((at, first))
                at = first
            if first == at:
                rows.append(known[number])
                crcs.append(self._marks.crcs[number])
                at = first + n
        follow()
        return _stacked(rows, BLOCK_DTYPE), crcs

    def _seek(self, chunk: int) -> None:
        """Find a chunk whose place no mark holds behind the one before it, by the CRC-32 of a block that lies in it."""
        marks, row_bytes = self._marks, 2 * self._marks.n_channels
        begin, end = chunk * marks.chunk_rows, (chunk + 1) * marks.chunk_rows
        ends = self.blocks["first_sample"] + self.blocks["n_samples"]
        within = self.blocks[(self.blocks["first_sample"] >= begin) & (ends <= end) & (self.blocks["crc32"] > 0)]
        before = marks.addresses.get(chunk - 1, 0)
        # the next chunk begins within 256 KiB behind this one
        data = self._data[before : before + row_bytes * marks.chunk_rows + (256 << 10)]
        after = row_bytes * marks.chunk_rows if before else 0
        for row in within[:1]:
            offset, n_bytes = row_bytes * int(row["first_sample"] - begin), row_bytes * int(row["n_samples"])
            for at in range(after + offset, len(data) - n_bytes + 1):
                if zlib.crc32(data[at : at + n_bytes]) == row["crc32"]:
                    marks.addresses[chunk] = before + at - offset
                    return

    def _compare(self, number: int, crcs: tuple[int, ...]) -> bool:
        """Compare a block with its checksums; whether something differs, which is added to `lost`."""
        row = self.blocks[number]
        first, n = int(row["first_sample"]), int(row["n_samples"])
        if self.lost and self.lost[-1] == (first, first + n):
            return True
        codes = self._read(first, first + n)
        if crc32(codes) == row["crc32"] and all(self._is_there(first, first + n)):
            return False
        step, before = piece_rows(n, self._marks.n_channels), 0
        if not crcs:
            self.lost.append((first, first + n))
        for k, crc in enumerate(crcs):
            a, b = k * step, min((k + 1) * step, n)
            if crc32(codes[a:b], before) != crc or not all(self._is_there(first + a, first + b)):
                self.lost.append((first + a, first + b))
            before = crc
        return True

    def _is_there(self, start: int, stop: int) -> list[bool]:
        """Whether each chunk that holds samples ``start`` to ``stop`` has a known place within the file."""
        marks = self._marks
        size = 2 * marks.n_channels
        return [
            k in marks.addresses
            and marks.addresses[k] + size * (min(stop - k * marks.chunk_rows, marks.chunk_rows)) <= len(self._data)
            for k in range(start // marks.chunk_rows, (stop - 1) // marks.chunk_rows + 1)
        ]

    def _read(self, start: int, stop: int) -> NDArray[np.int16]:
        """Frames ``start`` to ``stop``, zeros where a chunk's place is not known."""
        marks, pieces, at = self._marks, [np.zeros((0, self._marks.n_channels), np.int16)], start
        while at < stop:
            k, within = divmod(at, marks.chunk_rows)
            n = min(stop - at, marks.chunk_rows - within)
            size = 2 * marks.n_channels
            begin = marks.addresses.get(k, len(self._data)) + size * within
            piece = self._data[begin : begin + size * n].ljust(size * n, b"\0")
            pieces.append(np.frombuffer(piece, "<i2").astype(np.int16).reshape(n, -1))
            at += n
        return np.concatenate(pieces)

    def _table(self, name: str, dtype: np.dtype[Any], further: Mapping[str, NDArray[np.void]]) -> NDArray[np.void]:
        """A table by its marks, and rows that were read by another way and are not among those."""
        rows = dict(sorted(self._marks.rows[name].items()))
        held = {row.tobytes(): row for row in rows.values()}
        is_step = name == "steps"  # of which the last row of one beginning counts
        if is_step:
            held = {row["first_sample"].tobytes(): row for row in held.values()}
        for other in further.get(name, np.zeros(0, dtype)):
            row = np.array([other], dtype)
            # a step by another way may have been cut where that way lost the samples
            held.setdefault(row["first_sample"].tobytes() if is_step else row.tobytes(), row)
        table = _stacked(held.values(), dtype)
        return table[np.argsort(table[(dtype.names or ("",))[0]], kind="stable")]

    def _ending(self) -> dict[str, Any]:
        """How the run ended, where that was written."""
        at, found = self._data.find(_ENDING), {"ended": "incomplete", "why": "", "ended_at": ""}
        while at >= 0:
            try:
                text = self._data[at : at + 4096].decode(errors="replace")
                ending = dict(json.JSONDecoder().raw_decode(text)[0])
                if ending.pop(ROW_CRC, None) == text_crc(ending) and ending["ended"] != "incomplete":
                    found = ending
            except (ValueError, KeyError):
                pass  # not an ending, or a damaged one
            at = self._data.find(_ENDING, at + 1)
        return found

    def rows(self, start: int, stop: int) -> NDArray[np.int16]:
        """Frames ``start`` to ``stop``, int16 ``(n, channels)``; the last range that was read stays in memory."""
        stop = min(stop, self.n_samples)
        if (start, stop) != self._held[:2]:
            self._held = (start, stop, self._read(start, stop))
        return self._held[2]

    def damaged(self, n_samples: int) -> list[int]:
        """Blocks that do not fit their checksum, which is known since the file was opened."""
        del n_samples
        return self.bad_blocks

    def close(self) -> None:
        """Let go of the file."""
        if isinstance(self._data, mmap.mmap):
            self._data.close()


def _stacked(rows: Iterable[NDArray[np.void]], dtype: np.dtype[Any]) -> NDArray[np.void]:
    """Rows (1,) as one array; `numpy.concatenate` compares their types field by field, each time."""
    return np.frombuffer(bytearray(b"".join(row.tobytes() for row in rows)), dtype)


def has_marks(path: Path) -> bool:
    """Whether the file holds the beginning of a mark."""
    return bool(mapped(path).find(MAGIC) >= 0)
