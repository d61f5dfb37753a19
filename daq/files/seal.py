"""The seal: checksums over every byte of a closed recording, behind the end of the HDF5 file.

HDF5 is handed only bytes that were found to be those that were written. Damaged tables and indexes make it loop or
crash; so they are compared before it sees them, and put right from a second copy in the seal. What else is damaged is
computed from parity over the whole file. The table of checksums stands before the parity and twice behind it.
Decisions 470, 572.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray

from daq.files.disk import mapped
from daq.files.parity import SECTOR, SPARE, parity_of, restored, sector_crcs, stripe_sectors

Found = TypeVar("Found")
MAGIC = b"\x89SEAL\r\n\x1a"
FOOTER = struct.Struct("<8sQQI")
"""Magic, length of the HDF5 part, length of the seal's body, CRC-32 of the body."""
EXTENT_DTYPE = np.dtype(
    [("offset", "<i8"), ("n_bytes", "<i8"), ("crc32", "<u4"), ("column", "<i2"), ("first_sample", "<i8"),
     ("n_samples", "<i8")]
)  # fmt: skip
"""A stretch of the file; ``column`` -1: tables, attributes and indexes, which the seal holds a second copy of."""
_LONGEST = 1 << 20  # bytes of an extent without samples


@dataclass(frozen=True)
class Seal:
    """The seal of a file: its length without the seal, the columns' names, the extents, the second copy."""

    end: int
    columns: tuple[str, ...]
    extents: NDArray[np.void]
    copy: bytes
    # of the parity; none in a file of an earlier version
    parity_at: int = 0  # its first byte in the file
    crcs: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))  # of each sector before ``end``
    parity_crcs: NDArray[np.uint32] = field(default_factory=lambda: np.zeros(0, np.uint32))  # of each of its own
    is_less: bool = False  # one of the tables of checksums is damaged


@dataclass(frozen=True)
class Checked:
    """Result of a comparison with the seal."""

    patches: tuple[tuple[int, bytes], ...] = ()  # offset and right bytes of what differs and is known
    # by column, samples that differ for good, as ``(first, one past the last)``
    lost: Mapping[str, tuple[tuple[int, int], ...]] = field(default_factory=dict)
    where: tuple[str, ...] = ()  # one line for each thing that differs
    seal_differs: bool = False  # the seal itself is damaged: nothing was compared


def write_seal(path: Path, columns: tuple[str, ...]) -> NDArray[np.void]:
    """Append the seal to a closed HDF5 file whose one-dimensional, chunked datasets ``columns`` hold the samples.

    Raises `OSError` when the disk refuses. Returns `EXTENT_DTYPE` rows: the whole file, with the CRC-32 of what was
    just read of it.
    """
    chunks: list[tuple[int, int, int, int, int, int]] = []
    with h5py.File(path, "r") as file:
        for i, name in enumerate(columns):
            length, per_chunk, stored = file[name].shape[0], file[name].chunks[0], list[Any]()
            file[name].id.chunk_iter(stored.append)
            for chunk in stored:
                first = int(chunk.chunk_offset[0])
                n_samples = min(per_chunk, length - first)
                chunks.append((int(chunk.byte_offset), int(chunk.size), 0, i, first, n_samples))
    # extents of the chunks, and of what lies between them, to the end of the file
    rows, at = [], 0
    for offset, row in [*((row[0], row) for row in sorted(chunks)), (path.stat().st_size, None)]:
        rows += [(a, min(_LONGEST, offset - a), 0, -1, 0, 0) for a in range(at, offset, _LONGEST)]
        if row is not None:
            rows.append(row)
            at = offset + row[1]
    extents = np.array(rows, EXTENT_DTYPE)
    tables = []
    with path.open("r+b") as raw:
        for row in extents:
            data = _read(raw, int(row["offset"]), int(row["n_bytes"]))
            row["crc32"] = zlib.crc32(data)
            if row["column"] < 0:
                tables.append(data)
        end = raw.seek(0, io.SEEK_END)
        parity, crcs = parity_of(lambda offset, n_bytes: _read(raw, offset, n_bytes), end)
        packed, copy = io.BytesIO(), np.frombuffer(b"".join(tables), "u1")
        np.savez_compressed(
            packed, columns=np.array(columns), extents=extents, copy=copy, crcs=crcs,
            parity_crcs=sector_crcs(parity.tobytes()),
        )  # fmt: skip
        body = packed.getvalue()
        body += FOOTER.pack(MAGIC, end, len(body), zlib.crc32(body))
        raw.seek(end)
        raw.write(body + parity.tobytes() + body + body)
    return extents


def _read(raw: Any, offset: int, n_bytes: int) -> bytes:
    """Bytes of the file; none where the disk refuses."""
    with contextlib.suppress(OSError):
        raw.seek(offset)
        return bytes(raw.read(n_bytes))
    return b""


def read_seal(path: Path) -> Seal | bool:
    """The seal of a file; False where it has none, True where it has one that is damaged."""
    size = path.stat().st_size
    with path.open("rb") as raw:
        last = _read(raw, max(0, size - FOOTER.size), FOOTER.size)
    ends_in_one = last[: len(MAGIC)] == MAGIC
    if ends_in_one and (seal := _seal_at(path, size, last)) is not None and not seal.is_less:
        return seal
    found = seal if ends_in_one else None
    data = mapped(path)
    at = data.find(MAGIC)
    while at >= 0 and found is None:
        found = _seal_at(path, size, data[at : at + FOOTER.size])
        at = data.find(MAGIC, at + 1)
    return ends_in_one if found is None else found


def _seal_at(path: Path, size: int, footer: bytes) -> Seal | None:
    """The seal that a footer describes, by one of its bodies that fits, or what they have that is not zero."""
    if len(footer) < FOOTER.size:
        return None
    _, end, length, crc = FOOTER.unpack(footer)
    whole = length + FOOTER.size
    if not end <= size - whole:
        return None
    n_parity = SPARE * stripe_sectors(end) * SECTOR
    # one table in a file of an early version, two, or three; of another size it was cut off, or written to since
    n_tables = {whole: 1, 2 * whole + n_parity: 2, 3 * whole + n_parity: 3}.get(size - end, 0)
    if not n_tables:
        return None
    with path.open("rb") as raw:
        bodies = [_read(raw, end if k == 0 else size - k * whole, length) for k in range(n_tables)]
    together = np.bitwise_or.reduce([np.frombuffer(body.ljust(length, b"\0"), "u1") for body in bodies])
    body = next((body for body in (*bodies, together.tobytes()) if zlib.crc32(body) == crc), None)
    if body is None:
        return None
    with np.load(io.BytesIO(body), allow_pickle=False) as held:
        columns, extents, copy = (held[name] for name in ("columns", "extents", "copy"))
        further: dict[str, Any] = {}
        if "crcs" in held:
            further = {"crcs": held["crcs"], "parity_crcs": held["parity_crcs"], "parity_at": end + whole}
    is_less = len(set(bodies)) > 1
    return Seal(end, tuple(map(str, columns)), extents.astype(EXTENT_DTYPE), copy.tobytes(), **further, is_less=is_less)


def once_per_state(examined: Callable[[Path], Found]) -> Callable[[Path], Found]:
    """The function, called once for a file that has not changed since."""

    @functools.lru_cache(maxsize=64)
    def cached(path: Path, identity: tuple[int, int, int]) -> Found:
        del identity
        return examined(path)

    @functools.wraps(examined)
    def of_state(path: Path) -> Found:
        state = path.stat()
        return cached(path, (state.st_ino, state.st_size, state.st_mtime_ns))

    return of_state


@once_per_state
def check(path: Path) -> Checked | None:
    """Compare every byte of a file with its seal; None where it has none. A file that has not changed is read once.

    Only bytes are read, so this ends whatever they are; a gigabyte takes about half a second of processor time.
    """
    return _compare(path, samples=True)


def check_tables(path: Path) -> Checked | None:
    """Compare all of a file but its samples with its seal; None where it has none. Takes milliseconds."""
    return _compare(path, samples=False)


def _compare(path: Path, *, samples: bool) -> Checked | None:
    """Compare the file with its seal; ``samples``: these too."""
    seal = read_seal(path)
    if seal is True:
        return Checked(where=("its table of checksums differs from what was written",), seal_differs=True)
    if seal is False:
        return None
    patches: list[tuple[int, bytes]] = []
    lost: dict[str, tuple[tuple[int, int], ...]] = {}
    where: list[str] = []
    fixed: dict[int, bytes] | None = None  # sectors that the parity gives, once they are asked for
    if seal.is_less:
        where.append("a table of its checksums differs from what was written; another is whole")
    at = 0  # in the second copy, which holds extents without samples one after the other
    with path.open("rb", buffering=_LONGEST) as raw:
        for row in seal.extents if samples else seal.extents[seal.extents["column"] < 0]:
            n_bytes, is_table, copy = int(row["n_bytes"]), row["column"] < 0, b""
            data = _read(raw, int(row["offset"]), n_bytes)
            if is_table:
                at, copy = at + n_bytes, seal.copy[at : at + n_bytes]
            if len(data) == n_bytes and zlib.crc32(data) == row["crc32"]:
                continue
            place = f"bytes {row['offset']} to {row['offset'] + row['n_bytes'] - 1}"
            right = copy
            if not right:
                fixed = _by_parity(path, seal) if fixed is None else fixed
                right = _with(data, row, fixed)
            if is_table:
                where.append(
                    f"{place} (tables, attributes, indexes) differ from what was written; a second copy has them"
                )
            else:
                name, first = seal.columns[row["column"]], int(row["first_sample"])
                last = first + int(row["n_samples"])
                how = "differ, and are computed from the parity" if right else "differ from what was written"
                where.append(f"{name}: samples {first} to {last - 1} ({place}): {how}")
                if not right:
                    lost[name] = (*lost.get(name, ()), (first, last))
            if right:
                patches.append((int(row["offset"]), right))
    return Checked(tuple(patches), lost, tuple(where))


def _by_parity(path: Path, seal: Seal) -> dict[int, bytes]:
    """Sectors of a file that differ and that its parity gives, by number."""
    data, n = mapped(path), len(seal.parity_crcs)
    sectors = {k: data[seal.parity_at + k * SECTOR : seal.parity_at + (k + 1) * SECTOR] for k in range(n)}
    sound = {k: np.frombuffer(x, np.uint8) for k, x in sectors.items() if zlib.crc32(x) == seal.parity_crcs[k]}
    return restored(lambda offset, n_bytes: data[offset : offset + n_bytes], seal.end, seal.crcs, sound) if n else {}


def _with(data: bytes, extent: np.void, sectors: dict[int, bytes]) -> bytes:
    """Bytes of an extent with sectors put in; nothing where they are still not those that were written."""
    first, right = int(extent["offset"]), bytearray(data)
    for k, sector in sectors.items():
        a, b = max(k * SECTOR, first), min(k * SECTOR + len(sector), first + len(data))
        if a < b:
            right[a - first : b - first] = sector[a - k * SECTOR : b - k * SECTOR]
    return bytes(right) if len(right) == extent["n_bytes"] and zlib.crc32(right) == extent["crc32"] else b""


def text_crc(attributes: Mapping[str, Any]) -> int:
    """CRC-32 of attributes as sorted JSON: HDF5 itself does not checksum variable-length text."""
    plain = {k: v.item() if isinstance(v, np.generic) else v for k, v in attributes.items() if k != "attributes_crc32"}
    return zlib.crc32(json.dumps(plain, sort_keys=True).encode())
