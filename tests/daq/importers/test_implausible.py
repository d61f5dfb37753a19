"""What no rig can have measured is refused or said: rates, times, volts, exchanged channels, one run twice."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.importers.formats.columns import parse_map
from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, ImportSummary, import_recording
from daq.importers.text.csv import CsvSource
from daq.recording import open_recording
from daq.recording.header import refuse_repeated
from daq.setup.errors import InputError
from daq.setup.setup import Forcing, Setup
from daq.setup.values import Frozen, load_toml
from kernels.arrays import Floats

RATE_HZ = 2000.0
LEVELS = [0.2, 0.5, 0.3]
Columns = dict[str, Floats]


def write_csv(path: Path, columns: Columns, delimiter: str = ",") -> Path:
    """A CSV with a header."""
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, "%.12g", delimiter, header=delimiter.join(columns), comments="")
    return path


def bring_in(raw: Path, setup: Setup, maps: tuple[str, ...] = (), **options: float) -> ImportSummary:
    """Import next to the raw file."""
    out = raw.with_suffix(".h5")
    return import_recording(open_source(raw), out, setup, "", ImportOptions(parse_map(maps), **options))


@pytest.mark.parametrize("rate_hz", [-5.0, 0.0, float("nan"), float("inf"), 1e12, 1e-300])
def test_a_rate_that_is_none(tmp_path: Path, setup: Setup, columns: Columns, rate_hz: float) -> None:
    """A sample rate must be a number of samples a second; nothing is written otherwise."""
    del columns["time_s"]
    with pytest.raises(InputError, match="wanted samples a second"):
        bring_in(write_csv(tmp_path / "a.csv", columns), setup, rate_hz=rate_hz)
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: 0.0 * t + 3.0, "column time_s stands still: all 6005 rows are at 3 s"),
        (lambda t: 1e3 * t, r"gives 2 samples/s, profile 'test' says 2000; is it in ms \(--map time=time_s:ms\)"),
        (lambda t: 1e9 * t, r"is it in ns"),
        (lambda t: 1e300 * t, r"line 3, column time_s: .* is more than 285 years from the first row"),
        (lambda t: np.cumsum(np.where(t < 1.5, 1 / 2000, 1 / 4000)), r"mixed rates: 2000 .* before row 3\d+ .* 4000"),
        (lambda t: np.cumsum(np.where(t < 1.5, 1 / 4000, 1 / 2000)), r"mixed rates: 4000 .* before row 3\d+ .* 2000"),
    ],
)
def test_times_that_cannot_be(
    tmp_path: Path, setup: Setup, columns: Columns, change: Callable[..., Floats], says: str
) -> None:
    """Constant times, another unit, more than a lifetime and mixed rates are refused with what to do."""
    columns["time_s"] = change(columns["time_s"])
    with pytest.raises(InputError, match=says):
        bring_in(write_csv(tmp_path / "a.csv", columns), setup)
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_a_stated_unit_is_believed(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """What an error about the unit of time asks for is taken."""
    columns["time_s"] *= 1e3
    summary = bring_in(write_csv(tmp_path / "a.csv", columns), setup, ("time=time_s:ms",))
    assert summary.timebase.rate_hz == pytest.approx(RATE_HZ)
    assert summary.remarks == []


def test_another_rate_and_another_frequency_are_told(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Times stretched by a third are said twice: by the sample rate, and by the frequency of the steps."""
    columns["time_s"] *= 4.0 / 3.0
    said = bring_in(write_csv(tmp_path / "a.csv", columns), setup).remarks
    assert any("1500 samples/s, where profile 'test' says 2000" in s for s in said)
    assert any("the steps are at 19.0" in s and "25.37" in s for s in said)


def test_counts_of_a_converter_are_no_volts(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Whole numbers of 16 bits are refused, with what they may be."""
    counts = {k: v if k == "time_s" else np.rint(3276.8 * v) for k, v in columns.items()}
    with pytest.raises(InputError, match="whole numbers may be a converter's counts: write volts"):
        bring_in(write_csv(tmp_path / "a.csv", counts), setup)


@pytest.mark.parametrize("factor", [1e6, 1e305])
def test_volts_far_outside_the_range(tmp_path: Path, setup: Setup, columns: Columns, factor: float) -> None:
    """A plate at a million g is refused, with the first row and what may be wrong."""
    columns["accelerometer_v"] *= factor
    with pytest.raises(InputError, match=r"line 2, column accelerometer_v: .* far outside the range .*:mV"):
        bring_in(write_csv(tmp_path / "a.csv", columns), setup)


def test_volts_a_little_outside_the_range_are_told(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A channel that reads more than its range is imported, and that is said."""
    columns["continuity_v"] *= 3.0
    said = bring_in(write_csv(tmp_path / "a.csv", columns), setup).remarks
    assert any("the continuity reads up to 15.1 V; profile 'test' says range_v = 10" in s for s in said)


def test_exchanged_channels_are_told(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Accelerometer and drive the wrong way round: both gammas are said, and that exchanged they would agree."""
    columns["accelerometer_v"], columns["drive_v"] = columns["drive_v"], columns["accelerometer_v"]
    (doubt,) = bring_in(write_csv(tmp_path / "a.csv", columns), setup).instrument.doubts
    assert doubt.kind == "exchanged" and doubt.makes_meaningless
    assert "asks for gamma 0.06, the accelerometer shows 1.5" in doubt.finding
    assert "exchange the columns of accelerometer and drive" in doubt.cure


@pytest.mark.parametrize("known", [True, False])
def test_a_dead_accelerometer_is_called_dead(tmp_path: Path, setup: Setup, columns: Columns, known: bool) -> None:
    """Noise without motion is a dead accelerometer, not exchanged levels, whether or not the drive's scale is known."""
    columns["accelerometer_v"] = np.random.default_rng(0).normal(0, 1e-3, len(columns["drive_v"]))
    columns["continuity_v"] = 5.0 - columns["continuity_v"]
    if not known:
        setup = setup.model_copy(update={"drive": setup.drive.model_copy(update={"g_per_volt": None})})
    (doubt,) = bring_in(write_csv(tmp_path / "a.csv", columns), setup).instrument.doubts
    assert doubt.kind == "dead" and "it is dead, unplugged" in doubt.finding


def test_many_pauses_are_one_remark(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A hundred pauses are said in one sentence, with their number, their sum, the first and the longest."""
    kept = np.ones(len(columns["time_s"]), bool)
    kept[50::60] = kept[51::60] = kept[1252] = False
    said = bring_in(write_csv(tmp_path / "a.csv", {k: v[kept] for k, v in columns.items()}), setup).remarks
    (pauses,) = [s for s in said if "pause" in s]
    assert pauses.startswith("100 pauses, 201 samples missing in all; the first before sample 50, the longest (3 ")


def test_decimal_commas_wherever_they_first_come(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Semicolons with decimal commas are understood although the first rows, or the first 300, hold whole numbers."""
    lines = write_csv(tmp_path / "a.csv", columns, ";").read_text().replace(".", ",").splitlines()
    (tmp_path / "b.csv").write_text("\n".join([lines[0], "0;0;0;0", *lines[2:]]))
    bring_in(tmp_path / "b.csv", setup)
    whole = "\n".join(f"{i};{i};{i};{i}" for i in range(300))
    (tmp_path / "c.csv").write_text(f"a;b;c;d\n{whole}\n300,5;1,5;2;3\n")
    pieces = list(open_source(tmp_path / "c.csv").pieces(["a", "b"]))
    assert pieces[-1].columns["a"][-1] == 300.5 and pieces[-1].columns["b"][-1] == 1.5
    (tmp_path / "d.csv").write_text("a;b\n1.5;2\n1,5;2\n")
    with pytest.raises(InputError, match="line 3, column a: wanted a number, got '1,5'"):
        list(open_source(tmp_path / "d.csv").pieces(["a", "b"]))
    (tmp_path / "e.csv").write_text("a;b;c\n3,2;1,5;0\n3,3;0;0\n3,4;0;0\n")
    (piece,) = open_source(tmp_path / "e.csv").pieces(["a"])
    np.testing.assert_array_equal(piece.columns["a"], [3.2, 3.3, 3.4])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_editors_of_every_kind(tmp_path: Path, columns: Columns, encoding: str, ending: str) -> None:
    """UTF-8 with a byte-order mark, UTF-16 of both orders and every line end give the same numbers."""
    text = write_csv(tmp_path / "a.csv", columns).read_text()
    mark = "\ufeff" if encoding.endswith("e") and "16" in encoding else ""
    (tmp_path / "b.csv").write_bytes((mark + text).replace("\n", ending).encode(encoding))
    one, two = (list(open_source(tmp_path / name).pieces(["drive_v"])) for name in ("a.csv", "b.csv"))
    values = [np.concatenate([p.columns["drive_v"] for p in pieces]) for pieces in (one, two)]
    np.testing.assert_array_equal(*values)
    assert [p.place(0) for p in one[:1]] == [p.place(0) for p in two[:1]] == ["line 2"]


def test_matlab_7_3_under_its_own_name(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A file of MATLAB 7.3 needs no other ending; its vectors and its matrices lie column by column."""
    raw = tmp_path / "a.mat"
    with h5py.File(raw, "w", userblock_size=512) as file:
        for name in ("time_s", "continuity_v"):
            file[name] = columns[name][None, :]
        file["plate"] = np.stack([columns["accelerometer_v"], columns["drive_v"]])
        file["#refs#/a"] = np.arange(9.0)
    body = bytearray(raw.read_bytes())
    body[:20] = b"MATLAB 7.3 MAT-file,"
    raw.write_bytes(body)
    bring_in(raw, setup, ("accelerometer=plate[0]", "drive=plate[1]"))
    with open_recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording.read_v("drive"), columns["drive_v"])
        np.testing.assert_array_equal(recording.read_v("continuity"), columns["continuity_v"])


def test_numbers_are_read_to_the_last_bit(tmp_path: Path) -> None:
    """Text becomes the double that Python makes of it, in every form of a number."""
    rng = np.random.default_rng(1)
    forms = ("{:.17g}", "{:.9g}", "{:.19g}", "{:.15e}", "{!r}", "{:+.6f}")
    sizes = [int(rng.integers(-30, 30 if i % 6 < 5 else 3)) for i in range(9000)]
    words = [forms[i % 6].format(float(rng.normal() * 10.0**size)) for i, size in enumerate(sizes)]
    odd_ones = rng.integers(2**53, 2**60, 3000) | 1
    words += [f"{m}e{e}" for m, e in zip(odd_ones.tolist(), rng.integers(-30, 30, 3000).tolist(), strict=True)]
    words += ["0", "-0.0", ".5", "5.", "00000000000000000000001.5", "0.000000000000000000000123", "1E-5", " +2 "]
    path = tmp_path / "a.csv"
    path.write_text("a,b,c\n" + "".join(f"7,{w},8\n" for w in words))
    piece = next(CsvSource(path, {}).pieces(["b", "c"]))
    assert piece.rows.tolist() == list(range(2, len(words) + 2))
    np.testing.assert_array_equal(piece.columns["b"].view(np.int64), np.array([*map(float, words)]).view(np.int64))


@pytest.mark.parametrize("word", ["", "-", ".", "1e", "e5", "1_0", "1.2.3", "1 2", "0x10", "\u0663"])
def test_what_is_no_number_is_refused_by_its_line(tmp_path: Path, word: str) -> None:
    """A cell that Python would not read, or would guess at, is named with its line of the file and its column."""
    path = tmp_path / "a.csv"
    path.write_text(f"a,b,c\n1,2,3\n\n# 4,5,6\n7,8,9\n7,{word},8\n", encoding="utf-8")
    with pytest.raises(InputError, match=rf"line 6, column b: wanted a number, got {re.escape(repr(word))}"):
        list(CsvSource(path, {}).pieces(["a", "b"]))


def test_a_run_counts_once(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """One file twice, a link, a copy, and a second import of the same raw file are refused; another run is not."""
    raw = write_csv(tmp_path / "a.csv", columns)
    bring_in(raw, setup)
    one = tmp_path / "a.h5"
    write_csv(tmp_path / "b.csv", columns)
    bring_in(tmp_path / "b.csv", setup.model_copy(update={"name": "other"}))
    (tmp_path / "copy.h5").write_bytes(one.read_bytes())
    os.link(one, tmp_path / "link.h5")
    with pytest.raises(InputError, match="are one file"):
        refuse_repeated([one, one])
    with pytest.raises(InputError, match="are one file"):
        refuse_repeated([one, tmp_path / "link.h5"])
    for twin in ("copy.h5", "b.h5"):
        with pytest.raises(InputError, match="hold the same samples"):
            refuse_repeated([one, tmp_path / twin])
    columns["drive_v"][100] += 1e-9
    write_csv(tmp_path / "c.csv", columns)
    bring_in(tmp_path / "c.csv", setup)
    refuse_repeated([one, tmp_path / "c.h5"])


def test_odd_numbers_of_an_archive(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """Long doubles, half floats and unsigned times beyond a calendar's end come in as numbers."""
    given = {k: np.asarray(v, np.longdouble) for k, v in columns.items()}
    np.savez(tmp_path / "a.npz", **given)
    assert bring_in(tmp_path / "a.npz", setup).timebase.rate_hz == pytest.approx(RATE_HZ)
    given = {k: np.asarray(v, np.float16) for k, v in columns.items()}
    given["time_s"] = np.rint(columns["time_s"] * 1e6).astype(np.uint64) + np.uint64(1 << 62)
    np.savez(tmp_path / "b.npz", **given)
    assert bring_in(tmp_path / "b.npz", setup, ("time=time_s:us",)).timebase.rate_hz == pytest.approx(RATE_HZ)


def test_a_set_frequency_that_cannot_be(tmp_path: Path, setup: Setup, columns: Columns) -> None:
    """A set frequency above half the sample rate is refused, and a rate that leaves no cycle finds no step."""
    columns["set_hz"] = np.where(columns["time_s"] < 1.0, 25.0, 1e308)
    raw = write_csv(tmp_path / "a.csv", columns)
    with pytest.raises(InputError, match=r"set frequency 1e.308 from sample 2000 on"):
        bring_in(raw, setup, ("frequency=set_hz",))
    del columns["time_s"]
    assert not len(bring_in(write_csv(raw, columns), setup, rate_hz=1e7).steps)


def test_profiles_from_every_editor(tmp_path: Path) -> None:
    """A profile with a byte-order mark, or in UTF-16, is the same profile."""
    text = "[forcing]\nfrequency_hz = 25.0\n"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        (tmp_path / "p.toml").write_text(text, encoding=encoding, newline="\r\n")
        assert load_toml(tmp_path / "p.toml", Outer)[0].forcing.frequency_hz == 25.0


class Outer(Frozen):
    """A profile with nothing but the forcing."""

    forcing: Forcing
