"""What the commands tag and note share: whose the remarks are, and how they are shown."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench.runs.remarks import Remarks
from daq.recording.header import Header, read_headers
from daq.setup.errors import InputError, require_file


def identity_of(recording: Path) -> str:
    """Identity of a recording; empty where it is not closed, or damaged.

    Raises
    ------
    InputError
        Where the file is missing, or no recording.
    """
    require_file(recording)
    for _, found in read_headers([recording]):
        if isinstance(found, Header):
            return found.identity
        if not found.damaged or "does not begin" in found.why:
            raise InputError(f"{recording}: {found.why}; wanted a recording")
    return ""


def as_json(recording: Path, remarks: Remarks) -> dict[str, Any]:
    """Tags and notes for a machine."""
    return {"file": str(recording), "tags": list(remarks.tags), "notes": [asdict(note) for note in remarks.notes]}


def lines(recording: Path, remarks: Remarks) -> list[str]:
    """Tags and notes for a person."""
    shown = [f"{note.at[:16].replace('T', ' ')}  {' '.join(note.text.split())}" for note in remarks.notes]
    return [f"{recording}: {' '.join(remarks.tags) or 'no tags'}", *(f"  {line}" for line in shown)]
