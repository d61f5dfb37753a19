"""Cells of text tables, under the name by which drop tests know them (`daq.importers.tables` has them)."""

from __future__ import annotations

from pathlib import Path

from daq.importers import tables
from daq.importers.tables import Cell, number_or_text

__all__ = ["Cell", "number_or_text", "text_rows"]


def text_rows(path: Path) -> list[list[Cell]]:
    """Rows of a text table."""
    return tables.text_rows(path, path.read_bytes())
