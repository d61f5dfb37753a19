"""`bench batch`: recordings examined, a row each in one table; `bench report`: a section each on one page."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import HTML, JSON, PDF, TABLE, Anyway, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_FAILED, fail, speaker, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from bench.batch import Row


def batch(
    places: list[Path] = typer.Argument(metavar="PLACE...", help="Recordings, or folders that are searched for them."),
    out: Path = typer.Option(..., "--out", metavar="FILE", help="The table: .parquet or .csv."),
    do: list[str] = typer.Option([], "--do", help="reprocess, compare or close-loop; repeatable; all where not given."),
    profile: Path | None = typer.Option(None, "--profile", help="A profile that replaces the recordings' own."),
    workers: int = typer.Option(1, "--workers", min=1, help="Processes."),
    cluster: str | None = typer.Option(None, "--cluster", help="Dask scheduler: tcp://host:port, or 'local'."),
    json: Json = None,
    anyway: Anyway = False,
    overwrite: Overwrite = False,
) -> None:
    """Examine every recording of a laboratory; a table with one row each.

    Rows are stored in FILE.rows as they come in. The same command, given again, goes on where it was stopped, and does
    again only what failed or has changed since. A recording that fails has its reason in the table. Each
    verdict is saved next to its recording (run.loop), where bench report and bench runs find it.

    Example: bench batch runs/ --out runs.parquet --workers 4

    Exits 0 when every recording has its row, 1 when some failed, 2 when the call was wrong.
    """
    from bench.batch import PARTS, Batch, find_recordings, run_batch, write_table
    from bench.profiles.find import load_measuring
    from daq.files.disk import Journal

    rows_file = out.with_name(f"{out.name}.rows")
    check_outputs(
        File("--out", out, TABLE, continues=lambda path: rows_file.exists()), File("--json", json, JSON),
        inputs=[*places, profile], overwrite=overwrite,
    )  # fmt: skip
    if profile is not None:
        load_measuring(profile)
    for name in do:
        if name not in PARTS:
            raise InputError(f"--do {name}: wanted one of {', '.join(PARTS)}")
    recordings, others = find_recordings(places)
    asked = Batch(recordings, tuple(part for part in PARTS if part in do or not do), profile, anyway)
    try:
        say = None if json == "-" else _say
        rows = run_batch(asked, Journal(rows_file), workers=workers, cluster=cluster, say=say)
        write_table(rows, out)
    except (OSError, KeyboardInterrupt) as error:
        fail(f"{str(error) or 'interrupted'}; what was done is in {rows_file}: give the same command again")
    failed = sum(bool(row["failed"]) for row in rows)
    if write_json({"recordings": len(rows), "failed": failed, "passed_over": others, "rows": rows}, json):
        counts = Counter(row.get("verdict") or "no verdict" for row in rows if not row["failed"])
        words = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.most_common())
        typer.echo(f"{len(rows)} recordings: {words or 'none examined'}{f', {failed} failed' if failed else ''}")
        if others:
            typer.echo(f"{others} other HDF5 files were passed over")
        typer.echo(f"table: {out}")
    if failed:
        raise SystemExit(EXIT_FAILED)


def _say(done: int, total: int, path: Path, row: Row) -> None:
    """One line a recording, as it comes in."""
    names = f": {row['effects']}" if row.get("effects") else ""
    typer.echo(f"{done}/{total} {path}: {row['failed'] or (row.get('verdict') or '') + names or 'done'}")


def report(
    recordings: list[Path] = typer.Argument(metavar="REC.h5...", help="Recordings (HDF5), a section each."),
    out: Path = typer.Option(..., "--out", "-o", metavar="PAGE.html", help="Page to write; it needs no other file."),
    pdf: Path | None = typer.Option(None, "--pdf", metavar="FILE.pdf", help="Print it there as well."),
    no_loop: bool = typer.Option(False, "--no-loop", help="Leave the closed loop out."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Report of recordings as one HTML page: verdict, figures, steps, residuals, rig, calibrations, provenance.

    A closed loop saved next to a recording (REC.loop) is used where it belongs to it; else the loop is closed, which
    takes a while, and saved there. Point at a dot to see its flight. --pdf needs Chromium, Chrome, Edge or WeasyPrint.

    Example: bench report run.h5 --out run.html --pdf run.pdf
    """
    from analysis.report.run_page import write_page
    from bench.jobs.report import print_pdf, refuse_without_printer, sections_of
    from daq.recording.header import refuse_repeated

    check_outputs(
        File("--out", out, HTML), File("--pdf", pdf, PDF), File("--json", json, JSON),
        inputs=recordings, overwrite=overwrite,
    )  # fmt: skip
    if pdf is not None:
        refuse_without_printer()
    refuse_repeated(recordings)
    say = speaker(json == "-")
    sections, answers = sections_of(recordings, with_loop=not no_loop, say=say, quiet=json == "-")
    write_page(sections, out)
    if pdf is not None:
        try:
            print_pdf(out, pdf)
        except InputError as error:  # the page is there: a browser failed, the call was right
            fail(str(error))
    write_json({"file": out, "pdf": pdf, "runs": answers}, json)
    for one in sections:
        say(f"{one.name}: {one.sentence}")
    say(f"report: {out}" + (f" and {pdf}" if pdf is not None else ""))
