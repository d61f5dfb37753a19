"""The catalogue's database: SQLite in the recordings' folder, or in memory where that cannot be.

All in it is made from files. One that is damaged or of an earlier version is made anew; one of a newer version is left
as it is.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from dataclasses import dataclass
from pathlib import Path

from bench.runs.folder import PLACE

NAME = "runs.sqlite"
VERSION = 2
BUSY_S = 10.0
"""Time that one process waits for another that is writing."""

SCHEMA = """
CREATE TABLE files (path TEXT PRIMARY KEY, size INTEGER NOT NULL, mtime_ns INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE runs (
  path TEXT PRIMARY KEY REFERENCES files ON DELETE CASCADE, id TEXT UNIQUE NOT NULL, identity TEXT NOT NULL,
  date TEXT, profile TEXT, c INTEGER, frequency_hz REAL, gamma_low REAL, gamma_high REAL, steps INTEGER, seconds REAL,
  rate_hz REAL, n_samples INTEGER, lost_samples INTEGER, ended TEXT, why TEXT, all_bytes INTEGER, note TEXT, notes TEXT,
  simulated INTEGER, backend TEXT
);
CREATE INDEX runs_identity ON runs (identity);
CREATE TABLE remarks (
  path TEXT PRIMARY KEY REFERENCES files ON DELETE CASCADE, run TEXT NOT NULL, identity TEXT NOT NULL,
  note TEXT NOT NULL, tags TEXT NOT NULL, problem TEXT NOT NULL
);
CREATE INDEX remarks_run ON remarks (run);
CREATE TABLE loops (
  path TEXT NOT NULL REFERENCES files ON DELETE CASCADE, identity TEXT NOT NULL, at INTEGER NOT NULL,
  verdict TEXT NOT NULL, summary TEXT NOT NULL, together INTEGER NOT NULL, before_us REAL, after_us REAL, floor_us REAL,
  PRIMARY KEY (path, identity)
);
CREATE INDEX loops_identity ON loops (identity, at);
CREATE TABLE quantities (
  path TEXT NOT NULL REFERENCES files ON DELETE CASCADE, identity TEXT NOT NULL, name TEXT NOT NULL,
  value REAL NOT NULL, sigma REAL, unit TEXT NOT NULL, origin TEXT NOT NULL
);
CREATE INDEX quantities_path ON quantities (path);
CREATE INDEX quantities_identity ON quantities (identity);
"""

STATEMENTS = tuple(statement for statement in SCHEMA.split(";\n") if statement.strip())


@dataclass(frozen=True)
class Opened:
    """An open database; ``path`` None: in memory. ``said``: what a person should know, in a sentence, or empty."""

    connection: sqlite3.Connection
    path: Path | None
    said: str = ""


def open_database(folder: Path, *, anew: bool = False) -> Opened:
    """Open, or make, the database of a folder.

    Parameters
    ----------
    folder
        The runs' folder.
    anew
        Make it anew, whatever is there; one of a newer version stays all the same. The connection has empty tables of
        its own until `replace`, and other processes have the old ones until then.
    """
    path = folder / PLACE / NAME
    try:
        path.parent.mkdir(exist_ok=True)
        return _opened(path, anew=anew)
    except sqlite3.OperationalError as error:
        why = str(error)
    except sqlite3.DatabaseError as error:  # no database, or a damaged one
        return _made_again(path, str(error))
    except OSError as error:
        why = error.strerror or str(error)
    return _in_memory(path, f"{path}: cannot be written ({why}); the catalogue is kept in memory for this call")


def _opened(path: Path, *, anew: bool) -> Opened:
    """The database on disk (raises sqlite3.DatabaseError, OSError)."""
    connection = _connect(str(path))
    try:
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if version > VERSION:
            connection.close()
            return _in_memory(path, (
                f"{path}: was made by a newer version of this software (catalogue {version}, this one knows {VERSION}) "
                "and is left as it is; the recordings are read anew for this call: update, or remove that file"
            ))  # fmt: skip
        _write_ahead(connection)
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("BEGIN IMMEDIATE")  # tells whether it can be written
        if connection.execute("PRAGMA user_version").fetchone()[0] != VERSION:
            _make(connection)
        elif anew:
            for statement in STATEMENTS:  # temporary tables hide those of the file from this connection
                connection.execute(statement.replace("CREATE TABLE", "CREATE TEMP TABLE"))
        connection.execute("COMMIT")
        connection.execute("SELECT count(*) FROM files, runs LIMIT 1").fetchone()
    except BaseException:
        connection.close()
        raise
    return Opened(connection, path)


def _write_ahead(connection: sqlite3.Connection) -> None:
    """Let readers go on while one writes; SQLite does not wait for the lock that this takes once."""
    ends = time.monotonic() + BUSY_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > ends:
                raise
            time.sleep(0.02)


def replace(connection: sqlite3.Connection) -> None:
    """Put the temporary tables of a connection in place of those in its file, within the transaction that is open."""
    names = [row[0] for row in connection.execute("SELECT name FROM sqlite_temp_master WHERE type = 'table'")]
    rows = {name: connection.execute(f"SELECT * FROM temp.{name}").fetchall() for name in names}
    for name in reversed(names):  # what refers to a table goes before it
        connection.execute(f"DROP TABLE temp.{name}")
    if names:
        _make(connection)
    for name, found in rows.items():
        if found:
            connection.executemany(f"INSERT INTO {name} VALUES ({', '.join('?' * len(found[0]))})", found)


def _make(connection: sqlite3.Connection) -> None:
    """Empty tables in place of whatever is there, within the transaction that is open."""
    names = [row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    for name in reversed(names):
        quoted = name.replace('"', '""')
        connection.execute(f'DROP TABLE IF EXISTS "{quoted}"')
    for statement in STATEMENTS:
        connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {VERSION}")


def _made_again(path: Path, why: str) -> Opened:
    """The database in place of one that is damaged."""
    try:
        for one in (path, *(path.with_name(path.name + end) for end in ("-wal", "-shm"))):
            one.unlink(missing_ok=True)
        opened = _opened(path, anew=True)
    except (sqlite3.Error, OSError):
        return _in_memory(path, f"{path}: is damaged ({why}) and in use; the catalogue is kept in memory for this call")
    return Opened(opened.connection, opened.path, f"{path}: was damaged ({why}) and is made again from the recordings")


def _in_memory(path: Path, said: str) -> Opened:
    """A database in memory, filled from that on disk where it can be read and is of this version."""
    connection = _connect(":memory:")
    with contextlib.suppress(sqlite3.Error, OSError, ValueError):
        source = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        with contextlib.closing(source):
            if source.execute("PRAGMA user_version").fetchone()[0] == VERSION:
                source.backup(connection)
    if connection.execute("PRAGMA user_version").fetchone()[0] != VERSION:
        connection.execute("BEGIN")
        _make(connection)
        connection.execute("COMMIT")
    return Opened(connection, None, said)


def _connect(name: str) -> sqlite3.Connection:
    """A connection that other threads may use, one at a time."""
    connection = sqlite3.connect(name, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
    connection.row_factory = sqlite3.Row
    connection.execute("PRAGMA foreign_keys = ON")
    return connection
