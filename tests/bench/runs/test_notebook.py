"""One notebook: what was noted before, during and after a run is found by every command and page that shows the run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from starlette.testclient import TestClient
from typer.testing import CliRunner

from bench.cli import app
from bench.runs.folder import run_id
from bench.runs.pages import section
from bench.web.access import Access
from bench.web.serve import Place, make_app
from daq.files.tables import NOTE_BYTES, note_rows, notes_of_rows
from tests.bench.runs.recordings import record

LONG = "the ball is dusty; " + "\u00e4\u20ac" * 300  # 1500 bytes and more
GIVEN, DURING, LATER = "plate screws tightened", "a knock from the corridor", "rod was bent"


@pytest.fixture
def noted(tmp_path: Path) -> Path:
    """A recording with a note given before, two typed during the run, one added later, and a tag."""
    path = tmp_path / "noted.h5"
    writer = record(path, note=GIVEN, close=False)
    writer.mark_rows("notes", note_rows(500, [DURING, LONG], 10**18))
    writer.close()
    assert bench("note", path, LATER).exit_code == 0 and bench("tag", path, "warm").exit_code == 0
    return path


def bench(*words: object):
    """A command as a person calls it."""
    return CliRunner().invoke(app, [str(word) for word in words])


def test_a_long_note_is_kept_whole() -> None:
    """Notes of any length come back as they were typed, also several at once and of characters of many bytes."""
    texts = ["", "x", "y" * NOTE_BYTES, LONG, "\U0001f3b1" * 700, "x", "x"]
    rows = note_rows(7, texts, 1)
    assert [(sample, text) for sample, _, text in notes_of_rows(rows)] == [(7, text) for text in texts]


def test_every_command_shows_the_whole_notebook(noted: Path) -> None:
    """note, info, runs (its search too), export and the pages name all four notes, those of the run with their time."""
    whole = [GIVEN, DURING, LONG, LATER]
    for command in ("note", "info"):
        told = json.loads(bench(command, noted, "--json", "-").stdout)
        assert [note["text"] for note in told["notes"]] == whole and told["tags"] == ["warm"]
        at_s = [note["at_s"] for note in told["notes"]]
        assert at_s[0] is at_s[3] is None and at_s[1] == at_s[2] > 0.1
        shown = bench(command, noted).output.replace("\n", " ")
        assert all(" ".join(text.split())[:20] in shown for text in whole) and "warm" in shown
    for word in ("corridor", "tightened", "bent"):
        (row,) = json.loads(bench("runs", noted.parent, "--text", word, "--json", "-").stdout)["runs"]
        assert row["notes"].splitlines() == whole
    assert bench("export", noted, "--to", "csv", "--out", noted.parent / "out.csv").exit_code == 0
    lines = (noted.parent / "out.csv.notes.txt").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "tags: warm" and all(line.endswith(text) for line, text in zip(lines[1:], whole, strict=True))
    access = Access("127.0.0.1", 80, None)
    with TestClient(make_app(access, [section(Place(noted.parent.resolve()))]), base_url="http://127.0.0.1") as client:
        told = client.get(f"/runs/api/{run_id('noted.h5')}").json()
    assert [note["text"] for note in told["notes"]] == whole


def test_the_report_has_the_notebook(noted: Path) -> None:
    """The page of a recording lists its tags and every note."""
    out = noted.parent / "page.html"
    bench("report", noted, "--out", out)
    page = out.read_text(encoding="utf-8")
    assert all(text in page for text in ("<h3>Notebook</h3>", GIVEN, DURING, LONG, LATER, "Tags: warm"))
