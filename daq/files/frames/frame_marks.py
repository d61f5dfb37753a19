"""Marks between the frames of a run: what finds its samples again when HDF5's own tables are gone.

A mark is a page of `frame_marks` in the frames file. It is written once and never changed, begins with `MAGIC`, and
carries its own CRC-32, the root attributes, where the last chunks of frames lie in the file, and the rows of all tables
since the mark before last. So each row stands in two marks, which are a chunk of frames away from each other. A reader
finds marks by their magic in any file, whatever is left of the rest. Decision 467.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE

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
