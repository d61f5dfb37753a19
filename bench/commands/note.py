"""`bench note`: what a person has to say of a recording after the run."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs
from bench.terminal.console import readable
from daq.setup.errors import InputError


def command(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording that the note is about."),
    text: str | None = typer.Argument(None, metavar="TEXT", help="The note; left out: the notes are shown."),
    undo: bool = typer.Option(False, "--undo", help="Take back the latest note."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Add a note, with its time, to a recording; it lies in a file next to it. Without a text: the whole notebook.

    Example: bench note runs/monday.h5 "plate screws were loose"
    """
    from bench.runs.marking import changed_remarks
    from daq.recording.notebook import with_note, without_last_note

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    said = readable(text)
    if undo and said is not None:
        raise InputError("--undo takes back the latest note; leave out the text, or leave out --undo")
    change = without_last_note if undo else None if said is None else lambda now: with_note(now, said)
    changed_remarks(recording, change, json)
