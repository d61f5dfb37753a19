"""The recordings in folders, in order; other HDF5 files there are passed over and counted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py

from daq.setup.errors import InputError

SUFFIXES = (".h5", ".hdf5")


def find_recordings(places: Sequence[Path]) -> tuple[list[Path], int]:
    """Recordings named, and those in the folders named and below; and how many other HDF5 files were there.

    Raises
    ------
    InputError
        For a place that does not exist, or where there is no recording at all.
    """
    found: dict[Path, Path] = {}
    others = 0
    for place in places:
        if not place.exists():
            raise InputError(f"{place}: wanted a recording or a folder of them, there is no such file")
        if not place.is_dir():
            found.setdefault(place.resolve(), place)
            continue
        for path in sorted(p for p in place.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file()):
            if _may_be_recording(path):
                found.setdefault(path.resolve(), path)
            else:
                others += 1
    if not found:
        raise InputError(f"{', '.join(map(str, places))}: wanted recordings (HDF5), found none")
    return list(found.values()), others


def _may_be_recording(path: Path) -> bool:
    """Whether a file is a recording, or too damaged to tell: then its row gives the reason."""
    try:
        with h5py.File(path, "r") as file:
            return "setup_json" in file.attrs
    except OSError:
        return True
