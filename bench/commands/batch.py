"""`bench batch`: folders of recordings reprocessed, compared and explained, one row each."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import Anyway, Overwrite

if TYPE_CHECKING:
    from bench.batch.examine import Row


def command(
    places: list[Path] = typer.Argument(metavar="PLACE...", help="Recordings, or folders that are searched for them."),
    out: Path = typer.Option(..., "--out", metavar="FILE", help="The table: .parquet or .csv."),
    do: list[str] = typer.Option([], "--do", help="reprocess, compare or close-loop; repeatable; all where not given."),
    profile: Path | None = typer.Option(None, "--profile", help="A profile that replaces the recordings' own."),
    workers: int = typer.Option(1, "--workers", min=1, help="Processes."),
    cluster: str | None = typer.Option(None, "--cluster", help="Dask scheduler: tcp://host:port, or 'local'."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The rows for a machine; - prints them."),
    anyway: Anyway = False,
    overwrite: Overwrite = False,
) -> None:
    """Examine every recording of a laboratory; a table with one row each.

    Rows are kept in FILE.rows as they come in. The same command, given again, goes on where it was stopped, and does
    again only what failed or has changed since. A recording that fails has its reason in the table. Each
    verdict is saved next to its recording (run.loop), where bench report and bench runs find it.

    Example: bench batch runs/ --out runs.parquet --workers 4

    Exits 0 when every recording has its row, 1 when some failed, 2 when the call was wrong.
    """
    from bench.batch.examine import PARTS
    from bench.batch.recordings import find_recordings
    from bench.batch.run import Batch, run_batch
    from bench.batch.table import write_table
    from bench.outputs import JSON, TABLE, File, check_outputs
    from bench.profiles.find import load_measuring
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, write_json
    from daq.files.whole_file import Journal
    from daq.setup.errors import InputError

    quiet = json == "-"
    rows_file = out.with_name(f"{out.name}.rows")
    try:
        check_outputs(
            File("--out", out, TABLE, continues=lambda path: rows_file.exists()), File("--json", json, JSON),
            inputs=[*places, profile], overwrite=overwrite,
        )  # fmt: skip
        if profile is not None:
            load_measuring(profile)
        recordings, others = find_recordings(places)
        batch = Batch(recordings, _parts(do, PARTS), profile, anyway)
        rows = run_batch(batch, Journal(rows_file), workers=workers, cluster=cluster, told=None if quiet else _tell)
        write_table(rows, out)
    except (InputError, ValueError) as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{error}; what was done is kept in {rows_file}: give the same command again", EXIT_FAILED)
    except KeyboardInterrupt:
        fail(f"interrupted; what was done is kept in {rows_file}: give the same command again", EXIT_FAILED)
    failed = [row for row in rows if row["failed"]]
    write_json(as_json(rows, others), json)
    if not quiet:
        _print(rows, others, out)
    if failed:
        raise SystemExit(EXIT_FAILED)


def as_json(rows: list[Row], others: int) -> dict[str, Any]:
    """The rows for a machine."""
    return {
        "recordings": len(rows),
        "failed": sum(bool(row["failed"]) for row in rows),
        "passed_over": others,
        "rows": rows,
    }


def _parts(asked: list[str], known: tuple[str, ...]) -> tuple[str, ...]:
    from daq.setup.errors import InputError

    for name in asked:
        if name not in known:
            raise InputError(f"--do {name}: wanted one of {', '.join(known)}")
    return tuple(name for name in known if name in asked) if asked else known


def _tell(done: int, total: int, path: Path, row: Row) -> None:
    """One line a recording, as it comes in."""
    found = row.get("verdict") or ""
    names = f": {row['effects']}" if row.get("effects") else ""
    typer.echo(f"{done}/{total} {path}: {row['failed'] or f'{found}{names}' or 'done'}")


def _print(rows: list[Row], others: int, out: Path) -> None:
    """Numbers of recordings by verdict."""
    from collections import Counter

    counts = Counter(row.get("verdict") or "no verdict" for row in rows if not row["failed"])
    failed = sum(bool(row["failed"]) for row in rows)
    words = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.most_common())
    typer.echo(f"{len(rows)} recordings: {words or 'none examined'}{f', {failed} failed' if failed else ''}")
    if others:
        typer.echo(f"{others} other HDF5 files were passed over")
    typer.echo(f"table: {out}")
