"""Files made to harm: nothing in them is run, no file outside is opened, what they claim is not believed."""

from __future__ import annotations

import gzip
import io
import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from daq.export.export import export
from daq.importers.formats.columns import assign, listed, parse_map
from daq.importers.formats.open import open_source
from daq.importers.import_recording import import_recording
from daq.recording import open_recording
from daq.setup.errors import InputError
from daq.setup.setup import Setup

NAMES = ("time_s", "accelerometer_v", "drive_v")
HUGE = 1 << 45


class Bomb:
    """An object that leaves a mark when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return Path.touch, (self.mark,)


def columns(n: int = 4000) -> dict[str, np.ndarray[Any, Any]]:
    """A plate that follows its drive."""
    t = np.arange(n) / 2000.0
    drive = 0.3 * np.sin(2 * np.pi * 25.37 * t)
    return {"time_s": t, "accelerometer_v": 0.2 * drive, "drive_v": drive}


def bring_in(raw: Path, setup: Setup) -> None:
    """Import, which must leave nothing behind where it fails."""
    out = raw.with_suffix(".out.h5")
    try:
        import_recording(open_source(raw), out, setup, "")
    except InputError:
        assert not out.exists() and not out.with_name(out.name + ".part").exists()
        raise


def peak_bytes(raw: Path, setup: Setup) -> int:
    """Memory at its highest while a file is refused."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError):
            bring_in(raw, setup)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def npy(header: str) -> bytes:
    """An NPY file that is all header and 4000 zeros."""
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(32_000)


def test_pickled_objects_stay_pickled(tmp_path: Path, setup: Setup) -> None:
    """An NPZ of Python objects is refused, or passed over, without one of them coming alive."""
    mark = tmp_path / "mark"
    np.savez(tmp_path / "a.npz", drive_v=np.array([Bomb(mark)] * 2000, object))
    with pytest.raises(InputError, match="Python objects"):
        bring_in(tmp_path / "a.npz", setup)
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("drive_v.npy", pickle.dumps(Bomb(mark)))
    with pytest.raises(InputError, match="cannot be read as NPZ"):
        bring_in(tmp_path / "b.npz", setup)
    assert not mark.exists()


@pytest.mark.parametrize(
    "header",
    [
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({HUGE},)}}",
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': (1, {HUGE})}}",
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({HUGE}, 3)}}",
        "{'descr': '<V2000000000', 'fortran_order': False, 'shape': (4000,)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-4000,)}",
        "{'descr': '|O', 'fortran_order': False, 'shape': (4000,)}",
        "{'descr': __import__('os'), 'fortran_order': False, 'shape': (4000,)}",
    ],
)
def test_npz_claims_are_not_believed(tmp_path: Path, setup: Setup, header: str) -> None:
    """A shape or type larger than the archive is refused in little memory."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in NAMES:
            archive.writestr(f"{name}.npy", npy(header))
    assert peak_bytes(tmp_path / "a.npz", setup) < 50_000_000


def test_zeros_packed_a_thousandfold(tmp_path: Path, setup: Setup) -> None:
    """An archive that unpacks to far more than it weighs is unpacked piece by piece, in little memory."""
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in NAMES:
            with archive.open(f"{name}.npy", "w") as file:
                header = {"descr": "<f8", "fortran_order": False, "shape": (4_000_000,)}
                np.lib.format.write_array_header_1_0(file, header)
                file.write(bytes(32_000_000))
    assert peak_bytes(tmp_path / "a.npz", setup) < 50_000_000


def hdf5_with(path: Path, **options: Any) -> Path:
    """Three columns made by `create_dataset`."""
    with h5py.File(path, "w") as file:
        for name in NAMES:
            file.create_dataset(name, **options)
    return path


@pytest.mark.parametrize(
    "options",
    [
        {"shape": (HUGE,), "dtype": "f8", "chunks": (1024,)},
        {"shape": (HUGE, 1), "dtype": "f8", "chunks": (1024, 1), "compression": "gzip"},
        {"shape": (HUGE,), "dtype": "f8"},
        {"shape": (4000,), "dtype": np.dtype("V100000000")},
        {"shape": (4000,), "dtype": np.dtype([("x", "f8"), ("y", "V100000000")]), "chunks": (1,)},
    ],
)
def test_hdf5_claims_are_not_believed(tmp_path: Path, setup: Setup, options: dict[str, Any]) -> None:
    """A dataset that says it is huge, and holds nothing, is refused in little memory."""
    assert peak_bytes(hdf5_with(tmp_path / "a.h5", **options), setup) < 50_000_000


def test_a_chunk_that_unpacks_to_gigabytes(tmp_path: Path, setup: Setup) -> None:
    """A dataset in one enormous chunk is refused before the chunk is unpacked."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in columns().items():
            data = file.create_dataset(name, (1 << 27,), "f8", chunks=(1 << 27,), compression="gzip")
            data.id.write_direct_chunk((0,), np.random.default_rng(0).bytes(1 << 20))
            del values
    assert peak_bytes(tmp_path / "a.h5", setup) < 50_000_000


def test_nothing_outside_is_opened(tmp_path: Path, setup: Setup) -> None:
    """External links, external storage, virtual datasets and link loops give no column; the file's own still do."""
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["drive_v"] = columns()["drive_v"]
    (tmp_path / "secret.bin").write_bytes(columns()["drive_v"].tobytes())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in NAMES[:2]:
            file[f"run/{name}"] = columns()[name]
        file["linked"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/drive_v")
        file["gone"] = h5py.SoftLink("/nowhere")
        file["run/loop"] = file["run"]
        file["again"] = h5py.SoftLink("/again")
        file.create_dataset("raw/drive_v", (4000,), "f8", external=[(str(tmp_path / "secret.bin"), 0, 32_000)])
        layout = h5py.VirtualLayout((4000,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "drive_v", (4000,))
        file.create_virtual_dataset("virtual/drive_v", layout)
    source = open_source(tmp_path / "a.h5")
    assert source.names == ("run/accelerometer_v", "run/time_s")
    assert set(assign(source, {})) == {"time", "accelerometer"}
    bring_in(tmp_path / "a.h5", setup)


def test_a_hundred_thousand_datasets(tmp_path: Path) -> None:
    """Far more objects than a table has are refused while they are counted; errors list a few names."""
    with h5py.File(tmp_path / "a.h5", "w", libver="latest") as file:
        empty = file.create_group("a")
        for i in range(10_100):
            empty.id.links.create_soft(str(i).encode(), b"/a")
            h5py.h5g.create(empty.id, b"g%d" % i)
    with pytest.raises(InputError, match="more than 10000"):
        open_source(tmp_path / "a.h5")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        for i in range(10_001):
            archive.writestr(f"{i}.npy", b"")
    with pytest.raises(InputError, match="more than 10000"):
        open_source(tmp_path / "b.npz")
    assert len(listed([str(i) for i in range(100_000)])) < 200


@pytest.mark.parametrize("text", [b"1", b"1,", b"0 ", b"\xff\xfe1\x00"])
def test_one_endless_line(tmp_path: Path, setup: Setup, text: bytes) -> None:
    """A gzip of one line without end is refused after its first piece."""
    body = io.BytesIO()
    with gzip.open(body, "wb") as file:
        file.write(text)
        for _ in range(64):
            file.write((text[-2:] if text[:1] == b"\xff" else text) * (1 << 19))
    (tmp_path / "a.csv.gz").write_bytes(body.getvalue())
    assert peak_bytes(tmp_path / "a.csv.gz", setup) < 20_000_000


def test_a_line_without_end_after_good_ones(tmp_path: Path, setup: Setup) -> None:
    """The same after a thousand good rows, with the line's number."""
    rows = "".join(f"{i / 2000},0.0,0.0\n" for i in range(1000))
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress((",".join(NAMES) + "\n" + rows + "1" * 30_000_000).encode()))
    with pytest.raises(InputError, match="line 1002 or one near it is longer than"):
        bring_in(tmp_path / "a.csv.gz", setup)


def test_a_matlab_file_that_unpacks_to_far_more(tmp_path: Path, setup: Setup) -> None:
    """A MATLAB file of zeros packed a thousandfold is refused by what it claims, before it is unpacked."""
    zeros = np.zeros(8_000_000)
    savemat(tmp_path / "a.mat", dict.fromkeys(NAMES, zeros), do_compression=True)
    assert peak_bytes(tmp_path / "a.mat", setup) < 50_000_000


def test_names_cannot_steer_a_terminal() -> None:
    """Control characters of a column's name do not reach an error's text."""
    assert listed(["\x1b[2Jdrive", "a\nb"]) == "?[2Jdrive, a?b"


def test_a_formula_is_no_name_in_an_exported_table(tmp_path: Path, setup: Setup) -> None:
    """A channel whose name a spreadsheet would run is exported as text."""
    raw = tmp_path / "a.csv"
    np.savetxt(raw, np.column_stack(list(columns().values())), "%.9g", ",", header=",".join(NAMES), comments="")
    bring_in(raw, setup)
    with open_recording(tmp_path / "a.out.h5") as recording:
        recording.channels = ('=cmd|"/c calc"!A1', "drive")
        recording._scales['=cmd|"/c calc"!A1'] = (1.0, 0.0)  # type: ignore[assignment]
        recording._known = lambda channel: "drive"  # type: ignore[method-assign]
        recording._scales["drive"] = [1.0, 0.0]
        export(recording, tmp_path / "b.csv", "csv")
    assert (tmp_path / "b.csv").read_text().splitlines()[0] == 'time_s,"\'=cmd|""/c calc""!A1_v",drive_v'


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "npz", "hdf5", "mat", "wav"])
@pytest.mark.parametrize("start", [b"", b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", b"RIFF\x24\x00\x00\x00WAVEfmt \x10\0\0\0"])
def test_noise_is_no_recording(tmp_path: Path, setup: Setup, ending: str, start: bytes) -> None:
    """Random bytes under any ending, behind any beginning, are an error in words."""
    raw = tmp_path / f"a.{ending}"
    raw.write_bytes(start + np.random.default_rng(1).bytes(20_000))
    with pytest.raises(InputError):
        bring_in(raw, setup)
    raw.write_bytes(start + bytes(4000))
    with pytest.raises(InputError):
        bring_in(raw, setup)


def test_a_wav_file_cut_off_in_its_head(tmp_path: Path, setup: Setup) -> None:
    """A WAV file that ends before its format or its samples is refused by name, with what to do."""
    raw = tmp_path / "a.wav"
    raw.write_bytes(b"RIFF\0\0\0\0WAVE")
    with pytest.raises(InputError, match=r"a\.wav: cannot be read as WAV .*copy it again"):
        bring_in(raw, setup)


def test_what_is_no_table_is_named(tmp_path: Path, setup: Setup) -> None:
    """A folder is called a folder, a file without columns has none, and an unknown unit brings the known ones."""
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(InputError, match="is a folder; wanted a file"):
        bring_in(tmp_path / "a.csv", setup)
    h5py.File(tmp_path / "a.h5", "w").close()
    with pytest.raises(InputError, match="among none; wanted accelerometer_v"):
        bring_in(tmp_path / "a.h5", setup)
    raw = tmp_path / "b.csv"
    np.savetxt(raw, np.column_stack(list(columns().values())), "%.9g", ",", header=",".join(NAMES), comments="")
    with pytest.raises(InputError, match=r"no such column.*wanted a unit: s ms us"):
        assign(open_source(raw), parse_map(["accelerometer=accelerometer_v:furlong"]))


def test_columns_of_something_else_than_real_numbers_are_named(tmp_path: Path, setup: Setup) -> None:
    """An accelerometer stored as complex numbers: the error says that it is there and why it is no column."""
    raw = tmp_path / "a.h5"
    with h5py.File(raw, "w") as file:
        for name, values in columns().items():
            file[name] = values.astype(np.complex128) if name == "accelerometer_v" else values
        file["remark"] = ["a", "b"]
    with pytest.raises(
        InputError, match=r"no column for the accel.*; not read: accelerometer_v \(complex numbers\), remark \(text"
    ):
        bring_in(raw, setup)
