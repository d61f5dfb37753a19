"""The column file: what a recording is once it is closed. One HDF5 dataset a channel, compressed and checksummed.

Layout in docs/reference/recording-format.md. It is written under another name, whole, checked, and only then renamed: a
reader never meets half of a file. What was written is read back and compared at once, while it is in the cache; at the
end every stored byte must still be what was compared.
"""

from __future__ import annotations

import sys
import time
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from daq.channels.registry import KINDS
from daq.files.disk import MOST_OBJECTS, DiskFile, dataset_of, refuse_claims, sync, sync_folder
from daq.files.seal import text_crc, write_seal
from daq.files.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE, crc32
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Integers

FORMAT = "shakerbench recording"
FORMAT_VERSION = 1
CHUNK_SAMPLES = 65536
TABLES = {"steps": STEP_DTYPE, "blocks": BLOCK_DTYPE, **SIDE_TABLES}


def read_table(file: Any, table: str, dtype: np.dtype[Any], path: Path) -> NDArray[np.void]:
    """The table of a column file; a field that it lacks is zero (raises InputError: none, or more than the file)."""
    if table not in file:
        return np.zeros(0, dtype)
    group = file[table] if isinstance(file.get(table, getlink=True), h5py.HardLink) else None
    if not isinstance(group, h5py.Group):
        raise InputError(f"{path}: /{table}: damaged: wanted a table of this file")
    if len(group) > MOST_OBJECTS:
        raise InputError(f"{path}: damaged: {group.name} holds {len(group)} objects; wanted {MOST_OBJECTS} at most")
    held = set(group)
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


PIECE_CHUNKS = 4  # written at a time, so that what each call of HDF5 costs counts little
DIMENSION = {
    "steps": "step", "blocks": "block", "drive_changes": "change", "clock_readings": "reading", "clock_map": "node",
    "notes": "note",
}  # fmt: skip
Compression = Literal["lz4", "gzip"]


class ColumnWriter:
    """Write a column file piece by piece; memory does not depend on its length.

    Raises `InputError` when ``path`` exists and may not be replaced.

    Parameters
    ----------
    path
        Final name. The writer works in ``<path>.part`` and renames at the end.
    setup
        What was measured with what.
    dtypes
        Channel name to sample type: integer for codes, float for volts.
    scales
        Channel name to ``(volts_per_code, offset_v)``.
    attributes
        Root attributes (text, numbers, bools).
    overwrite
        Whether ``path`` may exist (a closing run replaces its own frames file).
    compression
        ``lz4`` (bitshuffle-LZ4) or ``gzip`` for readers without that plugin.
    """

    def __init__(
        self,
        path: Path,
        setup: Setup,
        dtypes: Mapping[str, np.dtype[Any]],
        scales: Mapping[str, tuple[float, float]],
        attributes: Mapping[str, Any],
        *,
        overwrite: bool = False,
        compression: Compression = "lz4",
    ) -> None:
        if path.exists() and not overwrite:
            raise InputError(f"{path}: exists already and is never overwritten; choose another name.")
        self.path = path
        self.part = path.with_name(path.name + ".part")
        self.n_samples = 0
        # long enough that a cycle of the forcing repeats within it: even times shrink sixfold
        self._filters: dict[str, Any] = (
            dict(hdf5plugin.Bitshuffle(nelems=32768, cname="lz4"))
            if compression == "lz4"
            else {"compression": "gzip", "compression_opts": 4, "shuffle": True}
        )
        self._disk = DiskFile(self.part)
        # whole chunks are written, each once: a cache of them would only copy
        self._file = h5py.File(self._disk, "w", libver=("v110", "v110"), rdcc_nbytes=0)
        self._attributes = dict(attributes)
        self._sets = {"timestamp": self._dataset("timestamp", np.dtype("<i8"))}
        for name, dtype in dtypes.items():
            dataset = self._sets[name] = self._dataset(name, dtype)
            dataset.attrs["scale_factor"], dataset.attrs["add_offset"] = map(np.float64, scales[name])
            dataset.attrs["units"] = "V"
            dataset.attrs["long_name"] = KINDS[name].long_name if name in KINDS else name
            described = setup.channels.get(name)
            if described is not None:
                for key in ("coupling", "terminal", "serial_number"):
                    dataset.attrs[key] = getattr(described, key)
        self._held: dict[str, list[NDArray[Any]]] = {name: [] for name in self._sets}
        self._n_held = 0
        self._crc = dict.fromkeys(self._sets, 0)
        self._stored: dict[tuple[str, int], int] = {}  # column and first sample of a chunk: CRC-32 of its stored bytes

    def _dataset(self, name: str, dtype: np.dtype[Any]) -> Any:
        return self._file.create_dataset(
            name, (0,), maxshape=(None,), dtype=dtype, chunks=(CHUNK_SAMPLES,), fletcher32=True, **self._filters
        )

    def append(self, timestamps_ns: Integers | None, columns: Mapping[str, NDArray[Any]]) -> None:
        """Add samples: ``timestamps_ns`` (n,) (None: `write_timestamps` gives them), an array (n,) a channel."""
        pieces = dict(columns) if timestamps_ns is None else {"timestamp": timestamps_ns, **columns}
        lengths = {len(piece) for piece in pieces.values()}
        if set(pieces) | {"timestamp"} != set(self._sets) or len(lengths) != 1:
            got = {name: len(piece) for name, piece in pieces.items()}
            raise ValueError(f"wanted equal lengths of {list(self._sets)}, got {got}")
        for name, piece in pieces.items():
            self._held[name].append(np.ascontiguousarray(piece, self._sets[name].dtype))
        self._n_held += lengths.pop()
        if self._n_held >= CHUNK_SAMPLES:
            self._write(self._n_held - self._n_held % CHUNK_SAMPLES)

    def _write(self, n: int) -> None:
        """Write the first ``n`` held samples of every column (whole chunks, but for the last)."""
        for name, dataset in self._sets.items():
            if not self._held[name]:
                continue
            held = np.concatenate(self._held[name]) if len(self._held[name]) != 1 else self._held[name][0]
            dataset.id.set_extent((self.n_samples + n,))
            self._put(name, self.n_samples, held[:n])
            self._crc[name] = crc32(held[:n], self._crc[name])
            self._held[name] = [held[n:].copy()] if len(held) > n else []
        self.n_samples += n
        self._n_held -= n

    def _put(self, name: str, start: int, values: NDArray[Any]) -> None:
        """Write samples from ``start`` (of a chunk) on, read them back, and note the stored bytes that gave them.

        By HDF5's own calls: h5py's indexing takes as long as a small chunk.
        """
        dataset = self._sets[name].id
        where, here = dataset.get_space(), h5py.h5s.create_simple(values.shape)
        where.select_hyperslab((start,), values.shape)
        kind = h5py.h5t.py_create(values.dtype)
        back = np.empty_like(values)
        try:
            dataset.write(here, where, values, kind)
            self._disk.check()
            dataset.read(here, where, back, kind)
            # bit for bit: NaN equals NaN, and 0 differs from -0
            same = np.array_equal(values.view(f"u{values.itemsize}"), back.view(f"u{values.itemsize}"))
            for at in range(start, start + len(values), CHUNK_SAMPLES):
                self._stored[name, at] = zlib.crc32(dataset.read_direct_chunk((at,))[1])
        except RuntimeError as error:
            raise OSError(f"{self.part}: {error}") from error
        if not same:
            last = start + len(values) - 1
            raise OSError(f"{self.part}: what was written does not read back: {name}: samples {start} to {last}")

    def flush(self) -> None:
        """Write the samples that wait for a whole chunk."""
        if self._n_held:
            self._write(self._n_held)
        self._file.flush()
        self._disk.check()

    def write_timestamps(self, stamps: Callable[[int, int], Integers]) -> None:
        """Write the times of all samples appended without; ``stamps(start, stop)`` gives nanoseconds."""
        self.flush()
        self._sets["timestamp"].id.set_extent((self.n_samples,))
        for start in range(0, self.n_samples, CHUNK_SAMPLES):
            piece = np.ascontiguousarray(stamps(start, min(start + CHUNK_SAMPLES, self.n_samples)), "<i8")
            self._put("timestamp", start, piece)
            self._crc["timestamp"] = crc32(piece, self._crc["timestamp"])

    def check(
        self,
        steps: NDArray[np.void],
        blocks: NDArray[np.void],
        side: Mapping[str, NDArray[np.void]] | None = None,
        **late: Any,
    ) -> None:
        """Write tables and attributes, close, read every stored byte back, and seal the file.

        ``side`` are `daq.files.tables.SIDE_TABLES` by name, of which one without rows is left out, ``late`` attributes
        known only now (``ended``, ``why``, ...).

        Raises `OSError` when the disk refuses, or what was written does not read back: the tables, or a stored byte of
        a sample that differs from those that were read back when it was written.
        """
        self.flush()
        for name, rows in {"steps": steps, "blocks": blocks, **(side or {})}.items():
            if len(rows) or name not in SIDE_TABLES:
                _write_table(self._file, name, rows.astype(TABLES[name]))
        self._attributes |= late
        # the times are the axis of every channel
        axis = self._sets["timestamp"]
        started = str(self._attributes.get("started", ""))
        axis.attrs["units"] = f"nanoseconds since {started.removesuffix('Z')}" if started else "1e-9 s"
        axis.attrs["long_name"] = "time since the first sample"
        axis.make_scale("timestamp")
        for name, dataset in self._sets.items():
            dataset.attrs["crc32"] = np.uint32(self._crc[name])
            if name != "timestamp":
                dataset.dims[0].attach_scale(axis)
        self._attributes |= {"format": FORMAT, "format_version": FORMAT_VERSION, "sealed": True}
        self._attributes["attributes_crc32"] = text_crc(self._attributes)
        self._file.attrs.update(self._attributes)
        self._close()
        self._disk.check()
        # the seal reads every byte that is now in the file: these are compared with what was read back before
        faults = self._faults(write_seal(self.part, tuple(self._sets)))
        if faults:
            raise OSError(f"{self.part}: what was written does not read back: {faults[0]}")
        sync(self.part)

    def _faults(self, extents: NDArray[np.void]) -> list[str]:
        """Faults of the closed file, whose stored bytes have just been read into the seal's ``extents``."""
        names = tuple(self._sets)
        rows = extents[extents["column"] >= 0]
        read = {
            (names[c], at): crc
            for c, at, crc in zip(*(rows[key].tolist() for key in ("column", "first_sample", "crc32")), strict=True)
        }
        places = sorted(self._stored.keys() | read.keys())
        wrong = [place for place in places if self._stored.get(place) != read.get(place)]
        faults = [f"{name}: samples from {at} on" for name, at in wrong]
        with h5py.File(self.part, "r") as written:
            for name, dataset in ((name, written[name]) for name in names):
                if dataset.shape != (self.n_samples,) or int(dataset.attrs["crc32"]) != self._crc[name]:
                    faults.append(f"{name}: its length or its checksum")
            for name in TABLES:
                for key, dataset in written.get(name, {}).items():
                    try:
                        dataset[()]
                    except (OSError, RuntimeError) as error:
                        faults.append(f"{name}/{key}: {error}")
        return faults

    def rename(self) -> None:
        """Put the checked file into its final place, in one step."""
        ends = time.monotonic() + 20.0
        while True:
            try:
                self.part.replace(self.path)
                break
            except PermissionError:  # on Windows also while the frames are read: by a live page, a virus scanner
                if sys.platform != "win32" or time.monotonic() > ends:
                    raise
                time.sleep(0.05)
        sync_folder(self.path.parent)

    def abandon(self) -> None:
        """Close and remove the unfinished file."""
        self._close()
        self.part.unlink(missing_ok=True)

    def _close(self) -> None:
        if self._file.id.valid:
            self._file.close()
        self._disk.close()


def _write_table(file: Any, name: str, rows: NDArray[np.void]) -> None:
    """A table as a group of one-dimensional datasets, which every HDF5 reader understands."""
    group = file.create_group(name)
    scale = group.create_dataset(DIMENSION[name], data=np.arange(len(rows), dtype="<i8"))
    scale.make_scale(DIMENSION[name])
    for field in rows.dtype.names or ():
        data = np.ascontiguousarray(rows[field])
        options = {"chunks": (max(len(rows), 1),), "fletcher32": True, "maxshape": (None,)}
        dataset = group.create_dataset(field, data=data, **options)
        dataset.dims[0].attach_scale(scale)
        if field == "frequency_hz":
            dataset.attrs["units"] = "Hz"
