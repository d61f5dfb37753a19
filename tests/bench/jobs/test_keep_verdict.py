"""Verdicts beside their recordings: every command that closes a loop keeps one, and none costs a foreign file."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from typer.testing import CliRunner

from analysis.loop import close_loop
from analysis.loop.result import ClosedLoop, load_verdict
from bench.batch import examine
from bench.cli import app
from bench.jobs import report
from bench.jobs.loops import drawn, keep_verdict, verdict_file
from daq.setup.errors import InputError
from tests.bench.runs.recordings import record


def test_the_latest_verdict_stays_and_a_foreign_file_too(closed_loop: ClosedLoop, tmp_path: Path) -> None:
    """A later verdict takes the place of an earlier one; a foreign file stays, and a sentence says so."""
    run = tmp_path / "run.h5"
    assert keep_verdict(closed_loop, [run]) == ""
    assert keep_verdict(dataclasses.replace(closed_loop, verdict="unexplained"), [run]) == ""
    assert load_verdict(tmp_path / "run.loop").verdict == "unexplained"
    (tmp_path / "run.loop").write_text("mine", encoding="utf-8")
    assert "no closed loop" in keep_verdict(closed_loop, [run])
    assert (tmp_path / "run.loop").read_text(encoding="utf-8") == "mine"
    assert "cannot be written" in keep_verdict(closed_loop, [tmp_path / "gone" / "run.h5"])


def test_runs_judged_as_one_do_not_replace_the_first_ones_verdict(tmp_path: Path) -> None:
    """The verdict on three recordings has a name of its own, beside the first."""
    runs = [tmp_path / f"{name}.h5" for name in "abc"]
    assert verdict_file(runs) == tmp_path / "a+2.loop"
    assert verdict_file(runs[:1]) == tmp_path / "a.loop"


def test_batch_and_report_keep_it(closed_loop: ClosedLoop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of a batch and a page of a report leave the verdict beside the recording; the next report reads it."""
    for place in (close_loop, report):
        monkeypatch.setattr(place, "close_loop", lambda paths, **_: closed_loop)
    for name in ("batch", "report"):
        record(tmp_path / f"{name}.h5")
    examine(tmp_path / "batch.h5", ("close-loop",))
    page = CliRunner().invoke(app, ["report", str(tmp_path / "report.h5"), "--out", str(tmp_path / "page.html")])
    assert page.exit_code == 0, page.output
    for name in ("batch", "report"):
        assert load_verdict(tmp_path / f"{name}.loop").selection.names == closed_loop.selection.names


@pytest.mark.slow
def test_a_drawing_that_fails_says_why_wherever_it_is_called(
    closed_loop: ClosedLoop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder that cannot be made is a sentence, and a person's own analysis.py in the working folder changes none."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "analysis.py").write_text("raise SystemExit(7)")
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(InputError, match="taken"):
        drawn(closed_loop, tmp_path / "taken", quiet=True)
