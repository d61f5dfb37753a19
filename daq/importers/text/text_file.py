"""Text files in any usual encoding, read once from beginning to end as UTF-8 with newlines."""

from __future__ import annotations

import codecs
import gzip
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from daq.files.disk import Closing

LONGEST_LINE = 1 << 16
_BLOCK_BYTES = 1 << 22


class LongLineError(ValueError):
    """A line that no block of a table holds."""


def encoding_of(head: bytes) -> str:
    """Encoding of a text by its beginning: UTF-16 or UTF-8 (with or without its mark), else Windows-1252."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:  # incremental: the end of what was read may cut a character
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


class TextFile(Closing):
    """A text as UTF-8 without byte-order mark, its lines ending in a newline; ``.gz`` is unpacked on the way."""

    def __init__(self, path: Path) -> None:
        self._file: Any = (gzip.open if path.suffix.lower() == ".gz" else open)(path, "rb")
        head = self._file.read(LONGEST_LINE)
        encoding = encoding_of(head)
        self._file.seek(0)
        if encoding != "utf-8-sig" or (b"\r" in head and b"\n" not in head):
            self._file = _Recoded(self._file, encoding)
        elif head.startswith(codecs.BOM_UTF8):
            self._file.seek(len(codecs.BOM_UTF8))

    def readline(self) -> bytes:
        """The rest of the line; raises LongLineError."""
        line: bytes = self._file.readline(LONGEST_LINE)
        if len(line) >= LONGEST_LINE:
            raise LongLineError
        return line

    def blocks(self) -> Iterator[memoryview]:
        """The rest of the file, in blocks of whole lines that end in a newline; each lasts until the next is asked for.

        Raises LongLineError for a line longer than `LONGEST_LINE` where one block ends; OSError, EOFError or zlib.error
        where the file breaks off.
        """
        memory = bytearray(_BLOCK_BYTES + 1)  # one more: for a last newline that is missing
        held, left = memoryview(memory), 0
        while n := self._file.readinto(held[left:-1]):
            end = left + n
            whole = memory.rfind(b"\n", 0, end) + 1
            if whole:
                yield held[:whole].toreadonly()
            left = end - whole
            if left >= LONGEST_LINE:
                raise LongLineError
            # the beginning of a line moves to the front, where the next read continues it
            held[:left] = held[whole:end]
        if left:
            held[left] = ord("\n")
            yield held[: left + 1].toreadonly()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class _Recoded(io.RawIOBase):
    """A text in another encoding, or with other line ends, as UTF-8 with newlines."""

    def __init__(self, raw: Any, encoding: str) -> None:
        super().__init__()
        self._text = io.TextIOWrapper(raw, encoding=encoding, errors="replace")

    def readinto(self, buffer: Any) -> int:
        data = self._text.read(len(buffer) // 4).encode()  # as many whole characters as surely fit
        buffer[: len(data)] = data
        return len(data)

    def readline(self, size: int | None = -1) -> bytes:
        return self._text.readline(-1 if size is None else size).encode()

    def close(self) -> None:
        self._text.close()
        super().close()
