"""Remarks for the commands tag and note: the recording they belong to, and the notebook as text."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from daq.recording.header import Header, read_headers
from daq.recording.notebook import Remarks, as_line, notebook
from daq.setup.errors import InputError, require_file


def header_of_file(recording: Path) -> Header | None:
    """Header of a recording; None where it is damaged.

    Raises
    ------
    InputError
        Where the file is missing, or no recording.
    """
    require_file(recording)
    for _, found in read_headers([recording]):
        if isinstance(found, Header):
            return found
        if not found.damaged or "does not begin" in found.why:
            raise InputError(f"{recording}: {found.why}; wanted a recording")
    return None


def as_json(recording: Path, header: Header | None, remarks: Remarks) -> dict[str, Any]:
    """Tags and the whole notebook for a machine."""
    notes = [asdict(note) for note in notebook(header, remarks)]
    return {"file": str(recording), "tags": list(remarks.tags), "notes": notes}


def lines(recording: Path, header: Header | None, remarks: Remarks) -> list[str]:
    """Tags and the whole notebook for a person."""
    shown = [f"  {as_line(note)}" for note in notebook(header, remarks)]
    return [f"{recording}: {' '.join(remarks.tags) or 'no tags'}", *shown]
