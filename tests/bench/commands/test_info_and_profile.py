"""`bench info` and `bench profile`: what a recording is, and where a profile comes from."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from click.testing import Result
from typer.testing import CliRunner

from bench.cli import app
from bench.profiles.find import load, shipped_folder
from bench.profiles.improved import OF_A_CARD, UNKNOWN_ZERO

ROOT = Path(__file__).parents[3]


def bench(*arguments: object) -> Result:
    """Run the command line."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two steps with a note and keys."""
    folder = tmp_path_factory.mktemp("run")
    text = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
    text = text.replace("gamma = { start = 0.4, stop = 2.6, steps = 23 }", "gamma = [0.3, 0.4]")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    call = ("ramp", folder / "rig.toml", "--out", folder / "run.h5", "--note", "first light × Ж", "--set", "knob=3")
    result = bench(*call, "--set", "room=B12", "--scenario", "ideal")
    assert result.exit_code == 0, result.output
    return folder / "run.h5"


def test_info_shows_note_keys_profile_steps_and_verdict(run: Path) -> None:
    """Everything that was said of a run can be read back, by a person and by a machine."""
    result = bench("info", run)
    assert result.exit_code == 0, result.output
    for part in (
        "complete",
        "first light × Ж",
        "knob = 3, room = B12",
        "simulated: 25.37 Hz, c = 1",
        "samples",
        "0 lost",
    ):
        assert part in result.stdout
    told = json.loads(bench("info", run, "--json", "-").stdout)
    assert (told["state"], told["note"], told["keys"]) == ("complete", "first light × Ж", {"knob": 3.0, "room": "B12"})
    assert [step["gamma"] for step in told["steps"]] == [0.3, 0.4]
    assert told["profile"]["name"] == "simulated" and told["simulated"] is True


def test_info_of_a_damaged_recording(run: Path, tmp_path: Path) -> None:
    """A recording whose setup does not fit is called damaged in one line, without a library's dump, with status 1."""
    path = tmp_path / "bad.h5"
    shutil.copy(run, path)
    with h5py.File(path, "r+") as file:
        file.attrs["setup_json"] = file.attrs["setup_json"].replace('"frequency_hz":25.37', '"frequency_hz":"fast"')
    result = bench("info", path)
    assert result.exit_code == 1 and "damaged" in result.stdout
    assert "setup_json, forcing.frequency_hz: Input should be a valid number" in result.stdout
    assert "pydantic" not in result.output
    result = bench("reprocess", path)
    assert result.exit_code == 2 and result.stderr.count("\n") == 1 and "pydantic" not in result.stderr


def test_info_of_something_else(tmp_path: Path) -> None:
    """What is no recording is a wrong call."""
    (tmp_path / "x.csv").write_text("a,b\n", encoding="utf-8")
    assert bench("info", tmp_path / "x.csv").exit_code == 2
    assert bench("info", tmp_path / "none.h5").exit_code == 2


def test_profile_list_show_and_new(run: Path, tmp_path: Path) -> None:
    """The shipped profiles are listed, any profile's text is shown, and a new one is like the old but for its name."""
    result = bench("profile", "list")
    assert result.exit_code == 0 and "soundcard" in result.stdout and "scenarios: " in result.stdout
    listed = json.loads(bench("profile", "list", "--json", "-").stdout)
    assert {"name": "c2", "backend": "simulated", "frequency_hz": 25.37, "tone_ratio": 2}.items() <= listed["profiles"][
        0
    ].items()
    for like in ("soundcard", str(run.with_name("rig.toml")), str(run)):
        mine = tmp_path / f"my_{Path(like).suffix[1:]}.toml"
        result = bench("profile", "new", mine, "--like", like)
        assert result.exit_code == 0, result.output
        shown = bench("profile", "show", like).stdout
        wanted = re.sub(r"(?m)^name = .*$", f'name = "{mine.stem}"', shown, count=1)
        if like == "soundcard":  # the zero of another sensor is not known of this one
            wanted = re.sub(r"(?m)^offset_v = .*$", UNKNOWN_ZERO, wanted)
            for key, value in OF_A_CARD.items():
                wanted = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", wanted)
            channels = load(mine)[0].channels
            assert channels.accelerometer.offset_v is None and channels.continuity is not None
            assert (channels.continuity.coupling, channels.accelerometer.coupling) == ("ac", "ac")
            assert channels.continuity.range_v == channels.accelerometer.range_v == 2.0
            assert bench("plan", mine).exit_code == 0
        assert mine.read_text(encoding="utf-8") == wanted
        assert load(mine)[0].name == mine.stem
    assert bench("profile", "show", "nothing").exit_code == 2


def test_an_export_is_replaced_only_when_told(run: Path, tmp_path: Path) -> None:
    """--overwrite replaces an exported file of each form, and leaves nothing beside it."""
    for name in ("x.csv", "x.npz", "x.h5"):
        out = tmp_path / name
        out.write_bytes(b"old")
        assert bench("export", run, "--out", out).exit_code == 2 and out.read_bytes() == b"old"
        assert bench("export", run, "--out", out, "--overwrite").exit_code == 0
        assert out.stat().st_size > 1000
    assert len(list(tmp_path.iterdir())) == 6  # each with its notebook
    assert bench("export", run, "--out", tmp_path / "y.npz", "--to", "csv").exit_code == 2


def test_the_documented_lines_of_xarray_work_as_written(run: Path) -> None:
    """What docs/reference/recording-format.md tells to type is typed into a Python that has imported nothing else."""
    page = (ROOT / "docs" / "reference" / "recording-format.md").read_text(encoding="utf-8")
    lines = [line.strip() for line in page.splitlines() if line.startswith("    ") and "xarray" in line]
    assert len(lines) == 3
    code = "\n".join([lines[0], f"print({lines[1].partition('#')[0]})", f"print({lines[2].partition('#')[0]})"])
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], cwd=run.parent, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "accelerometer" in done.stdout and "achieved_gamma" in done.stdout


def test_a_diagram_is_continued_another_file_is_not(tmp_path: Path) -> None:
    """`bench predict --out` goes on with its own diagram, refuses another's file, and starts anew when told."""
    out = tmp_path / "d.h5"
    call = ("predict", "--gamma-range", "0.4", "0.6", "--steps", "5", "--out", out)
    assert bench(*call).exit_code == 0 and bench(*call).exit_code == 0
    other = bench(*call[:5], "6", *call[6:])
    assert other.exit_code == 2 and "another job" in other.stderr
    assert bench(*call[:5], "6", *call[6:], "--overwrite").exit_code == 0
    out.write_bytes(b"no HDF5")
    refused = bench(*call)
    assert refused.exit_code == 2 and "exists already" in refused.stderr and out.read_bytes() == b"no HDF5"
