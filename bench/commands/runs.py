"""`bench runs`, `bench tag`, `bench note`: recordings as a table or pages; words and notes by which they are found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import (
    EXIT_FAILED,
    new_table,
    print_lines,
    print_table,
    progress_bar,
    readable,
    warn,
    write_json,
)
from bench.web.packages import serve_pages
from daq.setup.errors import InputError, require_file

if TYPE_CHECKING:
    from bench.runs.catalogue import Row
    from daq.recording.notebook import Remarks


def command(
    folder: Path = typer.Argument(Path(), metavar="[DIR]", help="Folder of the recordings, with those in it."),
    profile_name: str = typer.Option("", "--profile", metavar="NAME", help="Part of the profile's name."),
    c: int | None = typer.Option(None, "--c", help="Ratio of the tones."),
    gamma: tuple[float, float] | None = typer.Option(None, "--gamma", help="A range that the run's gammas touch."),
    tag: list[str] = typer.Option([], "--tag", help="A tag it carries; may be given again."),
    verdict: str = typer.Option("", "--verdict", help="explained, unexplained, nothing_missing or none."),
    ended: str = typer.Option("", "--ended", help="complete, stopped, failed, incomplete or damaged."),
    since: str = typer.Option("", "--since", metavar="DATE", help="From that day on, as 2026-11-20."),
    until: str = typer.Option("", "--until", metavar="DATE", help="To that day, or month, or year."),
    text: str = typer.Option("", "--text", help="Words in file name, profile, notes, tags or verdict."),
    lost: bool = typer.Option(False, "--lost", help="Only runs that lost samples."),
    sort: str = typer.Option(
        "date",
        "--sort",
        help="date, name, profile, c, gamma, steps, length, lost, ended, verdict, note or tags; -KEY: backwards.",
    ),
    limit: int = typer.Option(-1, "--limit", min=-1, help="So many rows at most; -1: all."),
    rescan: bool = typer.Option(False, "--rescan", help="Make the catalogue anew from the files."),
    verify: bool = typer.Option(False, "--verify", help="Compare every byte with the checksums, not only tables."),
    page: bool = typer.Option(False, "--page", help="Open the same in a browser."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """List the recordings of a folder: date, profile, gamma, what was lost, how it ended, verdict, note and tags.

    Only new and changed files are read. The catalogue lies in DIR/.shakerbench and can be removed at any time.

    Example: bench runs runs --tag new-spring --sort -gamma
    """
    from bench.runs.catalogue import Catalogue, Query

    check_outputs(File("--json", json, JSON), inputs=[folder], overwrite=overwrite)
    query = Query(
        profile=profile_name, c=c, gamma=gamma, tags=tuple(tag), verdict=verdict, ended=ended, since=since,
        until=until, text=text, lost=lost, sort=sort, limit=limit,
    )  # fmt: skip
    catalogue = Catalogue(folder, anew=rescan)
    if catalogue.said:
        warn(catalogue.said)
    with progress_bar(quiet=json == "-") as bar:
        read = catalogue.update(all_bytes=verify, progress=bar)
    rows = catalogue.runs(query)
    answer = {
        "folder": catalogue.folder, "catalogue": catalogue.path, "said": catalogue.said or None, "files_read": read,
        "runs": rows,
    }  # fmt: skip
    if write_json(answer, json) and not page:
        if rows:
            _print(rows)
        else:
            print_lines(f"{catalogue.folder}: no recordings that meet this; files read: {read}")
    if page:
        serve_pages(["bench.runs.pages"], folder)
    elif verify and any(row["ended"] == "damaged" for row in rows):
        raise typer.Exit(EXIT_FAILED)


def _print(rows: list[Row]) -> None:
    """The table for a person, and what is wrong with damaged files."""
    from rich.markup import escape

    def line(text: str) -> str:
        return " ".join(text.split())

    def known(value: int | None) -> str:
        return "-" if value is None else str(value)

    words = ("date", "file", "profile", "ended", "verdict", "note", "tags")
    headings = ("date", "file", "profile", "c", "gamma", "steps", "lost", "ended", "verdict", "note", "tags")
    table = new_table(*headings, words=words)
    for row in rows:
        low, high = row["gamma_low"], row["gamma_high"]
        cells = (
            (row["date"] or "-")[:16].replace("T", " "),
            row["path"],
            (row["profile"] or "-") + (" (simulated)" if row["simulated"] else ""),
            known(row["c"]),
            "-" if low is None else f"{low:.3f}" if high - low < 5e-4 else f"{low:.3f}-{high:.3f}",
            str(row["steps"]),
            known(row["lost_samples"]),
            row["ended"],
            row["loop"]["summary"] if row["loop"] else "-",
            "; ".join(map(line, row["notes"].splitlines())),
            " ".join(row["tags"]),
        )
        table.add_row(*map(escape, cells))
    print_table(table)
    for row in rows:
        if row["ended"] == "damaged":
            print_lines(f"{row['path']}: damaged: {line(row['why'])}")
        if row["remarks_problem"]:
            print_lines(line(row["remarks_problem"]))


def tag(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording to tag."),
    tags: list[str] = typer.Argument(metavar="TAG...", help="Single words."),
    remove: bool = typer.Option(False, "--remove", help="Take these tags away."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Tag a recording; the tags lie in a small file next to it, and the recording stays as it is.

    Example: bench tag runs/monday.h5 new-spring warm
    """
    from daq.recording.notebook import with_tags

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    _changed(recording, lambda now: with_tags(now, tuple(tags), remove=remove), json)


def note(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording that the note is about."),
    text: str | None = typer.Argument(None, metavar="TEXT", help="The note; left out: the notes are shown."),
    undo: bool = typer.Option(False, "--undo", help="Take back the latest note."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Add a note, with its time, to a recording; it lies in a file next to it. Without a text: the whole notebook.

    Example: bench note runs/monday.h5 "plate screws were loose"
    """
    from daq.recording.notebook import with_note, without_last_note

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    said = readable(text)
    if undo and said is not None:
        raise InputError("--undo takes back the latest note; leave out the text, or leave out --undo")
    change = without_last_note if undo else None if said is None else lambda now: with_note(now, said)
    _changed(recording, change, json)


def _changed(recording: Path, change: Callable[[Remarks], Remarks] | None, json: str | None) -> None:
    """Change the remarks on a recording (raises `InputError`), and show its tags and its whole notebook."""
    from daq.recording.header import Header, read_headers
    from daq.recording.notebook import as_line, change_remarks, notebook, read_remarks, side_file

    require_file(recording)
    header = None  # of a damaged recording there is none
    for _, found in read_headers([recording]):
        if isinstance(found, Header):
            header = found
        elif not found.damaged or "does not begin" in found.why:
            raise InputError(f"{recording}: {found.why}; wanted a recording")
    identity = "" if header is None else header.identity
    now = read_remarks(side_file(recording)) if change is None else change_remarks(recording, identity, change)
    notes = notebook(header, now)
    if write_json({"file": recording, "tags": now.tags, "notes": notes}, json):
        print_lines(f"{recording}: {' '.join(now.tags) or 'no tags'}", *(f"  {as_line(note)}" for note in notes))
