"""Foreign recordings: numbers come through untouched, steps and rates are found, bad input leaves nothing behind."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat, wavfile

from daq.export.export import export
from daq.importers.formats.columns import PIECE_ROWS, assign, parse_map, split_name
from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, ImportSummary, import_recording
from daq.recording import open_recording, verify
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats

RATE_HZ = 2000.0
LEVELS = [0.2, 0.5, 0.3]
Columns = dict[str, Floats]


def write_csv(path: Path, columns: Columns, delimiter: str = ",", formats: str | list[str] = "%.9g") -> Path:
    """A CSV with a header."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, formats, delimiter, header=delimiter.join(columns), comments="")
    return path


def bring_in(raw: Path, out: Path, setup: Setup, maps: list[str] | None = None, **options: object) -> ImportSummary:
    """Import as the command does."""
    select = options.pop("select", None)
    source = open_source(raw, select)  # type: ignore[arg-type]
    return import_recording(source, out, setup, "", ImportOptions(parse_map(maps or []), **options))  # type: ignore[arg-type]


def check(out: Path, columns: Columns, summary: ImportSummary, tolerance: float = 1e-8) -> None:
    """The recording holds the columns, the rate and the three steps."""
    assert verify(out).state == "complete"
    with open_recording(out) as recording:
        assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-12)
        assert recording.setup.sampling.rate_hz == recording.rate_hz
        for name in recording.channels:
            np.testing.assert_allclose(recording.read_v(name), columns[f"{name}_v"], atol=tolerance)
        since_first_s = columns["time_s"] - columns["time_s"][0]
        np.testing.assert_allclose(recording.timestamps_ns() * 1e-9, since_first_s, atol=2e-9)
        np.testing.assert_allclose(recording.steps["gamma"], np.array(LEVELS), rtol=2e-3)
        np.testing.assert_allclose(recording.steps["achieved_gamma"], np.array(LEVELS), rtol=2e-3)
        np.testing.assert_allclose(recording.steps["frequency_hz"], 25.37, rtol=1e-5)
    assert summary.timebase.uniform


def test_csv_plain_and_packed(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A CSV comes in by its column names, packed or not."""
    raw = write_csv(tmp_path / "a.csv", columns)
    check(tmp_path / "a.h5", columns, bring_in(raw, tmp_path / "a.h5", setup))
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(raw.read_bytes()))
    check(tmp_path / "b.h5", columns, bring_in(tmp_path / "b.csv.gz", tmp_path / "b.h5", setup))


def test_a_chunk_longer_than_a_piece_is_unpacked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns of an HDF5 file are opened once each, so that HDF5 keeps the chunk that two pieces share."""
    path, n = tmp_path / "foreign.h5", 4 * PIECE_ROWS
    with h5py.File(path, "w") as file:
        file.create_dataset("accelerometer_v", data=np.arange(n, dtype=np.int16), chunks=(n,), compression="gzip")
        file.create_dataset("pair", data=np.arange(2 * n).reshape(n, 2), chunks=(n, 2))
    source = open_source(path)
    opened: list[str] = []
    get = h5py.File.__getitem__
    monkeypatch.setattr(h5py.File, "__getitem__", lambda file, name: (opened.append(name), get(file, name))[1])
    rows = [piece.columns for piece in source.pieces(["accelerometer_v", "pair[1]"])]
    assert len(rows) == 4
    np.testing.assert_array_equal(np.concatenate([r["pair[1]"] for r in rows]), np.arange(1, 2 * n, 2))
    assert opened.count("accelerometer_v") <= 2 and opened.count("pair") <= 2  # before reading, and for it


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_csv_dialects(tmp_path: Path, setup: Setup, columns: Columns, delimiter: str) -> None:
    """Semicolons with decimal commas, tabs, a byte-order mark, a title above the header and comments are understood."""
    raw = write_csv(tmp_path / "a.csv", columns, delimiter)
    text = raw.read_text()
    text = "\ufeffScope export\n# taken today\n" + (text.replace(".", ",") if delimiter == ";" else text) + "\n"
    raw.write_text(text.replace("\n", "\r\n"), encoding="utf-8")
    check(tmp_path / "a.h5", columns, bring_in(raw, tmp_path / "a.h5", setup))


def test_numpy_header_in_a_comment(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """The header that numpy.savetxt writes, behind a #, is a header."""
    np.savetxt(tmp_path / "a.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns))
    check(tmp_path / "a.h5", columns, bring_in(tmp_path / "a.csv", tmp_path / "a.h5", setup))


def test_hdf5_npz_and_mat(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Arrays come in from HDF5 (in groups too), NPZ and MAT files, in the type they have."""
    with h5py.File(tmp_path / "a.hdf5", "w") as file:
        for name, values in columns.items():
            file[f"run/{name}"] = values.astype("f4") if name == "drive_v" else values
    check(tmp_path / "a.h5", columns, bring_in(tmp_path / "a.hdf5", tmp_path / "a.h5", setup), 1e-6)
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.codes("drive", 0, 1).dtype == np.float32
        assert recording.scale("drive") == (1.0, 0.0)
    np.savez_compressed(tmp_path / "b.npz", **columns, note=np.str_("text is not a column"))
    check(tmp_path / "b.h5", columns, bring_in(tmp_path / "b.npz", tmp_path / "b.h5", setup))
    savemat(tmp_path / "c.mat", columns)
    check(tmp_path / "c.h5", columns, bring_in(tmp_path / "c.mat", tmp_path / "c.h5", setup))


def test_matrix_columns_by_number(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A matrix gives its columns as name[i]; without a time column the file's own rate serves."""
    matrix = np.column_stack([columns["accelerometer_v"], columns["drive_v"]])
    np.savez(tmp_path / "a.npz", data=matrix, fs=RATE_HZ)
    summary = bring_in(tmp_path / "a.npz", tmp_path / "a.h5", setup, ["accelerometer=data[0]", "drive=data[1]"])
    check(tmp_path / "a.h5", columns, summary)


def test_wav_keeps_its_codes(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Whole-number WAV samples stay whole numbers; full scale, named or not, is the channel's range."""
    names = ["continuity_v", "accelerometer_v", "drive_v"]
    codes = np.rint(np.column_stack([columns[n] for n in names]) / 10 * 32768).astype(np.int16)
    wavfile.write(tmp_path / "a.wav", int(RATE_HZ), codes)
    check(tmp_path / "a.h5", columns, bring_in(tmp_path / "a.wav", tmp_path / "a.h5", setup), 2e-4)
    with open_recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording.codes("drive"), codes[:, 2])
        assert recording.setup.channels.continuity is not None
    maps = [f"{name}={name}:fs" for name in ("continuity", "accelerometer", "drive")]
    check(tmp_path / "b.h5", columns, bring_in(tmp_path / "a.wav", tmp_path / "b.h5", setup, maps), 2e-4)


def test_other_names_and_units(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Names in other spellings are recognised with their units; others are mapped, by name or number."""
    renamed = {
        "Time (ms)": columns["time_s"] * 1e3,
        "Contact [V]": columns["continuity_v"],
        "CH 2": columns["accelerometer_v"] * 1e3,
        "CH 3": columns["drive_v"],
    }
    raw = write_csv(tmp_path / "a.csv", renamed, formats="%.12g")
    check(tmp_path / "a.h5", columns, bring_in(raw, tmp_path / "a.h5", setup, ["accelerometer=CH 2:mV", "drive=4"]))
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.scale("accelerometer") == (1e-3, 0.0)  # the millivolts are kept as they came


def test_acceleration_in_g_is_a_sensor_of_one_volt_a_g(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A calibrated acceleration is stored as it is and the set-up says what one unit of it means."""
    given = {name: columns[name] for name in ("time_s", "drive_v")}
    given["Acceleration (g)"] = columns["accelerometer_v"] / 0.1
    summary = bring_in(write_csv(tmp_path / "a.csv", given), tmp_path / "a.h5", setup)
    with open_recording(tmp_path / "a.h5") as recording:
        sensor = recording.setup.channels.accelerometer
        assert (sensor.sensitivity.value, sensor.unit) == (1.0, "V/g")
        assert recording.setup.channels.continuity is None
        np.testing.assert_allclose(recording.steps["achieved_gamma"], LEVELS, rtol=2e-3)
    assert any("only the plate" in remark for remark in summary.remarks)


def test_steps_without_a_drive(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Where nobody recorded the drive, the steps are found in the acceleration, and gamma is the plate's."""
    del columns["drive_v"]
    bring_in(write_csv(tmp_path / "a.csv", columns), tmp_path / "a.h5", setup)
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.channels == ("continuity", "accelerometer")
        np.testing.assert_allclose(recording.steps["gamma"], LEVELS, rtol=5e-3)


@pytest.mark.parametrize(
    ("circuit", "says"),
    [(lambda v: 5.0 - v, "exchange"), (lambda v: 0.0 * v, "no flight can be seen"), (lambda v: 0.6 * v + 1.0, "")],
)
def test_a_doubtful_contact_circuit_is_remarked(
    tmp_path: Path, setup: Setup, columns: Columns, circuit: Callable[..., Floats], says: str
) -> None:
    """Exchanged levels and a dead circuit are said in words; levels that are merely other ones are not."""
    columns["continuity_v"] = circuit(columns["continuity_v"])
    if says.startswith("no flight"):  # as it must be while the ball rests, not where the plate throws it
        columns |= {name: 3.0 * columns[name] for name in ("drive_v", "accelerometer_v")}
    summary = bring_in(write_csv(tmp_path / "a.csv", columns), tmp_path / "a.h5", setup)
    said = [doubt.sentence for doubt in summary.instrument.doubts if doubt.kind.startswith("contact")]
    assert len(said) == (1 if says else 0) and all(says in r for r in said)


def test_a_short_stretch_is_no_step_of_the_accelerometer(
    tmp_path: Path, setup: Setup, columns: Columns, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A still stretch below the least length is a step where the drive shows it, not where the plate alone does."""
    monkeypatch.setattr("daq.importers.import_recording.SHORTEST_PLATE_STEP_CYCLES", 8.0)
    short = np.flatnonzero(columns["time_s"] < columns["time_s"][-1])[: round(6.5 * RATE_HZ / 25.37)]
    extra = {k: v[short] for k, v in columns.items()}
    phase = 2 * np.pi * 25.37 * (columns["time_s"][-1] + 1 / RATE_HZ + extra["time_s"])
    extra["drive_v"] = 0.4 * np.sin(phase)
    extra["accelerometer_v"] = 0.2 * extra["drive_v"]
    extra["time_s"] = columns["time_s"][-1] + 1 / RATE_HZ + extra["time_s"]
    longer = {k: np.concatenate([columns[k], extra[k]]) for k in columns}
    bring_in(write_csv(tmp_path / "d.csv", longer), tmp_path / "d.h5", setup)
    del longer["drive_v"]
    bring_in(write_csv(tmp_path / "a.csv", longer), tmp_path / "a.h5", setup)
    with open_recording(tmp_path / "d.h5") as drive, open_recording(tmp_path / "a.h5") as plate:
        assert (len(drive.steps), len(plate.steps)) == (len(LEVELS) + 1, len(LEVELS))


@pytest.mark.parametrize("decimals", [3, 4, 6])
def test_rounded_times_are_uniform(tmp_path: Path, setup: Setup, columns: Columns, decimals: int) -> None:
    """A time column rounded to its last digit, even coarser than a sample, gives the exact rate and even times."""
    formats = [f"%.{decimals}f", "%.9g", "%.9g", "%.9g"]
    summary = bring_in(write_csv(tmp_path / "a.csv", columns, formats=formats), tmp_path / "a.h5", setup)
    check(tmp_path / "a.h5", columns, summary)


def test_an_odd_rate_is_found_exactly(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A clock that is 37 ppm fast is measured, not rounded to the nominal rate."""
    columns["time_s"] = columns["time_s"] / (1 + 37e-6) + 1.5e9
    summary = bring_in(write_csv(tmp_path / "a.csv", columns, formats="%.16g"), tmp_path / "a.h5", setup)
    assert summary.timebase.rate_hz == pytest.approx(RATE_HZ * (1 + 37e-6), rel=1e-7)
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.attrs["started"].startswith("2017-07-14")


def test_jitter_is_kept_and_stated(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Times that really jitter are kept as they came, and the summary says by how much."""
    jitter = np.random.default_rng(3).normal(0, 3e-5, len(columns["time_s"]))
    columns["time_s"] = columns["time_s"] + jitter
    summary = bring_in(write_csv(tmp_path / "a.csv", columns), tmp_path / "a.h5", setup)
    assert summary.timebase.jitter_s == pytest.approx(3e-5, rel=0.1)
    assert "stored as they came" in summary.remarks[0]
    with open_recording(tmp_path / "a.h5") as recording:
        stamps = columns["time_s"] - columns["time_s"][0]
        np.testing.assert_allclose(recording.timestamps_ns() * 1e-9, stamps, atol=2e-9)


def test_pauses_become_gaps(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Rows that are missing are counted and placed."""
    kept = np.r_[0:1000, 1123 : len(columns["time_s"])]
    summary = bring_in(
        write_csv(tmp_path / "a.csv", {k: v[kept] for k, v in columns.items()}), tmp_path / "a.h5", setup
    )
    assert summary.timebase.gaps[:, :2].tolist() == [[1000, 123]]
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.gaps.tolist() == [[1000, 123]]


def test_long_tables(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """One row a reading: the rows of one sensor alone, or those of several side by side."""
    with (tmp_path / "a.csv").open("w") as file:
        file.write("time_s,channel,value\n")
        for t, *row in zip(*columns.values(), strict=True):
            for name, value in zip(("contact", "plate", "loop"), row, strict=True):
                file.write(f"{t:.9g},{name},{value:.9g}\n")
    select = {"continuity": "contact", "accelerometer": "plate", "drive": "loop"}
    check(tmp_path / "a.h5", columns, bring_in(tmp_path / "a.csv", tmp_path / "a.h5", setup, select=select))
    bring_in(tmp_path / "a.csv", tmp_path / "b.h5", setup, ["accelerometer=value"], select={"": "plate"})
    with open_recording(tmp_path / "b.h5") as recording:
        np.testing.assert_allclose(recording.read_v("accelerometer"), columns["accelerometer_v"], atol=1e-8)
    with pytest.raises(InputError, match=r"no row has 'floor'.*contact, loop, plate"):
        bring_in(tmp_path / "a.csv", tmp_path / "c.h5", setup, ["accelerometer=value"], select={"": "floor"})


def test_set_values_make_the_steps(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Where the file says what was set, each change of it starts a step."""
    n = len(columns["time_s"])
    columns["set_hz"] = np.where(np.arange(n) < n // 2, 25.0, 25.5)
    bring_in(write_csv(tmp_path / "a.csv", columns), tmp_path / "a.h5", setup, ["frequency=set_hz"])
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.steps["first_sample"].tolist() == [0, n // 2]


def mess(columns: Columns, kind: str) -> str:
    """A CSV text with one fault in line 1002."""
    lines = [",".join(columns)] + [",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True)]
    fields = lines[1001].split(",")
    changed = {
        "missing value": [*fields[:2], "", fields[3]],
        "short row": fields[:3],
        "long row": [*fields, "7"],
        "text": [*fields[:2], "overload", fields[3]],
        "nan": [*fields[:2], "nan", fields[3]],
        "inf": [*fields[:3], "inf"],
        "time back": ["0.1", *fields[1:]],
    }
    lines[1001] = ",".join(changed[kind])
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("missing value", r"line 1002, column accelerometer_v: wanted a number, got ''"),
        ("short row", r"line 1002: wanted 4 columns .* got 3"),
        ("long row", r"line 1002: wanted 4 columns .* got 5"),
        ("text", r"line 1002, column accelerometer_v: wanted a number, got 'overload'"),
        ("nan", r"line 1002, column accelerometer_v: wanted a finite number"),
        ("inf", r"line 1002, column drive_v: wanted a finite number"),
        ("time back", r"line 1002, column time_s: time goes back"),
    ],
)
def test_bad_rows_are_named(tmp_path: Path, setup: Setup, columns: Columns, kind: str, says: str) -> None:
    """Each class of bad row is refused with file, line and column, and nothing is left behind."""
    (tmp_path / "a.csv").write_text(mess(columns, kind))
    with pytest.raises(InputError, match=r"a\.csv: " + says):
        bring_in(tmp_path / "a.csv", tmp_path / "a.h5", setup)
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_arrays_that_do_not_fit(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Arrays of different lengths and NaN in an array are refused with the row."""
    np.savez(tmp_path / "a.npz", **{**columns, "drive_v": columns["drive_v"][:1000]})
    with pytest.raises(InputError, match=r"different lengths .*drive_v 1000.* row 1001"):
        bring_in(tmp_path / "a.npz", tmp_path / "a.h5", setup)
    columns["accelerometer_v"][1234] = np.nan
    np.savez(tmp_path / "b.npz", **columns)
    with pytest.raises(InputError, match=r"b.npz: row 1235, column accelerometer_v"):
        bring_in(tmp_path / "b.npz", tmp_path / "b.h5", setup)
    columns["accelerometer_v"][1234] = 0.0
    columns["time_s"][500] = columns["time_s"][499]
    np.savez(tmp_path / "c.npz", **columns)
    with pytest.raises(InputError, match=r"row 501, column time_s: 0.2495 s comes twice.*the row that is there twice"):
        bring_in(tmp_path / "c.npz", tmp_path / "c.h5", setup)


def test_missing_columns_and_files(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """What is missing is named, with what there is and what to do."""
    cases = [("time_s", "--rate HZ"), ("accelerometer_v", "--map accelerometer=COLUMN")]
    for name, says in cases:
        raw = write_csv(tmp_path / "a.csv", {k: v for k, v in columns.items() if k != name})
        with pytest.raises(InputError, match=says):
            bring_in(raw, tmp_path / "a.h5", setup)
    with pytest.raises(InputError, match="no such column; it has time_s"):
        bring_in(write_csv(tmp_path / "a.csv", columns), tmp_path / "a.h5", setup, ["drive=CH 9"])
    with pytest.raises(InputError, match="no such file"):
        open_source(tmp_path / "none.csv")
    (tmp_path / "a.doc").write_text("x")
    with pytest.raises(InputError, match="wanted a file that ends in"):
        open_source(tmp_path / "a.doc")
    (tmp_path / "empty.csv").write_text("time_s,drive_v\n")
    with pytest.raises(InputError, match="no line of numbers"):
        open_source(tmp_path / "empty.csv")


def test_rate_that_contradicts_the_times(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A rate that the time column denies is refused; without a time column it is taken."""
    raw = write_csv(tmp_path / "a.csv", columns)
    with pytest.raises(InputError, match="says 2000 samples/s, not 500"):
        bring_in(raw, tmp_path / "a.h5", setup, rate_hz=500.0)
    timeless = {k: v for k, v in columns.items() if k != "time_s"}
    check(tmp_path / "a.h5", columns, bring_in(write_csv(raw, timeless), tmp_path / "a.h5", setup, rate_hz=RATE_HZ))


def test_ambiguous_and_wrong_maps(tmp_path: Path, columns: Columns) -> None:
    """Two candidates for a role, unknown roles and repeated roles are errors that say what to write."""
    raw = write_csv(tmp_path / "a.csv", {**columns, "excitation": columns["drive_v"], "command": columns["drive_v"]})
    del columns["drive_v"]
    assert assign(open_source(raw), {})["drive"].name == "drive_v"
    raw = write_csv(tmp_path / "b.csv", {**columns, "excitation": columns["time_s"], "command": columns["time_s"]})
    with pytest.raises(InputError, match="excitation, command could all be drive"):
        assign(open_source(raw), {})
    for item in ("speed=a", "drive", "drive="):
        with pytest.raises(InputError, match="roles are time, continuity"):
            parse_map([item])


def test_a_name_inside_a_folder_is_enough(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """In an HDF5 file with folders the last part of a name will do, unless two folders share it."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in zip(("CH1", "CH2", "CH3"), list(columns.values())[1:], strict=True):
            file[f"Waveforms/{name}"] = values
        file["other/CH3"] = columns["drive_v"]
    maps = ["continuity=ch1", "accelerometer=CH2", "drive=Waveforms/CH3"]
    bring_in(tmp_path / "a.h5", tmp_path / "r.h5", setup, maps, rate_hz=RATE_HZ)
    with open_recording(tmp_path / "r.h5") as recording:
        np.testing.assert_allclose(recording.read_v("drive"), columns["drive_v"])
    with pytest.raises(InputError, match="no such column"):
        bring_in(tmp_path / "a.h5", tmp_path / "q.h5", setup, [*maps[:2], "drive=CH3"], rate_hz=RATE_HZ)


def test_a_unit_in_brackets_may_be_left_out(tmp_path: Path, columns: Columns) -> None:
    """A column listed as "Log/Voltage_0 (V)" is found as it stands, without its unit, and by the last part of that."""
    names = ["Time (s)", "Log/Voltage_0 (V)", "Log/Voltage_1 (m/s^2)", "Log/Voltage_2"]
    source = open_source(write_csv(tmp_path / "a.csv", dict(zip(names, columns.values(), strict=True))))
    maps = ["time=time", "continuity=Log/Voltage_0", "accelerometer=voltage_1", "drive=Voltage_2"]
    found = assign(source, parse_map(maps))
    assert [found[role].name for role in ("time", "continuity", "accelerometer", "drive")] == names


def test_names_carry_units() -> None:
    """The unit at the end of a name, after an underscore or in brackets, is understood."""
    assert split_name("time_s") == ("time", "s")
    assert split_name("Time (ms)") == ("time", "ms")
    assert split_name("run1/Drive [mV]") == ("drive", "mv")
    assert split_name("Drive_Amp") == ("driveamp", "")


@pytest.mark.parametrize("kind", ["csv", "csv.gz", "npz"])
def test_export_comes_back(tmp_path: Path, setup: Setup, columns: Columns, kind: str) -> None:
    """What is exported can be imported again: the same codes, times and steps."""
    names = ["continuity_v", "accelerometer_v", "drive_v"]
    codes = np.rint(np.column_stack([columns[n] for n in names]) / 10 * 32768).astype(np.int16)
    wavfile.write(tmp_path / "a.wav", int(RATE_HZ), codes)
    bring_in(tmp_path / "a.wav", tmp_path / "a.h5", setup)
    with open_recording(tmp_path / "a.h5") as first:
        export(first, tmp_path / f"b.{kind}", "npz" if kind == "npz" else "csv")
        bring_in(tmp_path / f"b.{kind}", tmp_path / "b.h5", setup)
        with open_recording(tmp_path / "b.h5") as second:
            for name in first.channels:
                back = np.rint(second.read_v(name) / (10 / 32768))
                np.testing.assert_array_equal(back, first.codes(name))
            np.testing.assert_array_equal(first.timestamps_ns(), second.timestamps_ns())
            for field in ("first_sample", "n_samples"):
                np.testing.assert_array_equal(first.steps[field], second.steps[field])
        with pytest.raises(InputError, match="never overwritten"):
            export(first, tmp_path / f"b.{kind}", "csv")


def test_gzip_export_is_the_recording(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """The HDF5 export is the same recording for readers without the LZ4 plugin."""
    bring_in(write_csv(tmp_path / "a.csv", columns), tmp_path / "a.h5", setup)
    with open_recording(tmp_path / "a.h5") as first:
        export(first, tmp_path / "b.h5", "h5")
        with open_recording(tmp_path / "b.h5") as second:
            assert first.setup == second.setup
            for name in first.channels:
                np.testing.assert_array_equal(first.codes(name), second.codes(name))
            np.testing.assert_array_equal(first.steps, second.steps)
    assert verify(tmp_path / "b.h5").state == "complete"
    with h5py.File(tmp_path / "b.h5") as file:
        assert file["drive"].compression == "gzip"


@pytest.mark.data
def test_a_real_shaker(tmp_path: Path, setup: Setup) -> None:
    """Three accelerometers of somebody's shaker under amplitude control: frequencies as set, to a part in 300."""
    folder = Path(os.environ.get("BOUNCE_DATA", Path(__file__).parents[4] / "shared" / "data")) / "shaker"
    if not folder.is_dir():
        pytest.skip(f"other people's measurements are not at {folder}; set BOUNCE_DATA")
    slow = setup.model_copy(update={"forcing": setup.forcing.model_copy(update={"frequency_hz": 40.0})})
    for i, raw in enumerate(sorted(folder.glob("os_*.csv"))):
        for sensor in ("0", "2"):
            out = tmp_path / f"{i}_{sensor}.h5"
            summary = bring_in(raw, out, slow, ["accelerometer=Z:g", "frequency=Freq"], select={"": sensor})
            assert 860 < summary.timebase.rate_hz < 866
            table = np.loadtxt(raw, delimiter=",", skiprows=1)
            own = table[table[:, 3] == float(sensor)]
            set_hz = own[np.flatnonzero(np.diff(own[:, 1], prepend=0.0)), 1]
            np.testing.assert_allclose(summary.steps["frequency_hz"], set_hz, rtol=1 / 300)
            with open_recording(out) as recording:
                np.testing.assert_array_equal(recording.read_v("accelerometer"), own[:, 6])
