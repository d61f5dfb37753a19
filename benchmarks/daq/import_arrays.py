"""Speed of `bench import` of binary files: the rows read piece by piece, and the whole import, beside the raw read.

Run: python -m benchmarks.daq.import_arrays [MINUTES]. HDF5 (plain and gzip), NPZ (stored and deflated), WAV and MAT
(5 and 7.3) with the same numbers; the raw read is that of h5py, NumPy or SciPy of all columns. Processor seconds of one
process, the fastest of three; ratios are of one run. Goal: rows read within 2.0 times the raw read.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat, savemat, wavfile

from benchmarks.daq.recordings import RATE_HZ, SETUP
from daq.importers.formats.columns import assign
from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, import_recording
from daq.setup.setup import Setup

HOLD_S = 10.0
CHANNELS = ("continuity", "accelerometer", "drive")
GOAL = 2.0


def columns(minutes: float) -> dict[str, np.ndarray]:
    """A ramp of steps that hold for ten seconds, with noise: seconds and volts, (n,) each."""
    rng = np.random.default_rng(1)
    t = np.arange(round(minutes * 60.0 * RATE_HZ)) / RATE_HZ
    drive = (0.1 + 0.01 * (t // HOLD_S)) * np.sin(2 * np.pi * 25.37 * t)
    contact = np.where((t * 25.37) % 1 < 0.4, 5.0, 0.0) + rng.normal(0, 0.01, len(t))
    return {
        "time_s": t,
        "continuity": contact,
        "accelerometer": 0.2 * drive + rng.normal(0, 1e-3, len(t)),
        "drive": drive,
    }


def write_all(folder: Path, data: dict[str, np.ndarray]) -> dict[str, tuple[Path, Callable[[Path], Any]]]:
    """Files by kind, and what reads each raw."""
    for name, options in (("plain.h5", {}), ("gzip.h5", {"chunks": (65536,), "compression": "gzip"})):
        with h5py.File(folder / name, "w") as file:
            for column, values in data.items():
                file.create_dataset(column, data=values, **options)
    with h5py.File(folder / "new.mat", "w", userblock_size=512) as file:
        for column, values in data.items():
            file.create_dataset(column, data=values[None, :])
    np.savez(folder / "stored.npz", **data)
    np.savez_compressed(folder / "deflated.npz", **data)
    savemat(folder / "old.mat", data)
    codes = np.column_stack([np.rint(data[c] / 10.0 * 32767) for c in CHANNELS]).astype(np.int16)
    wavfile.write(folder / "codes.wav", int(RATE_HZ), codes)
    return {
        "HDF5": (folder / "plain.h5", read_hdf5),
        "HDF5, gzip": (folder / "gzip.h5", read_hdf5),
        "NPZ": (folder / "stored.npz", read_npz),
        "NPZ, deflated": (folder / "deflated.npz", read_npz),
        "WAV": (folder / "codes.wav", wavfile.read),
        "MAT 5": (folder / "old.mat", loadmat),
        "MAT 7.3": (folder / "new.mat", read_hdf5),
    }


def read_hdf5(path: Path) -> None:
    """Every dataset whole."""
    with h5py.File(path) as file:
        for name in file:
            _ = file[name][()]


def read_npz(path: Path) -> None:
    """Every array whole."""
    with np.load(path) as file:
        for name in file.files:
            _ = file[name]


def read_pieces(path: Path) -> None:
    """What the import reads, piece by piece."""
    source = open_source(path)
    for _ in source.pieces([column.name for column in assign(source, {}).values()]):
        pass


def seconds(job: Callable[[], Any], repeats: int = 3) -> float:
    """The fewest processor seconds of some runs."""
    spent = []
    for _ in range(repeats):
        began = time.process_time()
        job()
        spent.append(time.process_time() - began)
    return min(spent)


def main() -> None:
    """Print one row a kind of file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("minutes", type=float, nargs="?", default=2.0)
    minutes = parser.parse_args().minutes
    setup, options = Setup.model_validate(SETUP), ImportOptions(rate_hz=RATE_HZ)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.h5"

        def whole(path: Path) -> None:
            out.unlink(missing_ok=True)
            import_recording(open_source(path), out, setup, "", options)

        small = Path(folder) / "small"
        small.mkdir()
        for path, _ in write_all(small, columns(0.5)).values():
            whole(path)  # compile
        for kind, (path, raw) in write_all(Path(folder), columns(minutes)).items():
            megabytes = path.stat().st_size / 1e6
            read_s = seconds(lambda path=path, raw=raw: raw(path))
            pieces_s, whole_s = seconds(lambda path=path: read_pieces(path)), seconds(lambda path=path: whole(path), 1)
            print(
                f"{kind:<14} {megabytes:4.0f} MB  raw {read_s:6.3f} s  rows {pieces_s:6.3f} s, {pieces_s / read_s:4.1f}"
                f" (goal {GOAL})  whole import {whole_s:5.2f} s, {whole_s / read_s:5.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
