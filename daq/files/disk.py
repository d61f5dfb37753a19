"""A file for HDF5 to write to, on a disk that may refuse; and what closes itself at the end of a ``with`` block.

HDF5 never meets a refusal, because it crashes when it closes a file that could not be written. What the disk does not
take stays in memory, and the writer asks for the refusal.
"""

from __future__ import annotations

import io
import mmap
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self


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

    def seekable(self) -> bool:
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
        """Raise the first refusal of the disk, if there was one.

        Raises `OSError`, naming the file and what the disk answered.
        """
        if self.error is not None:
            raise refusal(self.error, self._path) from self.error

    def writable(self) -> bool:
        """True."""
        return True

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
    """A `DiskFile` for the length of a block.

    Raises `OSError` when the disk refused at any time, also while the file was closed.
    """
    disk = DiskFile(path)
    try:
        yield disk
    finally:
        disk.close()
    disk.check()
