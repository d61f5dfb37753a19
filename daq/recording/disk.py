"""A file that HDF5 can write without ever meeting a full disk.

The rule kept here: HDF5 ends in a crash of the process when a write fails beneath it, at once or when the file is
closed. So the first failure is kept, later writes are dropped, and whoever writes asks with `DiskFile.check`.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any


class DiskFile(io.RawIOBase):
    """A new file, readable and writable, for `h5py.File(DiskFile(path), "w")`.

    Parameters
    ----------
    path
        File to create; an old one of that name is emptied.

    Raises
    ------
    OSError
        When it cannot be created.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._file = path.open("w+b", buffering=0)
        self._failure: OSError | None = None

    def check(self) -> None:
        """Raise the first failure of the disk, if there was one.

        Raises
        ------
        OSError
            Naming the file and what the disk said.
        """
        if self._failure is not None:
            said = self._failure.strerror or str(self._failure)
            raise OSError(
                self._failure.errno,
                f"the disk refuses to take more ({said}); free some space there, or choose another place",
                str(self._path),
            ) from self._failure

    def write(self, data: Any) -> int:
        """Write all of ``data``, or keep the failure."""
        left = memoryview(data).cast("B")
        size = len(left)
        while len(left) and self._failure is None:
            try:
                left = left[self._file.write(left) :]
            except OSError as failure:
                self._failure = failure
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file, or keep the failure."""
        if self._failure is None:
            try:
                return self._file.truncate(size)
            except OSError as failure:
                self._failure = failure
        return size or 0

    def readinto(self, buffer: Any) -> int:
        """Read into ``buffer``; zeros where a lost write left nothing."""
        view = memoryview(buffer).cast("B")
        done = 0
        while done < len(view):
            got = self._file.readinto(view[done:])
            if not got:
                break
            done += got
        view[done:] = bytes(len(view) - done)
        return len(view)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Move to a place in the file."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Place in the file."""
        return self._file.tell()

    def readable(self) -> bool:
        """True: HDF5 reads what it has written."""
        return True

    def writable(self) -> bool:
        """True."""
        return True

    def seekable(self) -> bool:
        """True."""
        return True

    def close(self) -> None:
        """Close the file; a failure of the disk is kept, not raised."""
        if not self.closed:
            try:
                self._file.close()
            except OSError as failure:
                self._failure = self._failure or failure
        super().close()
