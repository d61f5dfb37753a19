"""`bench runs`: the recordings of a folder as a table, or as pages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_FAILED, new_table, print_lines, print_table, warn, write_json
from bench.web.packages import serve_pages

if TYPE_CHECKING:
    from bench.runs.query import Row


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
    from bench.runs.catalogue import Catalogue
    from bench.runs.query import Query
    from bench.terminal.progress import progress_bar

    check_outputs(File("--json", json, JSON), inputs=[folder], overwrite=overwrite)
    query = Query(
        profile=profile_name, c=c, gamma=gamma, tags=tuple(tag), verdict=verdict, ended=ended, since=since,
        until=until, text=text, lost=lost, sort=sort, limit=limit,
    )  # fmt: skip
    with Catalogue(folder, anew=rescan) as catalogue:
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
