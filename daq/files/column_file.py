"""The column file: what a recording is once it is closed. One HDF5 dataset a channel, compressed and checksummed.

Here are its format and the reading of its tables; `daq.files.column_writer` writes it. Layout in
docs/reference/recording-format.md.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.files.claims import dataset_of, objects_of, refuse_claims
from daq.files.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE
from daq.setup.errors import InputError

FORMAT = "shakerbench recording"
FORMAT_VERSION = 1
CHUNK_SAMPLES = 65536
TABLES = {"steps": STEP_DTYPE, "blocks": BLOCK_DTYPE, **SIDE_TABLES}


def read_table(file: Any, table: str, dtype: np.dtype[Any], path: Path) -> NDArray[np.void]:
    """The table of a column file as one structured array; a field that the file lacks is zero.

    Raises `InputError` when it is not a table, or claims more than the file holds.
    """
    if table not in file:
        return np.zeros(0, dtype)
    group = file[table] if isinstance(file.get(table, getlink=True), h5py.HardLink) else None
    if not isinstance(group, h5py.Group):
        raise InputError(f"{path}: /{table}: damaged: wanted a table of this file")
    held = set(objects_of(group, path))
    columns = {n: dataset_of(group, n, path) for n in dtype.names or () if n in held}
    lengths = {len(column) for column in columns.values()}
    if len(lengths) > 1:
        raise InputError(f"{path}: /{table}: damaged: its fields have {sorted(lengths)} rows; wanted as many in each")
    for column in columns.values():
        refuse_claims(column, path, streamed=False)
    rows = np.zeros(lengths.pop() if lengths else 0, dtype)
    for name, column in columns.items():
        rows[name] = column[()]
    return rows
