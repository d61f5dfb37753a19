"""Choice of the importer by the ending of a file's name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import h5py

from daq.importers.formats.arrays import Hdf5Source, Mat73Source, MatSource, NpzSource, WavSource
from daq.importers.formats.columns import Source
from daq.importers.formats.measuring_systems import MdfSource, TdmsSource, UffSource
from daq.importers.text.csv import CsvSource
from daq.setup.errors import InputError, require_file

_TEXT = (".csv", ".txt", ".tsv", ".dat", ".lvm")
_BINARY: dict[str, type[Source]] = {
    ".npz": NpzSource, ".wav": WavSource, ".mat": MatSource, ".h5": Hdf5Source, ".hdf5": Hdf5Source,
    ".hdf": Hdf5Source, ".nc": Hdf5Source, ".uff": UffSource, ".unv": UffSource, ".uf": UffSource, ".bunv": UffSource,
    ".tdms": TdmsSource, ".mf4": MdfSource, ".mdf": MdfSource,
}  # fmt: skip


def open_source(path: Path, select: Mapping[str, str] | None = None, select_column: str | None = None) -> Source:
    """Open a foreign file by its ending: .csv .txt .tsv .dat .lvm (also .gz), .h5 .mat, .npz, .wav, .uff, .tdms, .mf4.

    Raises `InputError` when the file is missing, of an unknown kind, or does not read.

    Parameters
    ----------
    path
        The file.
    select, select_column
        For a long table (text only): which rows, as ``{"": value}`` or ``{role: value}``, by the entry of which
        column.
    """
    require_file(path)
    ending = "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    if ending.removesuffix(".gz") in _TEXT:
        return CsvSource(path, select or {}, select_column)
    if select:
        raise InputError(f"{path}: --channel is for long tables in text files (CSV); here use --map.")
    if ending not in _BINARY:
        raise InputError(f"{path}: wanted a file that ends in {' '.join(_TEXT)} (or .gz of these) {' '.join(_BINARY)}.")
    is_matlab_73 = ending == ".mat" and h5py.is_hdf5(path)
    return Mat73Source(path) if is_matlab_73 else _BINARY[ending](path)
