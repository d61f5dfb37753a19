"""MATLAB files of version 7.3: HDF5 with MATLAB's header and class names, written piece by piece.

``time_s`` and one column in volts a channel are vectors (n, 1); ``steps`` is a structure of vectors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq.export.facts import Progress, columns, facts, pieces, step_columns
from daq.export.resample import Resampled
from daq.files.column_file import CHUNK_SAMPLES
from daq.files.disk import disk_file
from daq.recording.reader import Recording

CLASSES = {"f8": "double", "i8": "int64", "i1": "int8"}


def export_matlab(recording: Recording | Resampled, part: Path, tell: Progress) -> None:
    """Write the file; MATLAB opens it with ``load``."""
    n = recording.n_samples
    with (
        disk_file(part) as disk,
        h5py.File(disk, "w", userblock_size=512, libver=("earliest", "v110")) as file,
    ):
        read = columns(recording)
        chunk = (1, max(1, min(CHUNK_SAMPLES, n)))
        for name in read:  # MATLAB counts the axes of a matrix in the opposite order
            item = file.create_dataset(name, (1, n), "<f8", chunks=chunk, compression="gzip", compression_opts=4)
            item.attrs["MATLAB_class"] = np.bytes_("double")
        for a, b in pieces(n):
            for name, column in read.items():
                file[name][0, a:b] = column(a, b)
            disk.check()
            tell(b)
        for name, value in facts(recording).items():
            _put(file, name, value)
        group = file.create_group("steps")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in step_columns(recording).items():
            item = group.create_dataset(name, data=values.reshape(1, -1))
            item.attrs["MATLAB_class"] = np.bytes_(CLASSES[values.dtype.str[1:]])
    with part.open("r+b") as file:
        text = b"MATLAB 7.3 MAT-file, written by shakerbench, HDF5 schema 1.00 ."
        file.write(text.ljust(116) + bytes(8) + b"\x00\x02IM")


def _put(file: Any, name: str, value: str | float | int) -> None:
    """One number or one text."""
    if not isinstance(value, str):
        file.create_dataset(name, data=np.array([[value]], np.float64)).attrs["MATLAB_class"] = np.bytes_("double")
        return
    units = np.frombuffer(value.encode("utf-16-le"), "<u2").reshape(-1, 1)
    if not len(units):
        item = file.create_dataset(name, data=np.zeros(2, np.uint64))  # the sizes of an empty text
        item.attrs["MATLAB_empty"] = np.uint8(1)
    else:
        item = file.create_dataset(name, data=units)
    item.attrs["MATLAB_class"] = np.bytes_("char")
    item.attrs["MATLAB_int_decode"] = np.int32(2)
