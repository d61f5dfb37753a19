"""Rows of many recordings as one table in a file: Parquet, or CSV by its ending."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from bench.batch.examine import Row
from daq.files.whole_file import whole
from daq.setup.errors import InputError


def columns(rows: Sequence[Row]) -> list[str]:
    """Every column that any row has: the common ones as they come, values of effects by name."""
    names = dict.fromkeys(name for row in rows for name in row)
    return [n for n in names if "." not in n] + sorted(n for n in names if "." in n)


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Write ``rows`` to ``path``, whole or not at all.

    Raises
    ------
    InputError
        For Parquet without pyarrow.
    OSError
        When the disk refuses.
    """
    names = columns(rows)
    with whole(path) as part:
        if path.suffix.lower() != ".parquet":
            with part.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.DictWriter(stream, names, restval="")
                writer.writeheader()
                writer.writerows(rows)
            return
        try:
            from pyarrow import Table, parquet
        except ImportError as error:
            raise InputError(
                f"{path}: Parquet needs pyarrow: pip install 'shakerbench[parquet]'; or name a .csv"
            ) from error
        parquet.write_table(Table.from_pydict({n: [row.get(n) for row in rows] for n in names}), part)
