"""Files on a disk that may refuse: HDF5, its claims on its own size, and files that a kill cannot tear.

HDF5 never meets a refusal, because it crashes when it closes a file that could not be written. What the disk does not
take stays in memory, and the writer asks for the refusal. Claims of an HDF5 file are bounded before any of it is read:
nothing is followed out of the file, and no claim beyond what the file can hold takes memory.

A file that is written whole gets another name in the same folder, reaches the disk, and is renamed in one step: a
process that is killed half-way leaves the old file as it was, and at most a ``.part``. A journal has one JSON object a
line, on the disk before the next one is begun; a last line that was cut off is left out.
"""

from __future__ import annotations

import errno
import io
import json
import mmap
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py

from daq.setup.errors import InputError


class Closing:
    """A context manager whose end is a call of ``close``, whatever happened inside."""

    def close(self) -> None:
        """Let go of the files or threads of the class."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def refusal(error: OSError, path: Path) -> OSError:
    """The error where the disk refused to take more of the file, or of files in the folder, ``path``."""
    why = error.strerror or str(error)
    hint = "free some space there, or choose another place"
    return OSError(error.errno, f"the disk refuses to take more ({why}); {hint}", str(path))


def mapped(path: Path) -> Any:
    """Bytes of a file, read as they are asked for; an empty one has none."""
    with path.open("rb") as raw:
        return mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) if raw.seek(0, io.SEEK_END) else b""


class PatchedFile(io.RawIOBase):
    """A file read as if some of its bytes were others: ``patches``, each an offset and the bytes there."""

    def __init__(self, path: Path, patches: Iterable[tuple[int, bytes]] = (), mode: str = "rb") -> None:
        super().__init__()
        self._file: Any = path.open(mode, buffering=0)
        self._patches = list(patches)
        self._at, self._end = 0, int(self._file.seek(0, io.SEEK_END))

    def readable(self) -> bool:
        """True."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """As of any file."""
        self._at = offset + (0, self._at, self._end)[whence]
        return self._at

    def readinto(self, buffer: Any) -> int:
        """As of any file; zeros beyond its end."""
        view, start = memoryview(buffer).cast("B"), self._at
        self._file.seek(start)
        n = self._file.readinto(view) or 0
        view[n:] = bytes(len(view) - n)
        stop = min(start + len(view), max(self._end, start))
        for offset, data in self._patches:
            a, b = max(offset, start), min(offset + len(data), stop)
            if a < b:
                view[a - start : b - start] = data[a - offset : b - offset]
        self._at = stop
        return stop - start

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


class DiskFile(PatchedFile):
    """A new file for `h5py.File(DiskFile(path), "w")`; ``error`` is the disk's first refusal.

    Nothing more reaches the disk afterwards; the writer asks with `check`.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, mode="w+b")
        self._path = path
        self.error: OSError | None = None

    def check(self) -> None:
        """Raise the first refusal of the disk, if there was one, naming the file (raises OSError)."""
        if self.error is not None:
            raise refusal(self.error, self._path) from self.error

    def write(self, data: Any) -> int:
        """Write all of ``data``, to memory once the disk has refused."""
        view = memoryview(data).cast("B")
        if self.error is None:
            try:
                self._file.seek(self._at)
                done = 0
                while done < len(view):
                    done += self._file.write(view[done:]) or 0
            except OSError as error:
                self.error = error
        if self.error is not None:
            self._patches.append((self._at, bytes(view)))
        self._at += len(view)
        self._end = max(self._end, self._at)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """As of any file."""
        self._end = self._at if size is None else size
        if self.error is None:
            try:
                self._file.truncate(self._end)
            except OSError as error:
                self.error = error
        return self._end

    def close(self) -> None:
        """Close the file; a refusal of the disk is noted, not raised."""
        if not self.closed:
            try:
                self._file.close()
            except OSError as error:
                self.error = self.error or error
        super().close()


@contextmanager
def disk_file(path: Path) -> Iterator[DiskFile]:
    """A `DiskFile` for a block; raises `OSError` when the disk refused at any time, also while it was closed."""
    disk = DiskFile(path)
    try:
        yield disk
    finally:
        disk.close()
    disk.check()


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Name of a file to write, which takes the place of ``path`` when the block ends well and is removed otherwise.

    The mode of a file that is replaced stays; a symbolic link stays one, and what it leads to is replaced. A device or
    a pipe is written to directly.

    Raises `OSError` when the disk refuses; ``path`` is then as it was.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = path.resolve() if path.is_symlink() else path
    part = target.with_name(f"{target.name}.part")
    try:
        yield part
        if target.exists():
            shutil.copymode(target, part)
        sync(part)
        part.replace(target)
        sync_folder(target.parent)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_whole(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8 into ``path``, whole or not at all (raises OSError)."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def sync(path: Path) -> None:
    """Ask the operating system to put the file on the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Ask the operating system to put the names in a folder on the disk: a file's own sync does not promise its name.

    POSIX only: Windows syncs no folder, and its file systems log changes of names.
    """
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system that knows no sync of folders, as some of networks
            raise
    finally:
        os.close(descriptor)


Row = dict[str, Any]


class Journal:
    """Rows by key in a file that only grows; of rows with one key the last counts.

    ``path`` is its file, made by the first row; ``rows`` are those so far, by key. Raises `InputError` where the file
    holds something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, Row] = {}
        self._is_new = not path.exists()
        text = b"" if self._is_new else path.read_bytes()
        lines = text.split(b"\n")
        for number, line in enumerate(lines[:-1], start=1):
            if not line.strip():
                continue
            try:
                entry = json.loads(line)
                self.rows[str(entry["key"])] = dict(entry["row"])
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(
                    f"{path}, line {number}: wanted a result written by this program ({error}); name another file, or "
                    "remove the line"
                ) from error
        self._torn = bool(lines[-1])
        self._whole_bytes = len(text) - len(lines[-1])

    def add(self, key: str, row: Row) -> None:
        """Add a row; it is on the disk when this returns (raises OSError)."""
        line = json.dumps({"key": key, "row": row}, allow_nan=False)
        if self._torn:
            os.truncate(self.path, self._whole_bytes)
            self._torn = False
        with self.path.open("ab") as stream:
            stream.write(line.encode() + b"\n")
            stream.flush()
            os.fsync(stream.fileno())
        if self._is_new:
            sync_folder(self.path.parent)
            self._is_new = False
        self.rows[key] = row


_HDF5 = re.compile(r"(?:Unable to|Can't|Couldn't) .*?\((.*)\)", re.DOTALL)
_PLAIN = {
    "truncated": "the file is shorter than it says: it was cut off, or not copied to its end",
    "signature not found": "it does not begin as one",
    "fletcher32": "stored numbers differ from what was written",
    "filter": "stored numbers differ from what was written",
}
MOST_OBJECTS = 64  # at the root of a recording, and in one of its groups
LONGEST_CHUNK_BYTES = 64 << 20


def in_words(error: Exception) -> str:
    """What went wrong, in plain words where HDF5 says it in its own; those stay in the error's cause."""
    if system := re.search(r"error message = '([^']*)'", str(error)):  # why the system refused, if it was that
        return system[1]
    found = _HDF5.search(str(error))
    if found is None:
        return str(error)
    said = found[1].lower()
    return next((words for key, words in _PLAIN.items() if key in said), "its tables or indexes are damaged")


def dataset_of(group: Any, name: str, path: Path, dimensions: int = 1) -> Any:
    """A dataset of a recording, which holds numbers or short texts, in this file, and no more than the file can hold.

    Raises `InputError` when it does not, `KeyError` when there is none of that name.
    """
    where = f"{path}: {group.name.rstrip('/')}/{name}"
    if group.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
        raise InputError(f"{where}: damaged: is a link to another place; a recording holds all of itself")
    dataset = group[name]
    if not isinstance(dataset, h5py.Dataset) or dataset.ndim != dimensions:
        raise InputError(f"{where}: damaged: wanted a table of {dimensions} dimension(s)")
    if dataset.is_virtual or dataset.external:
        raise InputError(f"{where}: damaged: its numbers lie in another file; a recording holds all of itself")
    dtype = dataset.dtype
    if dtype.kind not in "iufVS" or dtype.hasobject or dtype.itemsize > 1024:
        raise InputError(f"{where}: damaged: wanted numbers or short texts, found {dtype}")
    return dataset


def refuse_claims(dataset: Any, path: Path, *, streamed: bool) -> None:
    """Refuse a dataset that claims more than is stored; ``streamed``: it is read in pieces (raises InputError)."""
    itemsize, chunks = dataset.dtype.itemsize, dataset.chunks
    where, n_bytes, size = f"{path}: {dataset.name}", dataset.size * itemsize, path.stat().st_size
    if chunks is not None:
        per_chunk = itemsize
        for length in chunks:
            per_chunk *= length
        if per_chunk > LONGEST_CHUNK_BYTES:
            raise InputError(f"{where}: damaged: has pieces of {per_chunk} bytes; wanted {LONGEST_CHUNK_BYTES} at most")
        held = dataset.id.get_num_chunks() * per_chunk
        if n_bytes > held:
            raise InputError(f"{where}: damaged: claims {n_bytes} bytes; {held} are stored")
    # a small table may be packed tighter than the file is long
    if n_bytes > max(size, 1 << 20) and not (streamed and chunks is not None):
        raise InputError(f"{where}: damaged: claims {n_bytes} bytes in a file of {size}")


def refuse_columns(file: Any, names: Sequence[str], path: Path) -> None:
    """Refuse channels that are not columns of numbers stored in this file, in pieces (raises InputError, KeyError)."""
    if len(names) > MOST_OBJECTS:
        raise InputError(f"{path}: damaged: names {len(names)} channels; a recording has {MOST_OBJECTS} at most")
    for name in names:
        refuse_claims(dataset_of(file, name, path), path, streamed=True)
