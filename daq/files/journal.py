"""Results kept as they come in: one JSON object a line, on the disk before the next one is begun.

A program that is killed loses no line that was written; a last line that was cut off is left out.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from daq.setup.errors import InputError

Row = dict[str, Any]


class Journal:
    """Rows by key in a file that only grows; of rows with one key the last counts.

    Parameters
    ----------
    path
        Where it is kept; made by the first row.

    Attributes
    ----------
    path
    rows : dict
        The rows so far, by key.

    Raises
    ------
    InputError
        Where the file holds something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, Row] = {}
        text = path.read_bytes() if path.exists() else b""
        lines = text.split(b"\n")
        for number, line in enumerate(lines[:-1], start=1):
            self._read(line, number)
        self._torn = bool(lines[-1])
        self._whole_bytes = len(text) - len(lines[-1])

    def _read(self, line: bytes, number: int) -> None:
        if not line.strip():
            return
        try:
            entry = json.loads(line)
            self.rows[str(entry["key"])] = dict(entry["row"])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{self.path}, line {number}: wanted a result written by this program ({error}); name another file, or "
                "remove the line"
            ) from error

    def add(self, key: str, row: Row) -> None:
        """Keep a row; it is on the disk when this returns (raises OSError)."""
        line = json.dumps({"key": key, "row": row}, allow_nan=False)
        if self._torn:
            os.truncate(self.path, self._whole_bytes)
            self._torn = False
        with self.path.open("ab") as stream:
            stream.write(line.encode() + b"\n")
            stream.flush()
            os.fsync(stream.fileno())
        self.rows[key] = row
