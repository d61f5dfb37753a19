"""Parquet and NetCDF: columns with units, in row groups or along an unlimited dimension, for any length.

Parquet holds volts; NetCDF the codes with the scale that its readers apply. Lost samples are steps in time.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from daq.export.facts import Progress, columns, facts, pieces, step_columns
from daq.export.resample import Resampled
from daq.files.column_file import CHUNK_SAMPLES
from daq.files.disk import disk_file
from daq.recording.reader import Recording
from daq.setup.errors import package


def export_parquet(recording: Recording | Resampled, part: Path, tell: Progress) -> None:
    """Columns ``time_s`` and volts a channel; the step table and the facts are metadata of the file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    steps = {name: column.tolist() for name, column in step_columns(recording).items()}
    metadata = {key: str(value) for key, value in facts(recording).items()} | {"steps_json": json.dumps(steps)}
    read = columns(recording)
    fields = [
        pa.field(name, pa.float64(), nullable=False, metadata={"units": "s" if name == "time_s" else "V"})
        for name in read
    ]
    schema = pa.schema(fields, metadata=metadata)
    with pq.ParquetWriter(part, schema, compression="zstd") as writer:
        for a, b in pieces(recording.n_samples):
            own = [pa.array(column(a, b)) for column in read.values()]
            writer.write_table(pa.table(own, schema=schema), row_group_size=b - a)
            tell(b)


def export_netcdf(recording: Recording | Resampled, part: Path, tell: Progress) -> None:
    """Variables along ``time`` (seconds) with units; the step table along ``step``; the facts as attributes."""
    with package("h5netcdf", "NetCDF needs"):
        import h5netcdf
    with disk_file(part) as disk, h5netcdf.File(disk, "w") as file:
        file.dimensions = {"time": None, "step": len(recording.steps)}
        file.attrs.update({"Conventions": "CF-1.8", **facts(recording)})
        size = (max(1, min(CHUNK_SAMPLES, recording.n_samples)),)
        packed: dict[str, Any] = {"chunks": size, "compression": "gzip", "compression_opts": 4, "shuffle": True}
        time = file.create_variable("time", ("time",), "<f8", **packed)
        time.attrs.update({"units": "s", "long_name": "time since the first sample", "axis": "T"})
        channels = {}
        for name in recording.channels:
            kind, scale, read = recording.codes(name, 0, 1).dtype, {}, recording.codes
            if kind.kind in "iu":  # codes, with the scale that readers apply
                scale = dict(zip(("scale_factor", "add_offset"), map(np.float64, recording.scale(name)), strict=True))
            else:
                kind, read = np.dtype("<f8"), recording.read_v
            variable = file.create_variable(name, ("time",), kind, **packed)
            variable.attrs.update({"units": "V", "long_name": f"{name} voltage", **scale})
            channels[name] = variable, read
        for name, column in step_columns(recording).items():
            variable = file.create_variable(f"step_{name}", ("step",), column.dtype, data=column)
            variable.attrs["units"] = "Hz" if name.endswith("_hz") else "1"
        for a, b in pieces(recording.n_samples):
            file.resize_dimension("time", b)
            time[a:b] = recording.timestamps_ns(a, b) * 1e-9
            for name, (variable, read) in channels.items():
                variable[a:b] = read(name, a, b)
            disk.check()
            tell(b)
