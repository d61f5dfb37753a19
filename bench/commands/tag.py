"""`bench tag`: words by which recordings are found again."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import Overwrite


def command(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording to tag."),
    tags: list[str] = typer.Argument(metavar="TAG...", help="Single words."),
    remove: bool = typer.Option(False, "--remove", help="Take these tags away."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The same for a machine; - prints it."),
    overwrite: Overwrite = False,
) -> None:
    """Tag a recording; the tags lie in a small file beside it, and the recording stays as it is.

    Example: bench tag runs/monday.h5 new-spring warm
    """
    from bench.outputs import JSON, File, check_outputs
    from bench.runs.marking import as_json, header_of_file, lines
    from bench.terminal.console import EXIT_USAGE, fail, print_lines, write_json
    from daq.recording.notebook import change_remarks, with_tags
    from daq.setup.errors import InputError

    try:
        check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
        header = header_of_file(recording)
        identity = "" if header is None else header.identity
        changed = change_remarks(recording, identity, lambda now: with_tags(now, tuple(tags), remove=remove))
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    write_json(as_json(recording, header, changed), json)
    if json != "-":
        print_lines(*lines(recording, header, changed))
