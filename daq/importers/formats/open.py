"""Choice of the importer by the ending of a file's name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py

from daq.importers.formats.columns import Source
from daq.importers.formats.hdf5 import Hdf5Source
from daq.importers.formats.mat import Mat73Source, MatSource
from daq.importers.formats.mdf4 import MdfSource
from daq.importers.formats.npz import NpzSource
from daq.importers.formats.tdms import TdmsSource
from daq.importers.formats.uff58 import UffSource
from daq.importers.formats.wav import WavSource
from daq.importers.text.csv import CsvSource
from daq.setup.errors import InputError, require_file


def open_source(path: Path, select: Mapping[str, str] | None = None, select_column: str | None = None) -> Source:
    """Open a foreign file by its ending: .csv .txt .tsv .dat .lvm (also .gz), .h5 .mat, .npz, .wav, .uff, .tdms, .mf4.

    Parameters
    ----------
    path
        The file.
    select, select_column
        For a long table (text only): which rows, as ``{"": value}`` or ``{role: value}``, by the entry of which
        column.

    Raises
    ------
    InputError
        When the file is missing, of an unknown kind, or does not read.
    """
    require_file(path)
    ending = "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    if ending.removesuffix(".gz") in (".csv", ".txt", ".tsv", ".dat", ".lvm"):
        return CsvSource(path, select or {}, select_column)
    if select:
        raise InputError(f"{path}: --channel is for long tables in text files (CSV); here use --map.")
    matlab = Mat73Source if ending == ".mat" and h5py.is_hdf5(path) else MatSource
    kinds: dict[str, Any] = {".npz": NpzSource, ".wav": WavSource, ".mat": matlab}
    kinds |= dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc"), Hdf5Source)
    kinds |= dict.fromkeys((".uff", ".unv", ".uf", ".bunv"), UffSource) | {".tdms": TdmsSource}
    kinds |= dict.fromkeys((".mf4", ".mdf"), MdfSource)
    if ending not in kinds:
        raise InputError(
            f"{path}: wanted a file that ends in .csv .txt .tsv .dat .lvm (or .gz of these) {' '.join(kinds)}."
        )
    source: Source = kinds[ending](path)
    return source
