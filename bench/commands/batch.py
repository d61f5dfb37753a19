"""`bench batch`: folders of recordings reprocessed, compared and explained, one row each."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, TABLE, Anyway, File, Json, Overwrite, check_outputs
from bench.terminal.console import EXIT_FAILED, fail, write_json
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from bench.batch import Row


def command(
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
    batch = Batch(recordings, tuple(part for part in PARTS if part in do or not do), profile, anyway)
    try:
        say = None if json == "-" else _say
        rows = run_batch(batch, Journal(rows_file), workers=workers, cluster=cluster, say=say)
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
