"""`bench runs`: the recordings of a folder as a table, or as pages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from bench.runs.catalogue import Catalogue, Row


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
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The same for a machine; - prints it."),
    overwrite: Overwrite = False,
) -> None:
    """List the recordings of a folder: date, profile, gamma, what was lost, how it ended, verdict, note and tags.

    Only new and changed files are read. The catalogue is kept in DIR/.shakerbench and can be removed at any time.

    Example: bench runs runs --tag new-spring --sort -gamma
    """
    from bench.outputs import JSON, File, check_outputs
    from bench.runs.catalogue import Catalogue
    from bench.runs.query import Query
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, warn, write_json
    from bench.terminal.progress import progress_bar
    from daq.setup.errors import InputError

    try:
        check_outputs(File("--json", json, JSON), inputs=[folder], overwrite=overwrite)
        query = Query(
            profile=profile_name, c=c, gamma=gamma, tags=tuple(tag), verdict=verdict, ended=ended, since=since,
            until=until, text=text, lost=lost, sort=sort.removeprefix("-"), backwards=sort.startswith("-"), limit=limit,
        )  # fmt: skip
        with Catalogue(folder, anew=rescan) as catalogue:
            if catalogue.said:
                warn(catalogue.said)
            with progress_bar(quiet=json == "-") as bar:
                read = catalogue.update(all_bytes=verify, progress=bar)
            rows = catalogue.runs(query)
            answer = as_json(catalogue, rows, read)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    write_json(answer, json)
    if json != "-" and not page:
        _print(answer)
    if page:
        _serve(folder)
    elif verify and any(row["ended"] == "damaged" for row in rows):
        raise typer.Exit(EXIT_FAILED)


def as_json(catalogue: Catalogue, rows: list[Row], read: int) -> dict[str, Any]:
    """The table for a machine."""
    return {
        "folder": str(catalogue.folder),
        "catalogue": None if catalogue.path is None else str(catalogue.path),
        "said": catalogue.said or None,
        "files_read": read,
        "runs": rows,
    }


def _print(answer: dict[str, Any]) -> None:
    """The table for a person, and what is wrong with damaged files."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from bench.terminal.console import print_lines, print_table

    rows = answer["runs"]
    if not rows:
        print_lines(f"{answer['folder']}: no recordings that meet this; files read: {answer['files_read']}")
        return
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    right = ("c", "gamma", "steps", "lost")
    for heading in ("date", "file", "profile", "c", "gamma", "steps", "lost", "ended", "verdict", "note", "tags"):
        wrap = heading in ("file", "verdict", "note", "tags")
        table.add_column(heading, justify="right" if heading in right else "left", no_wrap=not wrap, overflow="fold")
    for row in rows:
        table.add_row(*(escape(cell) for cell in cells(row)))
    print_table(table)
    for row in rows:
        if row["ended"] == "damaged":
            print_lines(f"{row['path']}: damaged: {_line(row['why'])}")
        if row["remarks_problem"]:
            print_lines(_line(row["remarks_problem"]))


def cells(row: Row) -> list[str]:
    """A row as a person reads it."""
    low, high = row["gamma_low"], row["gamma_high"]
    gamma = "-" if low is None else f"{low:.3f}" if high - low < 5e-4 else f"{low:.3f}-{high:.3f}"
    return [
        (row["date"] or "-")[:16].replace("T", " "),
        row["path"],
        (row["profile"] or "-") + (" (simulated)" if row["simulated"] else ""),
        _known(row["c"]),
        gamma,
        str(row["steps"]),
        _known(row["lost_samples"]),
        row["ended"],
        row["loop"]["summary"] if row["loop"] else "-",
        "; ".join(map(_line, row["notes"].splitlines())),
        " ".join(row["tags"]),
    ]


def _known(value: int | None) -> str:
    return "-" if value is None else str(value)


def _line(text: str) -> str:
    """Text on one line."""
    return " ".join(text.split())


def _serve(folder: Path) -> None:
    """Serve the pages until the command is ended."""
    from bench.terminal.console import EXIT_USAGE, fail, print_lines
    from daq.setup.errors import InputError

    try:
        import webbrowser

        from bench.web.section import Place
        from bench.web.serve import bind, serve

        listening, access = bind()
    except ImportError as error:
        fail(f"--page needs packages that are not installed ({error.name}): pip install shakerbench[live]", EXIT_USAGE)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    print_lines(f"pages: {access.url}  (end with Ctrl-C)")
    webbrowser.open(access.url)
    serve(listening, access, ["bench.runs.pages"], Place(folder.resolve()))
