"""Claims of an HDF5 file on its own size and content, bounded before any of it is read.

Nothing is followed out of the file, and no claim beyond what the file can hold takes memory.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py

from daq.setup.errors import InputError

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
    found = _HDF5.search(str(error))
    if found is None:
        return str(error)
    said = found[1].lower()
    return next((words for key, words in _PLAIN.items() if key in said), "its tables or indexes are damaged")


def objects_of(group: Any, path: Path) -> list[str]:
    """Names in a group of a recording (raises InputError where they are too many to be one's)."""
    if len(group) > MOST_OBJECTS:
        raise InputError(f"{path}: damaged: {group.name} holds {len(group)} objects; wanted {MOST_OBJECTS} at most")
    return list(group)


def dataset_of(group: Any, name: str, path: Path, dimensions: int = 1) -> Any:
    """A dataset of a recording, which holds numbers or short texts, in this file, and no more than the file can hold.

    Raises
    ------
    InputError
        When it does not.
    KeyError
        When there is none of that name.
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
    """Refuse a dataset that says it holds more than is stored; ``streamed``: it is read in pieces.

    Raises `InputError`, naming what it claims.
    """
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
