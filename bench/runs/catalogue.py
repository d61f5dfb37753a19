"""The catalogue of a folder: brought up to date at each call by size and time of change, asked by queries."""

from __future__ import annotations

import contextlib
import functools
import sqlite3
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from bench.runs import query as queries
from bench.runs.database import Opened, open_database, replace
from bench.runs.folder import Found, files_below
from bench.runs.loops import Loop, saved_loops
from bench.runs.run import COLUMNS, Run, run_of, stated_quantities
from daq.files.disk import Closing
from daq.recording.header import Header, Unread, read_headers
from daq.recording.notebook import ENDING, Entry, Remarks, change_remarks, notebook, read_remarks, side_file
from daq.setup.errors import InputError

Progress = Callable[[str, float], None]
Row = dict[str, Any]
BATCH_S = 1.0  # what was read is saved at least so often


class Catalogue(Closing):
    """The runs below a folder. Any number of processes and threads may use it at once.

    Parameters
    ----------
    folder
        The runs' folder.
    anew
        Make the database anew from the files: it is empty here until `update`, which puts it in place of the old one
        in one transaction.

    Attributes
    ----------
    folder
        Absolute.
    path
        The database; None where it is kept in memory.
    said
        What a person should know of that, in a sentence; empty where there is nothing.

    Raises
    ------
    InputError
        Where there is no such folder.
    """

    def __init__(self, folder: Path, *, anew: bool = False) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder}: wanted the folder of the recordings; there is none of that name")
        self.folder = folder.resolve()
        opened: Opened = open_database(self.folder, anew=anew)
        self._connection, self.path, self.said = opened.connection, opened.path, opened.said
        self._lock, self._updating = threading.RLock(), threading.Lock()

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            self._connection.close()

    def update(self, *, all_bytes: bool = False, progress: Progress | None = None) -> int:
        """Read the files that are new or have changed, and forget those that are gone.

        Parameters
        ----------
        all_bytes
            Compare every byte of the recordings with their checksums, where that has not been done.
        progress
            Called with what is being read and the part done.

        Returns
        -------
        int
            Files read.
        """
        found = {file.path: file for file in files_below(self.folder)}
        with self._updating:
            known = {row["path"]: (row["size"], row["mtime_ns"]) for row in self._all("SELECT * FROM files")}
            unchecked = {row["path"] for row in self._all("SELECT path FROM runs WHERE NOT all_bytes")}
            gone = [path for path in known if path not in found]
            if gone:
                with self._writing():
                    self._connection.executemany("DELETE FROM files WHERE path = ?", [(path,) for path in gone])
            changed = [
                file
                for file in found.values()
                if known.get(file.path) != (file.size, file.mtime_ns) or (all_bytes and file.path in unchecked)
            ]
            self._read(changed, all_bytes=all_bytes, progress=progress)
            with self._writing():
                replace(self._connection)
        return len(changed)

    def runs(self, query: queries.Query | None = None) -> list[Row]:
        """Rows of the runs that a query asks for, in its order; see `as_json` for what they hold."""
        return [_row(found) for found in self._all(*queries.sql(query or queries.Query()))]

    def run(self, id: str) -> Row | None:
        """The run of that short name; None where there is none."""
        found = self._all(f"SELECT * FROM ({queries.BASE}) WHERE id = ?", [id])
        return _row(found[0]) if found else None

    def counts(self) -> dict[str, list[str]]:
        """Profiles and tags that occur."""
        profiles = [row[0] for row in self._all("SELECT DISTINCT profile FROM runs WHERE profile <> '' ORDER BY 1")]
        tags = [row[0] for row in self._all("SELECT DISTINCT tags FROM remarks WHERE tags <> ''")]
        return {"profiles": profiles, "tags": sorted({tag for text in tags for tag in text.split()})}

    def loops(self, identity: str) -> list[Row]:
        """Verdicts on the recording of that identity, the latest first."""
        rows = self._all("SELECT * FROM loops WHERE identity = ? AND identity <> '' ORDER BY at DESC", [identity])
        return [dict(row) for row in rows]

    def quantities(self, ids: Sequence[str] = ()) -> list[Row]:
        """Calibrations and effects, as profiles state and verdicts fit them, by date; of all runs, or of some.

        Each has id, path, date, name, value, sigma, unit and origin; of a verdict, the latest on the run counts.
        """
        marks = ", ".join("?" * len(ids))
        chosen = f"AND runs.id IN ({marks})" if ids else ""
        text = f"""
            SELECT runs.id, runs.path, runs.date, q.name, q.value, q.sigma, q.unit, q.origin
            FROM quantities AS q JOIN runs ON
              CASE WHEN q.origin = 'profile' THEN q.path = runs.path
              ELSE q.identity = runs.identity AND q.identity <> '' AND q.path = (
                SELECT l.path FROM loops AS l WHERE l.identity = runs.identity ORDER BY l.at DESC, l.path LIMIT 1) END
            WHERE runs.date IS NOT NULL {chosen} ORDER BY q.name, runs.date"""
        rows = [dict(row) for row in self._all(text, list(ids))]
        return rows + list(_fitted_sensitivities(rows))

    def file_of(self, row: Row) -> Path:
        """The file of a run; never one outside the folder.

        Raises
        ------
        InputError
            Where it is gone, or leads elsewhere.
        """
        try:
            path = self.folder.joinpath(str(row["path"])).resolve(strict=True)
        except (OSError, RuntimeError) as error:
            raise InputError(f"{row['path']}: is no longer there") from error
        if not path.is_relative_to(self.folder):
            raise InputError(f"{row['path']}: lies outside the runs' folder")
        return path

    def notebook(self, row: Row) -> tuple[Entry, ...]:
        """All notes of a run, from its file and its side file (raises InputError)."""
        path = self.file_of(row)
        found = [header for _, header in read_headers([path]) if isinstance(header, Header)]
        return notebook(found[0] if found else None, read_remarks(side_file(path)))

    def change_remarks(self, row: Row, change: Callable[[Remarks], Remarks]) -> Remarks:
        """Change tags and notes of a run in its side file, one process at a time.

        Raises
        ------
        InputError
            Where the file cannot be written, or ``change`` refuses.
        """
        changed = change_remarks(self.file_of(row), row["identity"], change)
        name = row["path"] + ENDING
        with self._writing():
            self._connection.execute("DELETE FROM files WHERE path = ?", [name])
            with contextlib.suppress(FileNotFoundError):
                state = (self.folder / name).stat()
                self._put_remarks(Found(name, state.st_size, state.st_mtime_ns))
        return changed

    def _read(self, changed: Iterable[Found], *, all_bytes: bool, progress: Progress | None) -> None:
        """Read files and keep what they hold."""
        files = {file.path: file for file in changed}
        total = max(len(files), 1)
        pending: list[Callable[[], None]] = []
        last, done = time.monotonic(), 0

        def keep(put: Callable[[], None] | None) -> None:
            nonlocal last, done
            if put is not None:
                pending.append(put)
                done += 1
                if progress is not None:
                    progress("reading recordings", done / total)
            if pending and (put is None or time.monotonic() - last > BATCH_S):
                with self._writing():
                    for one in pending:
                        one()
                pending.clear()
                last = time.monotonic()

        for file in files.values():
            if file.kind == "remarks":
                keep(functools.partial(self._put_remarks, file))
        hdf5 = [self.folder / file.path for file in files.values() if file.kind == "hdf5"]
        loops = [self.folder / file.path for file in files.values() if file.kind == "loop"]
        for path, header in read_headers(hdf5, all_bytes=all_bytes):
            file = files[path.relative_to(self.folder).as_posix()]
            keep(functools.partial(self._put_run, file, header))
        for path, loop in saved_loops(loops) if loops else ():
            file = files[path.relative_to(self.folder).as_posix()]
            keep(functools.partial(self._put_loop, file, loop))
        keep(None)

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """One transaction that writes; others wait for it."""
        with self._lock:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                try:
                    yield
                except BaseException:
                    self._connection.execute("ROLLBACK")
                    raise
                self._connection.execute("COMMIT")
            except sqlite3.OperationalError as error:
                raise InputError(
                    f"{self.path}: the catalogue cannot be written ({error}); end the process that holds it, make room "
                    "on the disk, or remove the file: it is made again from the recordings"
                ) from error

    def _put_file(self, file: Found) -> None:
        """The file is known; what was read of it before is forgotten."""
        self._connection.execute("DELETE FROM files WHERE path = ?", [file.path])
        self._connection.execute("INSERT INTO files VALUES (?, ?, ?)", [file.path, file.size, file.mtime_ns])

    def _put_run(self, file: Found, header: Header | Unread) -> None:
        self._put_file(file)
        if isinstance(header, Unread) and not header.damaged:
            return  # HDF5 of something else
        run: Run = run_of(file, header)
        marks = ", ".join("?" * len(COLUMNS))
        values = [_storable(getattr(run, name)) for name in COLUMNS]
        self._connection.execute(f"INSERT INTO runs ({', '.join(COLUMNS)}) VALUES ({marks})", values)
        for q in stated_quantities(header) if isinstance(header, Header) else ():
            self._connection.execute(
                "INSERT INTO quantities VALUES (?, ?, ?, ?, ?, ?, ?)",
                [file.path, run.identity, _storable(q.name), q.value, q.sigma, _storable(q.unit), q.origin],
            )

    def _put_loop(self, file: Found, loop: Loop | None) -> None:
        self._put_file(file)
        if loop is None:
            return
        values = [loop.verdict, loop.summary, len(loop.identities), loop.before_us, loop.after_us, loop.floor_us]
        for identity in dict.fromkeys(loop.identities):
            self._connection.execute(
                "INSERT INTO loops VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", [file.path, identity, file.mtime_ns, *values]
            )
            for q in loop.quantities:
                self._connection.execute(
                    "INSERT INTO quantities VALUES (?, ?, ?, ?, ?, ?, ?)",
                    [file.path, identity, q.name, q.value, q.sigma, q.unit, q.origin],
                )

    def _put_remarks(self, file: Found) -> None:
        self._put_file(file)
        remarks, problem = Remarks(), ""
        try:
            remarks = read_remarks(self.folder / file.path)
        except InputError as error:
            problem = str(error)
        later = "\n".join(note.text for note in remarks.notes)
        run = file.path.removesuffix(ENDING)
        self._connection.execute(
            "INSERT INTO remarks VALUES (?, ?, ?, ?, ?, ?)",
            [file.path, run, remarks.identity, _storable(later), _storable(" ".join(remarks.tags)), problem],
        )

    def _all(self, text: str, values: Sequence[Any] = ()) -> list[Any]:
        with self._lock:
            return self._connection.execute(text, values).fetchall()


def _fitted_sensitivities(rows: list[Row]) -> Iterator[Row]:
    """The accelerometer's sensitivity by a verdict: as stated, times the factor by which it reads too much."""
    stated = {row["id"]: row for row in rows if row["name"] == "accelerometer.sensitivity"}
    for row in rows:
        if row["name"] == "accelerometer_gain.relative" and row["id"] in stated and row["origin"] == "verdict":
            by = stated[row["id"]]
            sigma = None if row["sigma"] is None else abs(by["value"]) * row["sigma"]
            value = by["value"] * (1.0 + row["value"])
            yield by | {"value": value, "sigma": sigma, "origin": "verdict"}


def _storable(value: Any) -> Any:
    """A value as SQLite takes it; text that is not Unicode has marks in its place."""
    return value.encode("utf-8", "replace").decode("utf-8") if isinstance(value, str) else value


def _row(found: Any) -> Row:
    """One row of a query as JSON has it."""
    row = dict(found)
    loop = None
    if row["verdict"] is not None:
        loop = {
            "verdict": row["verdict"], "summary": row["summary"], "file": row["loop_path"],
            "recordings": row["together"], "before_us": row["before_us"], "after_us": row["after_us"],
            "floor_us": row["floor_us"],
        }  # fmt: skip
    return {name: row[name] for name in COLUMNS} | {
        "all_bytes": bool(row["all_bytes"]),
        "simulated": bool(row["simulated"]),
        "tags": row["tags"].split(),
        "notes": row["shown_note"],
        "remarks_problem": row["remarks_problem"] or None,
        "loop": loop,
    }
