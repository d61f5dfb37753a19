"""The work of the commands tag and note: remarks on a recording, changed and shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.terminal.console import print_lines, write_json
from daq.recording.header import Header, read_headers
from daq.recording.notebook import Remarks, as_line, change_remarks, notebook, read_remarks, side_file
from daq.setup.errors import InputError, require_file


def changed_remarks(recording: Path, change: Callable[[Remarks], Remarks] | None, json: str | None) -> None:
    """Change the remarks on a recording, and show its tags and its whole notebook, as JSON where that is asked for.

    Raises `InputError` where the file is missing or no recording, or ``change`` refuses.
    """
    require_file(recording)
    header = None  # of a damaged recording there is none
    for _, found in read_headers([recording]):
        if isinstance(found, Header):
            header = found
        elif not found.damaged or "does not begin" in found.why:
            raise InputError(f"{recording}: {found.why}; wanted a recording")
    identity = "" if header is None else header.identity
    now = read_remarks(side_file(recording)) if change is None else change_remarks(recording, identity, change)
    notes = notebook(header, now)
    if write_json({"file": recording, "tags": now.tags, "notes": notes}, json):
        print_lines(f"{recording}: {' '.join(now.tags) or 'no tags'}", *(f"  {as_line(note)}" for note in notes))
