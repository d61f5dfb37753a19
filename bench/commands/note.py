"""`bench note`: what a person has to say of a recording after the run."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import Overwrite


def command(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording that the note is about."),
    text: str | None = typer.Argument(None, metavar="TEXT", help="The note; left out: the notes are shown."),
    undo: bool = typer.Option(False, "--undo", help="Take back the latest note."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The same for a machine; - prints it."),
    overwrite: Overwrite = False,
) -> None:
    """Add a note, with its time, to a recording; it lies in a small file beside it. Without a text: the whole notebook.

    Example: bench note runs/monday.h5 "plate screws were loose"
    """
    from bench.outputs import JSON, File, check_outputs
    from bench.runs.marking import as_json, header_of_file, lines
    from bench.terminal.console import EXIT_USAGE, fail, print_lines, readable, write_json
    from daq.recording.notebook import change_remarks, read_remarks, side_file, with_note, without_last_note
    from daq.setup.errors import InputError

    try:
        check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
        header, said = header_of_file(recording), readable(text)
        identity = "" if header is None else header.identity
        if undo and said is not None:
            raise InputError("--undo takes back the latest note; leave out the text, or leave out --undo")
        if undo:
            changed = change_remarks(recording, identity, without_last_note)
        elif said is not None:
            changed = change_remarks(recording, identity, lambda now: with_note(now, said))
        else:
            changed = read_remarks(side_file(recording))
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    write_json(as_json(recording, header, changed), json)
    if json != "-":
        print_lines(*lines(recording, header, changed))
