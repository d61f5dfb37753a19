"""`bench tag` and `bench note`: words by which recordings are found again, and what a person has to say of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import print_lines, readable, write_json
from daq.setup.errors import InputError, require_file

if TYPE_CHECKING:
    from daq.recording.notebook import Remarks


def tag(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording to tag."),
    tags: list[str] = typer.Argument(metavar="TAG...", help="Single words."),
    remove: bool = typer.Option(False, "--remove", help="Take these tags away."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Tag a recording; the tags lie in a small file next to it, and the recording stays as it is.

    Example: bench tag runs/monday.h5 new-spring warm
    """
    from daq.recording.notebook import with_tags

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    _changed(recording, lambda now: with_tags(now, tuple(tags), remove=remove), json)


def note(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording that the note is about."),
    text: str | None = typer.Argument(None, metavar="TEXT", help="The note; left out: the notes are shown."),
    undo: bool = typer.Option(False, "--undo", help="Take back the latest note."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Add a note, with its time, to a recording; it lies in a file next to it. Without a text: the whole notebook.

    Example: bench note runs/monday.h5 "plate screws were loose"
    """
    from daq.recording.notebook import with_note, without_last_note

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    said = readable(text)
    if undo and said is not None:
        raise InputError("--undo takes back the latest note; leave out the text, or leave out --undo")
    change = without_last_note if undo else None if said is None else lambda now: with_note(now, said)
    _changed(recording, change, json)


def _changed(recording: Path, change: Callable[[Remarks], Remarks] | None, json: str | None) -> None:
    """Change the remarks on a recording, and show its tags and its whole notebook, as JSON where that is asked for.

    Raises `InputError` where the file is missing or no recording, or ``change`` refuses.
    """
    from daq.recording.header import Header, read_headers
    from daq.recording.notebook import as_line, change_remarks, notebook, read_remarks, side_file

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
