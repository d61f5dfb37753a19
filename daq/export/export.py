"""Write a recording for other programs: tables, arrays, HDF5 with gzip, and the formats of other fields.

The files read back to the same numbers (`bench import` of the CSV gives the same codes when divided by their scale),
and appear under their names only when they are whole.
"""

from __future__ import annotations

import gzip
import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from daq.export.formats import (
    columns,
    export_matlab,
    export_netcdf,
    export_parquet,
    export_tdms,
    export_uff58,
    pieces,
)
from daq.export.resample import Resampled
from daq.files.whole_file import whole
from daq.recording.reader import Recording
from daq.recording.writer import copy_columns
from daq.setup.errors import InputError

Kind = Literal["csv", "npz", "h5", "parquet", "nc", "mat", "uff", "tdms"]
AS_RECORDED = ("h5", "uff", "tdms")  # kinds that hold the samples as they were taken, never at another rate


def export(
    recording: Recording | Resampled,
    out: Path,
    kind: Kind,
    *,
    overwrite: bool = False,
) -> None:
    """Write ``out``.

    Parameters
    ----------
    recording
        Open recording, or a view of it at another rate (CSV and NPZ).
    out
        File to create; an ending ``.gz`` of a CSV packs it.
    kind
        ``csv``: ``time_s`` and one column in volts a channel; ``parquet``, ``mat`` (MATLAB 7.3) the same. ``npz``: the
        same as arrays, with ``rate_hz``, ``steps`` and ``setup_json``. ``nc``: NetCDF with units and coordinates.
        ``uff``: universal file, data set 58, binary. ``tdms``: LabVIEW's. ``h5``: the recording itself, compressed with
        gzip, which every HDF5 reader knows.
    overwrite
        Replace ``out`` where it exists, once the new file is whole.

    Raises
    ------
    InputError
        When ``out`` exists and is not to be replaced, a package that the kind needs is not installed, or the kind
        cannot hold another rate.
    OSError
        When the disk refuses; nothing is left behind.
    """
    if out.exists() and not overwrite:
        raise InputError(f"{out}: exists already and is never overwritten unasked; choose another name.")
    if not out.parent.is_dir():
        raise InputError(f"{out}: the folder {out.parent} does not exist; create it first.")
    if isinstance(recording, Resampled) and kind in AS_RECORDED:
        raise InputError(
            f"{out}: {kind} holds the recording as it is; another rate is written as CSV, NPZ, Parquet, NetCDF or MAT."
        )
    if kind == "h5":
        copy_columns(recording, out, recording.stored, overwrite=overwrite, compression="gzip")  # type: ignore[arg-type]
        return
    with whole(out) as part:
        if kind == "csv":
            _export_csv(recording, part, packed=out.suffix == ".gz")
        else:
            WRITERS[kind](recording, part)


def _export_csv(recording: Recording | Resampled, part: Path, *, packed: bool) -> None:
    titles, formats, read = [], ["%.9f"], columns(recording)
    for title in read:
        if title[:1] in ("=", "+", "-", "@", "\t", "\r"):  # no spreadsheet may take a name for a formula
            title = f"'{title}"
        titles.append('"' + title.replace('"', '""') + '"' if any(c in title for c in ',"\r\n') else title)
    for name in recording.channels:  # a thousandth of a code, or all of a float
        is_float = recording.codes(name, 0, 1).dtype.kind == "f"
        formats.append("%.17g" if is_float else f"%.{max(0, math.ceil(3 - math.log10(recording.scale(name)[0])))}f")
    line = ",".join(formats) + "\n"
    with gzip.open(part, "wt", compresslevel=4) if packed else part.open("w", newline="\n") as file:
        file.write(",".join(titles) + "\n")
        for a, b in pieces(recording.n_samples, 16384):
            # one format for all rows: several times as fast as row by row
            rows = np.column_stack([column(a, b) for column in read.values()])
            file.write(line * (b - a) % tuple(rows.ravel().tolist()))


def _export_npz(recording: Recording | Resampled, part: Path) -> None:
    extras = {
        "rate_hz": np.float64(recording.rate_hz),
        "steps": recording.steps,
        "setup_json": np.str_(recording.stored["setup_json"]),
    }
    with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive:
        for name, read in columns(recording).items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                header = {"descr": "<f8", "fortran_order": False, "shape": (recording.n_samples,)}
                np.lib.format.write_array_header_1_0(file, header)
                for a, b in pieces(recording.n_samples):
                    file.write(np.ascontiguousarray(read(a, b), "<f8").data)
        for name, value in extras.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, np.asarray(value), allow_pickle=False)


WRITERS: dict[str, Callable[[Any, Path], None]] = {
    "npz": _export_npz,
    "parquet": export_parquet,
    "nc": export_netcdf,
    "mat": export_matlab,
    "uff": export_uff58,
    "tdms": export_tdms,
}
