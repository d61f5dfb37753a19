"""Threads of an import besides its main work: one reads ahead, one makes the hash of the file.

Both let go of the interpreter while they work (compiled code, OpenSSL), so that a second core has something to do.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import TypeVar

from daq.files.disk import Closing

Item = TypeVar("Item")
_PIECE_BYTES = 1 << 20


def ahead(items: Iterator[Item]) -> Iterator[Item]:
    """The items in order, each made in a thread while the one before it is used; so is an error, raised in its turn."""
    with ThreadPoolExecutor(1, "reading ahead") as worker:
        coming = worker.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = worker.submit(next, items, None)
            yield item


class Digest(Closing):
    """SHA-256 of a file, made in a thread unless it is ``known``; `close` gives it up."""

    def __init__(self, path: Path, known: str = "") -> None:
        self._path, self._stop = path, Event()
        self._worker = ThreadPoolExecutor(1, "hash of the file")
        self._made = self._worker.submit(lambda: known or self._digest())

    def _digest(self) -> str:
        digest = hashlib.sha256()
        with self._path.open("rb", buffering=0) as file:
            while not self._stop.is_set() and (piece := file.read(_PIECE_BYTES)):
                digest.update(piece)
        return digest.hexdigest()

    def result(self) -> str:
        """In hexadecimal; raises OSError where the file cannot be read."""
        return self._made.result()

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._worker.shutdown()
