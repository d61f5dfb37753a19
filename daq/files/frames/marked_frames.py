"""Marks between the frames of a run, and the reader that finds its samples by them when HDF5's own tables are gone.

A mark is a page of the data set `frame_marks` in the frames file. It is written once and never changed, begins with
`MAGIC`, and carries its own CRC-32, the root attributes, where the last chunks of frames lie in the file, and the rows
of all tables since the mark before last. So each row stands in two marks, which are a chunk of frames away from each
other. A reader finds marks by their magic in any file, whatever is left of the rest. Decision 467.

Every piece of frames (some hundred bytes) is compared with its checksum; what does not fit is left out.
"""

from __future__ import annotations

import json
import mmap
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.disk import mapped
from daq.files.frames.frame_file import ROW_CRC
from daq.files.seal import text_crc
from daq.files.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE, crc32, joined

MAGIC = b"\x89MARK\r\n\x01"
"""Its last byte is the version of what follows: a change of a table's fields needs another one."""
_HEAD = struct.Struct("<8sIIIIIHHQ")
_ROW = struct.Struct("<BI")  # table (its place in `TABLES`, from 1; 0 ends the rows), number of the row
TABLES = {"blocks": BLOCK_DTYPE, "steps": STEP_DTYPE, **SIDE_TABLES}
_PLACE = {name: i for i, name in enumerate(TABLES, start=1)}
PAGE_BYTES = 4096
MOST_PIECES = 256  # of one block
KNOWN_CHUNKS = 16  # whose places a mark holds


def piece_rows(n_samples: int, n_channels: int) -> int:
    """Samples in a piece of a block of ``n_samples``: 256 bytes, more in a block that has more than 256 of them."""
    return max(256 // (2 * n_channels), -(-n_samples // MOST_PIECES), 1)


def running_crcs(codes: NDArray[np.int16]) -> list[int]:
    """CRC-32 of a block ``(n, channels)`` from its beginning to the end of each piece; the last is the block's.

    Each piece can be checked without those before it: its CRC-32, begun with the one before, gives the one after.
    """
    view = codes.data.cast("B")
    step = piece_rows(*codes.shape) * 2 * codes.shape[1]
    crc, crc32 = 0, zlib.crc32
    return [crc := crc32(view[at : at + step], crc) for at in range(0, len(view), step)]


class MarkLog:
    """Rows on their way into marks."""

    def __init__(self, attributes: Mapping[str, Any], n_channels: int, chunk_rows: int) -> None:
        plain = {k: v.item() if isinstance(v, np.generic) else v for k, v in attributes.items()}
        self._header = zlib.compress(json.dumps(plain).encode())
        self._shape = n_channels, chunk_rows
        needed = _HEAD.size + 8 * KNOWN_CHUNKS + len(self._header) + BLOCK_DTYPE.itemsize + 8 * MOST_PIECES
        self.page_bytes = -(-needed // PAGE_BYTES) * PAGE_BYTES
        self._sequence = 0
        self._addresses: list[int] = []
        self.n_chunks = 0  # whose place is known
        self._new: list[bytes] = []
        self._last: list[bytes] = []

    def add_chunk(self, address: int) -> None:
        """The next chunk of frames lies at byte ``address`` of the file."""
        self._addresses = [*self._addresses, address][-KNOWN_CHUNKS:]
        self.n_chunks += 1

    def add_block(self, number: int, row: NDArray[np.void], crcs: Sequence[int]) -> None:
        """A row (1,) of the block table and the block's `running_crcs`."""
        self._new.append(_ROW.pack(1, number) + row.tobytes() + struct.pack(f"<{len(crcs)}I", *crcs))

    def add_rows(self, table: str, first: int, rows: NDArray[np.void]) -> None:
        """Rows of another table, from number ``first`` on; one that was there before counts no longer."""
        self._new += [_ROW.pack(_PLACE[table], first + i) + row.tobytes() for i, row in enumerate(rows)]

    def pages(self) -> list[bytes]:
        """Marks that hold what was added since the last call, and what that one gave."""
        n_channels, chunk_rows = self._shape
        places = struct.pack(f"<{len(self._addresses)}q", *self._addresses)
        first_chunk = self.n_chunks - len(self._addresses)
        room = self.page_bytes - _HEAD.size - len(self._header) - len(places)
        rows, pages, taken = self._last + self._new, list[bytes](), 0
        while taken < len(rows) or not pages:
            size, start = 0, taken
            while taken < len(rows) and size + len(rows[taken]) <= room:
                size += len(rows[taken])
                taken += 1
            body = _HEAD.pack(
                MAGIC, 0, self.page_bytes, self._sequence, len(self._header), chunk_rows, n_channels,
                len(self._addresses), first_chunk,
            )[12:]  # fmt: skip
            body = (body + self._header + places + b"".join(rows[start:taken])).ljust(self.page_bytes - 12, b"\0")
            pages.append(MAGIC + zlib.crc32(body).to_bytes(4, "little") + body)
            self._sequence += 1
        self._last, self._new = self._new, []
        return pages


@dataclass
class Marks:
    """Content of the marks of a file."""

    attributes: dict[str, Any] = field(default_factory=dict)  # root attributes
    n_channels: int = 0
    chunk_rows: int = 0  # samples in a chunk of frames
    addresses: dict[int, int] = field(default_factory=dict)  # first byte of each chunk of frames, by its number
    rows: dict[str, dict[int, NDArray[np.void]]] = field(default_factory=lambda: {name: {} for name in TABLES})
    crcs: dict[int, tuple[int, ...]] = field(default_factory=dict)  # `running_crcs` by number of the block
    n_damaged: int = 0  # marks that differ from what was written


def read_marks(data: Any) -> Marks | None:
    """Content of all whole marks in the bytes of a file (or an `mmap.mmap` of it); None where there are none."""
    marks, pages, at = Marks(), list[tuple[int, bytes]](), data.find(MAGIC)
    while at >= 0:
        head = data[at : at + _HEAD.size]
        length = int.from_bytes(head[12:16], "little")
        page = data[at : at + length] if _HEAD.size <= length <= 16 << 20 else b""
        whole = len(page) == length and zlib.crc32(page[12:]) == int.from_bytes(head[8:12], "little")
        if whole and page:
            pages.append((int.from_bytes(head[16:20], "little"), bytes(page)))
        else:
            marks.n_damaged += 1
        at = data.find(MAGIC, at + (length if whole and page else 1))
    for _, page in sorted(pages):  # rows that were written again count as in the latest mark
        _, _, _, _, n_header, marks.chunk_rows, marks.n_channels, n_places, first_chunk = _HEAD.unpack_from(page)
        if not marks.attributes:
            marks.attributes = dict(json.loads(zlib.decompress(page[_HEAD.size : _HEAD.size + n_header])))
        at = _HEAD.size + n_header
        marks.addresses |= enumerate(struct.unpack_from(f"<{n_places}q", page, at), start=first_chunk)
        _take_rows(marks, page, at + 8 * n_places)
    return marks if pages else None


def _take_rows(marks: Marks, page: bytes, at: int) -> None:
    """Add the rows of a mark, which begin at byte ``at`` of it."""
    names = list(TABLES)
    while at + _ROW.size <= len(page) and page[at]:
        place, number = _ROW.unpack_from(page, at)
        name, at = names[place - 1], at + _ROW.size
        row = np.frombuffer(page, TABLES[name], 1, at).copy()
        at += row.nbytes
        marks.rows[name][number] = row
        if name == "blocks":
            n = int(row["n_samples"][0])
            n_pieces = -(-n // piece_rows(n, marks.n_channels))
            marks.crcs[number] = struct.unpack_from(f"<{n_pieces}I", page, at)
            at += 4 * n_pieces


def rows_after(data: Any, first_sample: int, lengths: Sequence[int], row_bytes: int) -> Iterator[NDArray[np.void]]:
    """Rows (1,) of the block table itself that follow each other from ``first_sample`` on, found by their CRC-32.

    ``lengths``: samples that a block may have; ``row_bytes``: of a row without its CRC-32.
    """
    while True:
        for n in lengths:
            pattern = struct.pack("<qq", first_sample, n)
            at = data.find(pattern)
            while at >= 0:
                row, after = data[at : at + row_bytes], data[at + row_bytes : at + row_bytes + 4]
                if len(row) == row_bytes and zlib.crc32(row) == int.from_bytes(after, "little"):
                    break
                at = data.find(pattern, at + 1)
            if at >= 0:
                break
        else:
            return
        yield np.frombuffer(row, BLOCK_DTYPE, 1).copy()
        first_sample += n


_ENDING = b'{"ended": '


class MarkedFrames:
    """A frames file as its marks describe it; `daq.files.frames.frame_file.FrameFile` is the same through HDF5.

    ``data`` are a file's bytes, as `mapped` gives them; ``further`` rows of tables, read by another way, are added. A
    block of which nothing is known has a row with its place only. Samples ``lost`` are gone or differ, as ``(first, one
    past the last)``; ``bad_blocks`` are the numbers of their blocks, ``faults`` a line for each range. Raises
    `LookupError` when the file has no marks.
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
