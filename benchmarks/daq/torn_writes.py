"""What a loss of power leaves of a file: all that was synced, and of the later writes any part, in any order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

SECTOR = 512


@dataclass(frozen=True)
class Write:
    """Bytes that were written at a place; None cuts the file there."""

    at: int
    data: bytes | None


def apply(file: bytearray, write: Write) -> None:
    """Do a write, or cut the file to a length."""
    if write.data is None:
        del file[write.at :]
    data = write.data or b""
    end = write.at + len(data)
    if len(file) < end:
        file.extend(bytes(end - len(file)))
    file[write.at : end] = data


def lose_power(file: bytearray, waiting: Sequence[Write], rng: np.random.Generator) -> None:
    """Do a part of the writes that wait: a prefix, the last of it torn; any of them, whole; or any of their sectors.

    The file is as long as any of them makes it.
    """
    way = int(rng.integers(3))
    last = int(rng.integers(len(waiting) + 1))
    part = float(rng.random())
    for i, write in enumerate(waiting[: last + 1] if way == 0 else waiting):
        if (way == 0 and i < last) or (way == 1 and rng.random() < part) or write.data is None:
            apply(file, write)
        elif way != 1:
            for a in range(0, len(write.data), SECTOR):
                if rng.random() < part:
                    apply(file, Write(write.at + a, write.data[a : a + SECTOR]))


def parts_of(file: bytes, waiting: Sequence[Write]) -> Iterator[bytes]:
    """The file with each prefix of the writes that wait, torn at each sector; with one only; without one or two."""
    done = bytearray(file)
    yield file
    for write in waiting:
        for end in range(SECTOR, len(write.data or b""), SECTOR):
            torn = done.copy()
            apply(torn, Write(write.at, (write.data or b"")[:end]))
            yield bytes(torn)
        apply(done, write)
        yield bytes(done)
    numbers = range(len(waiting))
    some = [{k} for k in numbers]
    some += [{*numbers} - {*left} for n in (1, 2) for left in combinations(numbers, n)]
    for which in some:
        image = bytearray(file)
        for k in sorted(which):
            apply(image, waiting[k])
        yield bytes(image)
