"""The commands import, export and verify, as a person calls them."""

from __future__ import annotations

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from bench.cli import app

PROFILE = """
name = "somebody's rig"
[sampling]
rate_hz = 2000
[forcing]
frequency_hz = 25.37
[drive]
g_per_volt = 2.0
[channels.accelerometer]
sensitivity = 0.1
unit = "V/g"
[ball]
mass_kg = 0.25
"""


def bench(*arguments: object) -> Result:
    """Run the command line."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    """A CSV of two steps, beside a profile."""
    (tmp_path / "p.toml").write_text(PROFILE)
    t = np.arange(8000) / 2000.0
    drive = np.sin(2 * np.pi * 25.37 * t) * np.where(t < 2, 0.3, 0.6)
    table = np.column_stack([t, np.zeros_like(t), 0.2 * drive, drive])
    header = "time_s,continuity_v,accelerometer_v,drive_v"
    np.savetxt(tmp_path / "raw.csv", table, "%.9g", ",", header=header, comments="")
    return tmp_path / "raw.csv"


def test_import_verify_export(raw: Path, tmp_path: Path) -> None:
    """The three commands work together, print for a person, and write the same as JSON."""
    profile = ("--profile", tmp_path / "p.toml")
    result = bench("import", raw, *profile, "--out", tmp_path / "r.h5", "--json", tmp_path / "i.json")
    assert result.exit_code == 0, result.output
    assert "2 steps" in result.output
    summary = json.loads((tmp_path / "i.json").read_text())
    assert [round(step["gamma"], 3) for step in summary["steps"]] == [0.3, 0.6]
    result = bench("verify", tmp_path / "r.h5", "--json", "-")
    assert (result.exit_code, json.loads(result.stdout)["state"]) == (0, "complete")
    for name in ("x.csv", "x.npz", "x.hdf5", "x.csv.gz"):
        assert bench("export", tmp_path / "r.h5", "--out", tmp_path / name).exit_code == 0
    again = bench("import", tmp_path / "x.csv", *profile, "--out", tmp_path / "s.h5", "--json", "-")
    assert json.loads(again.stdout)["steps"] == summary["steps"]


def test_wrong_calls_leave_with_two(raw: Path, tmp_path: Path) -> None:
    """Bad input, bad options and names already taken: status 2, one line that says what to do, no file."""
    profile, out = ("--profile", tmp_path / "p.toml"), ("--out", tmp_path / "r.h5")
    cases = [
        (("import", tmp_path / "none.csv", *profile, *out), "no such file"),
        (("import", raw, "--profile", tmp_path / "none.toml", *out), "none.toml"),
        (("import", raw, *profile, *out, "--map", "speed=a"), "roles are time"),
        (("import", raw, *profile, *out, "--channel", "0"), "needs a column called channel or sensor"),
        (("import", raw, *profile, "--out", raw), "never overwritten"),
        (("verify", raw), "cannot be read as HDF5"),
        (("verify", tmp_path / "none.h5"), "no such file"),
        (("export", raw, "--out", tmp_path / "x.csv"), "cannot be read as HDF5"),
        (("export", raw, "--out", tmp_path / "x.doc"), "wanted --to csv, npz, h5"),
    ]
    for call, says in cases:
        result = bench(*call)
        assert result.exit_code == 2, call
        assert says in result.output
        assert "Traceback" not in result.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["p.toml", "raw.csv"]


def test_damage_leaves_with_one(raw: Path, tmp_path: Path) -> None:
    """A damaged recording is reported with status 1 and the place."""
    bench("import", raw, "--profile", tmp_path / "p.toml", "--out", tmp_path / "r.h5")
    content = bytearray((tmp_path / "r.h5").read_bytes())
    middle = len(content) // 2
    content[middle : middle + 40] = bytes(40)
    (tmp_path / "r.h5").write_bytes(content)
    result = bench("verify", tmp_path / "r.h5")
    assert result.exit_code == 1
    assert result.output.startswith("damaged")


def test_names_that_look_like_markup(raw: Path, tmp_path: Path) -> None:
    """Column names with markup and control characters are printed, not obeyed."""
    text = raw.read_text().replace("drive_v", "[/red]\x1b[2J:smile:")
    raw.write_text(text)
    options = ("--profile", tmp_path / "p.toml", "--out", tmp_path / "r.h5", "--map", "drive=4")
    result = bench("import", raw, *options)
    assert result.exit_code == 0, result.output
    assert "drive from [/red]?[2J:smile:" in result.output


def test_a_recording_shorter_than_a_cycle(raw: Path, tmp_path: Path) -> None:
    """Ten rows are refused by reprocess and compare in one sentence; three hundred without a step are not."""
    lines = raw.read_text().splitlines()
    for n, code in ((10, 2), (300, 0)):
        (tmp_path / f"{n}.csv").write_text("\n".join([lines[0], *lines[1 : n + 1]]) + "\n")
        recording = tmp_path / f"{n}.h5"
        bench("import", tmp_path / f"{n}.csv", "--profile", tmp_path / "p.toml", "--out", recording)
        for command in ("reprocess", "compare"):
            result = bench(command, recording)
            assert result.exit_code == code, result.output
            assert ("wanted at least 79 samples" in result.output) == (code == 2)


def test_doubts_reach_reprocess_and_compare(raw: Path, tmp_path: Path) -> None:
    """Exchanged channels are told by every command that reads the recording, and in its JSON."""
    raw.write_text(raw.read_text().replace("accelerometer_v,drive_v", "drive_v,accelerometer_v"))
    bench("import", raw, "--profile", tmp_path / "p.toml", "--out", tmp_path / "r.h5")
    for command in ("reprocess", "compare"):
        assert "exchange the columns of accelerometer and drive" in bench(command, tmp_path / "r.h5").output.replace(
            "\n", " "
        )
        (said,) = json.loads(bench(command, tmp_path / "r.h5", "--json", "-").stdout)["warnings"]
        assert "exchanged they would agree" in said


def test_one_run_given_twice(raw: Path, tmp_path: Path) -> None:
    """The loop is not closed on the same recording twice."""
    bench("import", raw, "--profile", tmp_path / "p.toml", "--out", tmp_path / "r.h5")
    result = bench("close-loop", tmp_path / "r.h5", tmp_path / "r.h5")
    assert result.exit_code == 2
    assert "are one file" in result.output


def test_columns_that_are_not_imported_are_told_in_one_line(raw: Path, tmp_path: Path) -> None:
    """What an HDF5 file holds beside sound columns and cannot be one: a note says which, and why."""
    table = np.loadtxt(raw, delimiter=",", skiprows=1)
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        for name, values in zip(("time_s", "continuity_v", "accelerometer_v", "drive_v"), table.T, strict=True):
            file[name] = values
        file["spectrum"], file["remarks"] = table[:, 3] + 1j, ["warm", "cold"]
        file["log"] = np.zeros(9, [("place", "S8"), ("level", "f8")])
        file["cube"], file["map"], file["wide"] = np.zeros((2, 3, 4)), np.zeros((90, 70)), np.zeros(3, "V5000")
        file.create_virtual_dataset("view", h5py.VirtualLayout((4,), "f8"))
    result = bench("import", tmp_path / "raw.h5", "--profile", tmp_path / "p.toml", "--out", tmp_path / "r.h5")
    assert result.exit_code == 0, result.output
    (line,) = [line for line in result.output.split("\n") if "not imported" in line]
    why = (
        "cube (3 dimensions), log/place (text), map (70 columns, at most 64 are read), remarks (text or lists), "
        "spectrum (complex numbers), view (stored in another file), wide (rows of 5000 bytes, at most 4096 are read)"
    )
    assert line == f"note: not imported: {why}"
