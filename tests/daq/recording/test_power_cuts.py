"""Losses of power: what was said to be on the disk is there, whatever part of the later writes came through."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

import numpy as np
import pytest

from benchmarks.daq import power_cuts
from daq.files.disk import Journal, write_whole
from daq.recording import CHANNELS, Block
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup

posix = pytest.mark.skipif(os.name != "posix", reason="folders are synced on POSIX systems only")


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is synced from now on: ``folder`` or ``file``, in order."""
    kinds: list[str] = []

    def fsync(descriptor: int) -> None:
        kinds.append("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file")

    monkeypatch.setattr(os, "fsync", fsync)
    return kinds


@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace on this machine")
def test_every_acknowledged_step_survives(tmp_path: Path) -> None:
    """Of 400 losses of power none loses an acknowledged step; no synced byte of it is changed (10^6: benchmarks)."""
    (tmp_path / "disk").mkdir()
    run = power_cuts.SHAPES["short"]
    log = power_cuts.log_of(tmp_path / "disk", run)
    counts = power_cuts.score(log, run, 400, 3, np.random.default_rng(1))
    assert counts["faults"] == 0, counts
    assert counts["acknowledged steps"] > 400
    assert power_cuts.bytes_overwritten(log)[1] == 0


@posix
def test_a_new_run_has_a_name_before_its_first_step(tmp_path: Path, setup: Setup, synced: list[str]) -> None:
    """The folder is synced when the file was made: the step that is synced later is not in a file without a name."""
    writer = RecordingWriter(tmp_path / "a.h5", setup, profile_text="", channels=CHANNELS, backend="s", simulated=True)
    assert synced == ["folder"]
    writer.append(Block(0, np.zeros((50, 3), np.int16)))
    writer.mark_step({"first_sample": 0, "n_samples": 50})
    assert synced == ["folder", "file"]
    writer.close()  # the frames, the columns, and the name of the columns in place of that of the frames
    assert synced == ["folder", "file", "file", "file", "folder"]


@posix
def test_files_that_are_written_whole_keep_their_names(tmp_path: Path, synced: list[str]) -> None:
    """A file that was replaced, and the first row of a journal, are synced with the folder's names."""
    write_whole(tmp_path / "a.json", "{}")
    assert synced == ["file", "folder"]
    journal = Journal(tmp_path / "j.jsonl")
    for key in ("a", "b"):
        journal.add(key, {})
    assert synced == ["file", "folder", "file", "folder", "file"]
