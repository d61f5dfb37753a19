"""Export of recordings: tables, arrays, HDF5 with gzip, and the formats of other fields.

The files read back to the same numbers (`bench import` of the CSV gives the same codes when divided by their scale),
appear under their names only when they are whole, and are written piece by piece for any length.

Parquet holds volts in row groups; NetCDF the codes with the scale that its readers apply, along an unlimited dimension.
MATLAB (7.3) is HDF5 with MATLAB's header and class names: ``time_s`` and one column in volts a channel are vectors
(n, 1), ``steps`` is a structure of vectors. TDMS of LabVIEW and DIAdem holds codes with their linear scale, a segment
for each piece of time; waveform properties say the rate, and where samples were lost or times are uneven, a channel
``time_s`` says every time. The universal file format holds data set 58 in its binary form, a set for each channel and
each unbroken piece of time; the header's numbers have six digits, so the exact rate, time and count stand in its text
lines, where `bench import` finds them.
"""

from __future__ import annotations

import datetime
import gzip
import json
import math
import zipfile
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.export.resample import Resampled
from daq.files.column_file import CHUNK_SAMPLES
from daq.files.disk import disk_file, whole
from daq.recording.reader import Recording
from daq.recording.writer import columns_of
from daq.setup.errors import InputError, package
from kernels.arrays import Floats, Integers

STORED = (
    "started", "ended", "why", "note", "backend", "simulated", "software_version", "software_commit",
    "scenario_sha256", "imported_from", "setup_json", "profile_text", "extra_json",
)  # fmt: skip


def columns(recording: Recording | Resampled) -> dict[str, Callable[[int, int], Floats]]:
    """``time_s`` and one column in volts a channel, by name: what gives samples ``start`` to ``stop``."""
    volts = {f"{name}_v": partial(recording.read_v, name) for name in recording.channels}
    return {"time_s": lambda a, b: np.asarray(recording.timestamps_ns(a, b) * 1e-9, np.float64), **volts}


def facts(recording: Recording | Resampled) -> dict[str, str | float | int]:
    """Rate, provenance, profile, and lost samples as JSON pairs ``[first sample after, samples lost]``."""
    out: dict[str, str | float | int] = {
        "source": "shakerbench recording",
        "rate_hz": float(recording.rate_hz),
        "gaps_json": json.dumps(recording.gaps.tolist()),
    }
    stored = {name: recording.stored[name] for name in STORED if name in recording.stored}
    return out | {name: int(value) if isinstance(value, bool) else value for name, value in stored.items()}


def step_columns(recording: Recording | Resampled) -> dict[str, NDArray[Any]]:
    """Columns of the step table, by name."""
    return {name: np.ascontiguousarray(recording.steps[name]) for name in recording.steps.dtype.names or ()}


def pieces(n: int, rows: int = CHUNK_SAMPLES) -> list[tuple[int, int]]:
    """Ranges of samples that are read at once."""
    return [(a, min(a + rows, n)) for a in range(0, n, rows)]


def export_parquet(recording: Recording | Resampled, part: Path) -> None:
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


def export_netcdf(recording: Recording | Resampled, part: Path) -> None:
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


CLASSES = {"f8": "double", "i8": "int64", "i1": "int8"}


def export_matlab(recording: Recording | Resampled, part: Path) -> None:
    """Write the file; MATLAB opens it with ``load``."""
    n = recording.n_samples
    with disk_file(part) as disk, h5py.File(disk, "w", userblock_size=512, libver=("earliest", "v110")) as file:
        read = columns(recording)
        chunk = (1, max(1, min(CHUNK_SAMPLES, n)))
        for name in read:  # MATLAB counts the axes of a matrix in the opposite order
            item = file.create_dataset(name, (1, n), "<f8", chunks=chunk, compression="gzip", compression_opts=4)
            item.attrs["MATLAB_class"] = np.bytes_("double")
        for a, b in pieces(n):
            for name, column in read.items():
                file[name][0, a:b] = column(a, b)
            disk.check()
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


GROUP = "recording"


def export_tdms(recording: Recording, part: Path) -> None:
    """Write the file, segment by segment."""
    with package("npTDMS", "TDMS needs"):
        from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
    timed = bool(len(recording.gaps)) or not recording.stored.get("uniform", True)
    stated: dict[str, Any] = facts(recording)
    stated = {k: v.replace("\x00", "") if isinstance(v, str) else v for k, v in stated.items()}
    with TdmsWriter(str(part)) as writer:
        writer.write_segment([RootObject({"name": recording.path.name, **stated}), GroupObject(GROUP)])
        for a, b in pieces(recording.n_samples):
            channels = []
            if timed:
                properties = {"unit_string": "s"} if a == 0 else {}
                channels.append(ChannelObject(GROUP, "time_s", recording.timestamps_ns(a, b) * 1e-9, properties))
            for name in recording.channels:
                properties = _properties(recording, name) if a == 0 else {}
                channels.append(ChannelObject(GROUP, name, recording.codes(name, a, b), properties))
            writer.write_segment(channels)
        gaps = np.asarray(recording.gaps, np.int64)
        first, lost = (np.ascontiguousarray(gaps[:, i]) for i in (0, 1))
        tables = {"steps": step_columns(recording), "gaps": {"first_sample_after": first, "samples_lost": lost}}
        writer.write_segment(
            [ChannelObject(group, name, column) for group, table in tables.items() for name, column in table.items()]
        )


def _properties(recording: Recording, name: str) -> dict[str, Any]:
    """Waveform and scale of a channel, as DAQmx writes them."""
    from nptdms.types import Uint32

    factor, offset = recording.scale(name)
    started = str(recording.stored.get("started") or "")
    out: dict[str, Any] = {
        "unit_string": "V",
        "wf_increment": 1.0 / recording.rate_hz,
        "wf_start_offset": 0.0,
        "wf_samples": 1,
        "NI_Number_Of_Scales": Uint32(1),
        "NI_Scaling_Status": "unscaled",
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": float(factor),
        "NI_Scale[0]_Linear_Y_Intercept": float(offset),
        "NI_Scale[0]_Linear_Input_Source": Uint32(0xFFFFFFFF),
    }
    if started:
        when = datetime.datetime.fromisoformat(started).astimezone(datetime.UTC).replace(tzinfo=None)
        out["wf_start_time"] = np.datetime64(when, "us")
    return out


LINE = 80
TIME_RESPONSE, DOUBLE, TIME, GENERAL = 1, 4, 17, 1  # codes of the format


def export_uff58(recording: Recording, part: Path) -> None:
    """Write the file, piece by piece; a piece ends where samples were lost."""
    cuts = sorted(
        {0, recording.n_samples, *map(int, recording.gaps[:, 0]), *range(0, recording.n_samples, CHUNK_SAMPLES)}
    )
    lost = {int(first): int(n) for first, n in recording.gaps}
    with part.open("wb") as file:
        for a, b in pairwise(cuts):
            stamps = recording.timestamps_ns(a, b)
            for number, name in enumerate(recording.channels, 1):
                _write_set(file, recording, number, name, a, stamps, lost.get(a, 0))


def _write_set(
    file: BinaryIO, recording: Recording, number: int, name: str, first: int, stamps: Integers, lost: int
) -> None:
    """One channel from sample ``first`` on; times that are not even stand next to the values."""
    volts, n = recording.read_v(name, first, first + len(stamps)), len(stamps)
    grid = (np.arange(n) * (1e9 / recording.rate_hz)) + stamps[0]
    # times are stored to a nanosecond
    even = bool(np.max(np.abs(stamps - grid)) <= 1.5)
    values = volts if even else np.column_stack([stamps * 1e-9, volts]).ravel()
    started = str(recording.stored.get("started") or "unknown")
    kind = "simulated rig" if recording.stored.get("simulated") else "rig"
    texts = (
        name,
        f"shakerbench recording of a {kind}: {recording.path.name}",
        started,
        f"rate_hz={recording.rate_hz!r} first_sample={first} time_ns={int(stamps[0])}",
        f"lost_before={lost}",
    )
    begin, step = (stamps[0] * 1e-9, 1.0 / recording.rate_hz) if even else (0.0, 0.0)
    lines = [
        f"{-1:6d}",
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{8 * len(values):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *("".join(c if " " <= c <= "~" else "?" for c in text)[:LINE].ljust(LINE) for text in texts),
        f"{TIME_RESPONSE:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10}{number:10d}{0:4d} {'NONE':<10}{0:10d}{0:4d}",
        f"{DOUBLE:10d}{n:10d}{int(even):10d}{begin:13.5e}{step:13.5e}{0.0:13.5e}",
        _axis(TIME, "Time", "s"),
        _axis(GENERAL, "Voltage", "V"),
        _axis(0, "NONE", "NONE"),
        _axis(0, "NONE", "NONE"),
    ]
    file.write(("\n".join(lines) + "\n").encode("ascii"))
    file.write(np.ascontiguousarray(values, "<f8").tobytes())
    file.write(f"{-1:6d}\n".encode("ascii"))


def _axis(kind: int, name: str, unit: str) -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {name:<20} {unit:<20}"


Kind = Literal["csv", "npz", "h5", "parquet", "nc", "mat", "uff", "tdms"]
AS_RECORDED = ("h5", "uff", "tdms")  # kinds that hold the samples as they were taken, never at another rate


def export(recording: Recording | Resampled, out: Path, kind: Kind, *, overwrite: bool = False) -> None:
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
        columns_of(recording, out, recording.stored, overwrite=overwrite, compression="gzip").rename()  # type: ignore[arg-type]
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
