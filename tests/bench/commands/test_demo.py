"""The demo: what it refuses, and what a failed one leaves behind."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rig.backends.soundcard
from analysis.loop.result import ClosedLoop
from bench.cli import app
from bench.commands import demo
from bench.profiles.find import load
from rig.sim.scenario import left_open, pool, sealed_scenario
from tests.loops import changed


def test_no_device_is_driven(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A profile of a sound card is refused by name, nothing is opened and no folder is left."""
    monkeypatch.setattr(rig.backends.soundcard, "SoundcardBackend", lambda *a, **k: pytest.fail("opened the card"))
    result = CliRunner().invoke(app, ["demo", "--profile", "soundcard", "--out", str(tmp_path / "new")])
    assert result.exit_code == 2
    assert "drives no device" in result.output and "bench ramp" in result.output
    assert not (tmp_path / "new").exists()


def test_a_wrong_call_leaves_no_folder(tmp_path: Path) -> None:
    """A scenario that is not there is refused before anything is made."""
    result = CliRunner().invoke(app, ["demo", "--scenario", str(tmp_path / "no.toml"), "--out", str(tmp_path / "new")])
    assert result.exit_code == 2
    assert not (tmp_path / "new").exists()


def test_a_failed_demo_does_not_block_the_next(
    closed_loop: ClosedLoop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a failed run left is told and kept; the same call starts anew, and a foreign file in the folder stays."""
    folder = tmp_path / "demo"
    recording = folder / "recording.h5"

    def fails(*_: object) -> Path:
        recording.write_text("half a run", encoding="utf-8")
        raise OSError("no space left on device")

    monkeypatch.setattr(demo, "_drive", fails)
    call = ["demo", "--out", str(folder)]
    first = CliRunner().invoke(app, call)
    assert first.exit_code == 1 and "no space left" in first.output and str(folder) in first.output
    (folder / "mine.txt").write_text("mine", encoding="utf-8")
    seen: list[bool] = []

    def works(*_: object) -> Path:
        seen.append(recording.exists())
        return recording

    loop = changed(closed_loop, verdict="nothing_missing", effects=())
    monkeypatch.setattr(demo, "_drive", works)
    monkeypatch.setattr(demo, "_reprocess", lambda *a: None)
    monkeypatch.setattr(demo, "_close", lambda *a: (loop, True))
    second = CliRunner().invoke(app, call)
    assert second.exit_code == 0, second.output
    assert "an ordinary instrument" in second.output and "may name as well: accelerometer behind" in second.output
    assert seen == [False] and (folder / "mine.txt").is_file()
    assert not (folder / demo.UNFINISHED).exists()


def test_an_instrument_changes_nothing_of_what_a_seed_hides() -> None:
    """The sealed effect of a seed is that of a rig without an instrument; another seed has another instrument."""
    profile = load("simulated")[0]
    drawn = [demo._sealed(seed, profile) for seed in (4, 5)]
    plain = sealed_scenario(
        np.random.default_rng(4), pool("named"), strength="strong", allowed=left_open(profile.setup())
    )
    assert drawn[0].effects == plain.effects and drawn[0].nonce == plain.nonce
    assert drawn[0].rig["low_pass_hz"] != drawn[1].rig["low_pass_hz"] and not plain.rig


def test_a_finished_demo_is_never_overwritten(tmp_path: Path) -> None:
    """A folder that holds anything but an unfinished demo is refused."""
    (tmp_path / "recording.h5").write_text("a run", encoding="utf-8")
    result = CliRunner().invoke(app, ["demo", "--out", str(tmp_path)])
    assert result.exit_code == 2 and "exists already" in result.output
    assert (tmp_path / "recording.h5").read_text(encoding="utf-8") == "a run"
