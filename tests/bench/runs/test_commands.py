"""The commands runs, tag and note, as a person calls them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from bench.cli import app


def bench(*arguments: object) -> Result:
    """Run the command line."""
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_a_table_for_a_person_and_for_a_machine(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows that are asked for, in that order; markup in a note is shown as it is; damage is told below."""
    monkeypatch.setenv("COLUMNS", "200")
    (folder / "text.h5").write_text("hello")
    result = bench("runs", folder, "--sort", "-gamma")
    assert result.exit_code == 0, result.output
    assert result.output.index("c.h5") < result.output.index("b.h5") < result.output.index("a.h5")
    assert "first <b>run</b>" in result.output
    assert "text.h5: damaged: cannot be read as HDF5" in result.output
    told = json.loads(bench("runs", folder, "--c", 2, "--json", "-").stdout)
    assert [row["path"] for row in told["runs"]] == ["one/b.h5"] and told["files_read"] == 0
    assert json.loads(bench("runs", folder, "--rescan", "--json", "-").stdout)["files_read"] == 4
    assert bench("runs", folder, "--verify").exit_code == 1
    assert "no recordings that meet this" in bench("runs", folder, "--tag", "none").output


def test_tag_and_note(folder: Path) -> None:
    """Tags come and go, notes add up and the latest is taken back; the table shows them."""
    run = folder / "one" / "a.h5"
    assert bench("tag", run, "warm", "new").exit_code == 0
    assert bench("tag", run, "new", "--remove").exit_code == 0
    assert bench("note", run, "[red]loose screw[/red]").exit_code == 0
    assert bench("note", run, "second").exit_code == 0
    told = json.loads(bench("note", run, "--undo", "--json", "-").stdout)
    assert told["tags"] == ["warm"] and [note["text"] for note in told["notes"]][1:] == ["[red]loose screw[/red]"]
    assert "[red]loose screw[/red]" in bench("note", run).output
    (row,) = json.loads(bench("runs", folder, "--tag", "warm", "--json", "-").stdout)["runs"]
    assert row["notes"] == "first <b>run</b>\n[red]loose screw[/red]"


def test_wrong_calls_leave_with_two(folder: Path) -> None:
    """A folder or recording that is not there, a wrong sort, a tag of two words: status 2 and what to do."""
    run = folder / "one" / "a.h5"
    (folder / "x.h5").write_text("hello")
    for call, says in (
        (("runs", folder / "no"), "there is none of that name"),
        (("runs", folder, "--sort", "size"), "wanted one of date"),
        (("runs", folder, "--since", "tomorrow"), "--since tomorrow: wanted a date"),
        (("runs", folder, "--until", "2026-02-30"), "--until 2026-02-30: wanted a date"),
        (("tag", folder / "no.h5", "x"), "no such file"), (("tag", folder / "x.h5", "x"), "wanted a recording"),
        (("tag", run, "two words"), "wanted one word"), (("note", run, " "), "wanted 1 to"),
        (("note", run, "--undo"), "no note to take back"), (("note", run, "x", "--undo"), "leave out the text"),
    ):  # fmt: skip
        result = bench(*call)
        assert result.exit_code == 2, result.output
        assert says in result.output.replace("\n", " ") and "Traceback" not in result.output
