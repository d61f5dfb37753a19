"""Exports for other fields' programs: read by those fields' own libraries, and imported again."""

from __future__ import annotations

import json
import subprocess
import sys
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest

from bench.profiles.find import load
from daq.export.export import Kind, export
from daq.files.tables import Block
from daq.importers.formats.columns import parse_map
from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, import_recording
from daq.recording import Recording, open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError

RATE_HZ, N, LOST, AT = 48000.0, 96_000, 137, 60_000
SCALES = {"continuity": (10 / 32768, 0.0), "accelerometer": (2 / 32768, 0.1), "drive": (10 / 32768, 0.0)}
KINDS: tuple[Kind, ...] = ("parquet", "nc", "mat", "uff", "tdms")


def record(path: Path, lost: int = LOST, n: int = N) -> Recording:
    """A recording at 48 kHz whose first samples are random codes, with a loss; a hostile note and three channels."""
    profile, text = load("soundcard")
    rng = np.random.default_rng(5)
    codes = rng.integers(-20000, 20000, (n, 3)).astype(np.int16)
    t = np.arange(n) / RATE_HZ
    codes[:, 2] = np.rint(3000 * np.sin(2 * np.pi * profile.forcing.frequency_hz * t)).astype(np.int16)
    codes[:, 1] = codes[:, 2]
    codes[:, 0] = np.where(np.arange(n) % 2000 < 1000, 0, 16000)
    codes[:50] = rng.integers(-20000, 20000, (50, 3))
    with RecordingWriter(
        path, profile.setup(), profile_text=text, channels=tuple(SCALES), backend="soundcard", simulated=False,
        scales=SCALES, note='<script>"$\\frac{1}{0}$" ünïcode',
    ) as writer:  # fmt: skip
        for k in range(0, n, 1000):
            writer.append(Block(k, codes[k : k + 1000], lost_before=lost if k == AT else 0))
        writer.mark_step({"first_sample": 4800, "n_samples": 48_000, "gamma": 1.0})
    return open_recording(path)


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    """Two seconds with 137 samples lost."""
    return record(tmp_path / "rec.h5")


def test_parquet_opens_as_a_table(recording: Recording, tmp_path: Path) -> None:
    """Volts and times are exact in pandas; units, provenance and losses are in the metadata."""
    pandas = pytest.importorskip("pandas")
    parquet = pytest.importorskip("pyarrow.parquet")
    export(recording, tmp_path / "x.parquet", "parquet")
    table = pandas.read_parquet(tmp_path / "x.parquet")
    assert list(table) == ["time_s", "continuity_v", "accelerometer_v", "drive_v"]
    for name in recording.channels:
        np.testing.assert_array_equal(table[f"{name}_v"], recording.read_v(name))
    np.testing.assert_array_equal(np.rint(table["time_s"] * 1e9), recording.timestamps_ns())
    schema = parquet.read_schema(tmp_path / "x.parquet")
    assert schema.field("time_s").metadata[b"units"] == b"s" and schema.field("drive_v").metadata[b"units"] == b"V"
    assert schema.metadata[b"note"].decode() == recording.attrs["note"]
    assert json.loads(schema.metadata[b"gaps_json"]) == [[AT, LOST]]
    assert json.loads(schema.metadata[b"steps_json"])["first_sample"] == [4800]


def test_netcdf_opens_in_xarray(recording: Recording, tmp_path: Path) -> None:
    """Coordinates, units and exact volts in xarray; the stored numbers are the codes; time is unlimited."""
    xarray = pytest.importorskip("xarray")
    export(recording, tmp_path / "x.nc", "nc")
    with xarray.open_dataset(tmp_path / "x.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(np.rint(data.time.values * 1e9), recording.timestamps_ns())
        assert data.time.attrs["units"] == "s" and data.drive.attrs["units"] == "V" and data.drive.dims == ("time",)
        assert data.attrs["note"] == recording.attrs["note"] and "time" in data.encoding["unlimited_dims"]
        assert data.step_gamma.values.tolist() == [1.0]
        for name in recording.channels:
            np.testing.assert_array_equal(data[name].values, recording.read_v(name))
    with xarray.open_dataset(tmp_path / "x.nc", engine="h5netcdf", mask_and_scale=False) as data:
        np.testing.assert_array_equal(data.drive.values, recording.codes("drive"))


def test_matlab_file_is_one_of_version_7_3(recording: Recording, tmp_path: Path) -> None:
    """SciPy takes it for MATLAB 7.3 by its header; vectors are columns, texts are characters, all values exact."""
    from scipy.io import whosmat

    export(recording, tmp_path / "x.mat", "mat")
    with pytest.raises(NotImplementedError, match=r"HDF reader for matlab v7\.3"):
        whosmat(str(tmp_path / "x.mat"))
    with h5py.File(tmp_path / "x.mat") as file:
        assert file["drive_v"].shape == (1, N) and file["drive_v"].attrs["MATLAB_class"] == b"double"
        for name in recording.channels:
            np.testing.assert_array_equal(file[f"{name}_v"][0], recording.read_v(name))
        note = file["note"][()].astype("<u2").tobytes().decode("utf-16-le")
        assert note == recording.attrs["note"] and file["note"].attrs["MATLAB_class"] == b"char"
        assert file["why"].attrs["MATLAB_empty"] == 1
        assert file["steps"].attrs["MATLAB_class"] == b"struct" and file["steps/gamma"][0, 0] == 1.0


def test_uff58_opens_in_pyuff(recording: Recording, tmp_path: Path) -> None:
    """A set for each channel and piece of at most 65536; values exact; a loss parts pieces and is stated."""
    pyuff = pytest.importorskip("pyuff")
    export(recording, tmp_path / "x.uff", "uff")
    sets = pyuff.UFF(str(tmp_path / "x.uff")).read_sets()
    drive = [s for s in sets if s["id1"].strip() == "drive"]
    assert [s["num_pts"] for s in drive] == [AT, 65536 - AT, N - 65536] and len(sets) == 9
    np.testing.assert_array_equal(np.concatenate([s["data"] for s in drive]), recording.read_v("drive"))
    assert drive[0]["ordinate_axis_units_lab"].strip() == "V" and drive[0]["abscissa_axis_units_lab"].strip() == "s"
    assert drive[1]["id5"].strip() == f"lost_before={LOST}"
    assert drive[1]["abscissa_min"] == pytest.approx((AT + LOST) / RATE_HZ, rel=1e-5)


def test_tdms_opens_in_nptdms(recording: Recording, tmp_path: Path) -> None:
    """Codes with their scale give exact volts; waveform properties, provenance, steps and losses are there."""
    nptdms = pytest.importorskip("nptdms")
    export(recording, tmp_path / "x.tdms", "tdms")
    file = nptdms.TdmsFile.read(tmp_path / "x.tdms")
    for name in recording.channels:
        channel = file["recording"][name]
        np.testing.assert_array_equal(channel[:], recording.read_v(name))
        np.testing.assert_array_equal(channel.raw_data, recording.codes(name))
        assert channel.properties["wf_increment"] == 1 / RATE_HZ and channel.properties["unit_string"] == "V"
    np.testing.assert_array_equal(np.rint(file["recording"]["time_s"][:] * 1e9), recording.timestamps_ns())
    assert file.properties["note"] == recording.attrs["note"]
    assert file["gaps"]["samples_lost"][:].tolist() == [LOST] and file["steps"]["first_sample"][:].tolist() == [4800]


@pytest.mark.parametrize("lost", [LOST, 0])
@pytest.mark.parametrize("kind", ["nc", "mat", "uff", "tdms"])
def test_an_export_is_imported_again(tmp_path: Path, kind: Kind, lost: int) -> None:
    """The same volts, rate, times and lost samples; NetCDF and TDMS keep the codes themselves."""
    first = record(tmp_path / "rec.h5", lost)
    export(first, tmp_path / f"x.{kind}", kind)
    source = open_source(tmp_path / f"x.{kind}")
    lead = "recording/" if kind == "tdms" else ""
    options = ImportOptions(parse_map([f"{n}={lead}{n} (v)" for n in first.channels]) if kind == "tdms" else {})
    import_recording(source, tmp_path / "back.h5", first.setup, "", options)
    with open_recording(tmp_path / "back.h5") as back:
        assert back.rate_hz == RATE_HZ and back.n_samples == N
        assert back.gaps.tolist() == ([[AT, lost]] if lost else [])
        assert np.abs(back.timestamps_ns() - first.timestamps_ns()).max() <= 1
        for name in first.channels:
            np.testing.assert_array_equal(back.read_v(name), first.read_v(name))
            if kind in ("nc", "tdms"):
                np.testing.assert_array_equal(back.codes(name), first.codes(name))


def test_tdms_names_are_recognised(recording: Recording, tmp_path: Path) -> None:
    """A TDMS export needs no --map: channels are known by the last part of their names."""
    export(recording, tmp_path / "x.tdms", "tdms")
    summary = import_recording(open_source(tmp_path / "x.tdms"), tmp_path / "back.h5", recording.setup, "")
    assert summary.columns["drive"] == "recording/drive (v)" and summary.timebase.rate_hz == RATE_HZ


def test_time_stamps_of_tdms_keep_their_nanoseconds(tmp_path: Path) -> None:
    """A channel of dates is a time column in nanoseconds, not cut to whole seconds."""
    nptdms = pytest.importorskip("nptdms")
    stamps = np.datetime64("2026-11-25T10:00:00", "us") + np.arange(500) * np.timedelta64(50, "us")
    with nptdms.TdmsWriter(str(tmp_path / "x.tdms")) as writer:
        writer.write_segment([nptdms.ChannelObject("run", "Time", stamps)])
    source = open_source(tmp_path / "x.tdms")
    (piece,) = source.pieces(source.names)
    assert source.names == ("run/Time (ns)",)
    np.testing.assert_allclose(np.diff(piece.columns["run/Time (ns)"]), 50_000, atol=1)


def test_a_universal_file_of_text_and_six_digits(tmp_path: Path) -> None:
    """Somebody's ASCII set at 48 kHz has an increment of six digits: the rate meant is taken; units are read."""
    pyuff = pytest.importorskip("pyuff")
    t = np.arange(3000) / RATE_HZ
    common = {"type": 58, "func_type": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "abscissa_spacing": 1, "x": t}
    common |= {f"{axis}_spec_data_type": 0 for axis in ("abscissa", "ordinate", "orddenom", "z_axis")}
    signals = {"CH 1": (np.sin(900 * t), "g"), "CH 2": (250 * np.cos(900 * t), "mV")}
    sets = [
        {**common, "id1": name, "rsp_node": i, "data": y, "ordinate_axis_units_lab": unit, "binary": 0}
        for i, (name, (y, unit)) in enumerate(signals.items())
    ]
    pyuff.UFF(str(tmp_path / "x.unv")).write_sets(sets, "overwrite")
    source = open_source(tmp_path / "x.unv")
    assert set(source.names) == {"time_s", "CH 1 (g)", "CH 2 (mv)"}
    piece = next(iter(source.pieces(["time_s", "CH 2 (mv)"])))
    np.testing.assert_allclose(piece.columns["time_s"], t, atol=1e-12)
    np.testing.assert_allclose(piece.columns["CH 2 (mv)"], 250 * np.cos(900 * t), rtol=1e-10)


def test_mdf4_comes_in(recording: Recording, tmp_path: Path) -> None:
    """An MDF file that asammdf wrote: values to the last bit, its time, and the pause as lost samples."""
    asammdf = pytest.importorskip("asammdf")
    t = recording.timestamps_ns() * 1e-9
    signals = [asammdf.Signal(recording.read_v(n), t, unit="V", name=n) for n in recording.channels]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals)
        file.save(tmp_path / "x.mf4")
    import_recording(open_source(tmp_path / "x.mf4"), tmp_path / "back.h5", recording.setup, "")
    with open_recording(tmp_path / "back.h5") as back:
        assert back.rate_hz == RATE_HZ and back.gaps.tolist() == [[AT, LOST]]
        for name in recording.channels:
            np.testing.assert_array_equal(back.read_v(name), recording.read_v(name))


@pytest.mark.parametrize(("module", "name"), [("pyuff", "x.uff"), ("nptdms", "x.tdms"), ("asammdf", "x.mf4")])
def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, name: str) -> None:
    """Without its library an import says what to install."""
    (tmp_path / name).write_bytes(b"something")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=r"pip install .*shakerbench\[interchange\]"):
        open_source(tmp_path / name)


@pytest.mark.parametrize(("module", "kind"), [("h5netcdf", "nc"), ("nptdms", "tdms")])
def test_a_missing_extra_leaves_no_file(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, kind: Kind
) -> None:
    """Without its library an export says what to install, and nothing is left behind."""
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match="pip install"):
        export(recording, tmp_path / f"x.{kind}", kind)
    assert [p.name for p in tmp_path.iterdir()] == ["rec.h5"]


@pytest.mark.parametrize("name", ["x.uff", "x.tdms", "x.mf4"])
@pytest.mark.parametrize("start", [b"", b"TDSm", b"    -1\n    58\n", b"MDF     4.10    "])
def test_noise_is_no_file_of_theirs(tmp_path: Path, name: str, start: bytes) -> None:
    """Bytes that mean nothing are refused with the file's name."""
    (tmp_path / name).write_bytes(start + np.random.default_rng(1).bytes(4000))
    with pytest.raises(InputError, match=name):
        open_source(tmp_path / name)


@pytest.mark.parametrize("kind", KINDS)
def test_memory_does_not_grow_with_the_length(tmp_path: Path, kind: Kind, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four times the samples take no more memory to write, once both are many pieces long."""
    monkeypatch.setattr("daq.export.export.CHUNK_SAMPLES", 8192)
    peaks = []
    for i, n in enumerate((100_000, 100_000, 400_000)):  # the first one pays for imports
        with record(tmp_path / f"r{i}.h5", 0, n) as recording:
            tracemalloc.start()
            export(recording, tmp_path / f"x{i}.{kind}", kind)
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert peaks[2] < 1.3 * peaks[1] + 500_000, peaks


FULL = """
import errno, resource, sys
from pathlib import Path
from daq.export.export import export
from daq.recording import open_recording

folder, kinds = Path(sys.argv[1]), sys.argv[2:]
with open_recording(folder / "rec.h5") as recording:
    for kind in kinds:
        for room in (0, 3000, 60_000):
            resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
            try:
                export(recording, folder / f"x.{kind}", kind)
            except OSError as error:
                refused = error.errno == errno.EFBIG or "File too large" in str(error)
            else:
                refused = False
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            print(kind, room, refused, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="a limit of the size of files is POSIX's")
def test_a_full_disk_is_one_error(recording: Recording, tmp_path: Path) -> None:
    """Where the system takes no more of a file, each export raises what it says; nothing crashes, no file is left."""
    kinds = ("csv", "npz", "h5", *KINDS)
    call = [sys.executable, "-B", "-c", FULL, str(tmp_path), *kinds]  # under the limit Python would cut its own caches
    done = subprocess.run(call, cwd=Path(__file__).parents[3], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [f"{kind} {room} True" for kind in kinds for room in (0, 3000, 60_000)]
    assert done.stderr == ""
    assert done.returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["rec.h5"]
