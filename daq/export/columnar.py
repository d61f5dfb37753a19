"""Parquet and NetCDF: columns with units, in row groups or along an unlimited dimension, for any length.

Parquet holds volts; NetCDF the codes with the scale that its readers apply. Lost samples are steps in time.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from daq.export.facts import Progress, facts, missing, pieces, step_columns
from daq.export.resample import Resampled
from daq.files.column_file import CHUNK_SAMPLES
from daq.files.disk import disk_file
from daq.recording.reader import Recording


def export_parquet(recording: Recording | Resampled, part: Path, tell: Progress) -> None:
    """Columns ``time_s`` and volts a channel; the step table and the facts are metadata of the file."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise missing("pyarrow", "Parquet") from error
    names = [f"{name}_v" for name in recording.channels]
    steps = {name: column.tolist() for name, column in step_columns(recording).items()}
    metadata = {key: str(value) for key, value in facts(recording).items()} | {"steps_json": json.dumps(steps)}
    units = ["s", *("V" for _ in names)]
    fields = [
        pa.field(name, pa.float64(), nullable=False, metadata={"units": unit})
        for name, unit in zip(["time_s", *names], units, strict=True)
    ]
    schema = pa.schema(fields, metadata=metadata)
    with pq.ParquetWriter(part, schema, compression="zstd") as writer:
        for a, b in pieces(recording.n_samples):
            columns = [recording.timestamps_ns(a, b) * 1e-9, *(recording.read_v(n, a, b) for n in recording.channels)]
            writer.write_table(pa.table([pa.array(c) for c in columns], schema=schema), row_group_size=b - a)
            tell(b)


def export_netcdf(recording: Recording | Resampled, part: Path, tell: Progress) -> None:
    """Variables along ``time`` (seconds) with units; the step table along ``step``; the facts as attributes."""
    try:
        import h5netcdf
    except ImportError as error:
        raise missing("h5netcdf", "NetCDF") from error
    with disk_file(part) as disk, h5netcdf.File(disk, "w") as file:
        file.dimensions = {"time": None, "step": len(recording.steps)}
        file.attrs.update({"Conventions": "CF-1.8", **facts(recording)})
        size = (max(1, min(CHUNK_SAMPLES, recording.n_samples)),)
        packed: dict[str, Any] = {"chunks": size, "compression": "gzip", "compression_opts": 4, "shuffle": True}
        time = file.create_variable("time", ("time",), "<f8", **packed)
        time.attrs.update({"units": "s", "long_name": "time since the first sample", "axis": "T"})
        channels = {}
        for name in recording.channels:
            whole_numbers = recording.codes(name, 0, 1).dtype.kind in "iu"
            kind = recording.codes(name, 0, 1).dtype if whole_numbers else np.dtype("<f8")
            channels[name] = file.create_variable(name, ("time",), kind, **packed), whole_numbers
            channels[name][0].attrs.update({"units": "V", "long_name": f"{name} voltage"})
            if whole_numbers:
                factor, offset = recording.scale(name)
                channels[name][0].attrs.update({"scale_factor": np.float64(factor), "add_offset": np.float64(offset)})
        for name, column in step_columns(recording).items():
            variable = file.create_variable(f"step_{name}", ("step",), column.dtype, data=column)
            variable.attrs["units"] = "Hz" if name.endswith("_hz") else "1"
        for a, b in pieces(recording.n_samples):
            file.resize_dimension("time", b)
            time[a:b] = recording.timestamps_ns(a, b) * 1e-9
            for name, (variable, whole_numbers) in channels.items():
                variable[a:b] = recording.codes(name, a, b) if whole_numbers else recording.read_v(name, a, b)
            disk.check()
            tell(b)
