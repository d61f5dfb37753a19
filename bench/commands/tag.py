"""`bench tag`: words by which recordings are found again."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import JSON, File, Json, Overwrite, check_outputs


def command(
    recording: Path = typer.Argument(metavar="REC.h5", help="Recording to tag."),
    tags: list[str] = typer.Argument(metavar="TAG...", help="Single words."),
    remove: bool = typer.Option(False, "--remove", help="Take these tags away."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Tag a recording; the tags lie in a small file next to it, and the recording stays as it is.

    Example: bench tag runs/monday.h5 new-spring warm
    """
    from bench.runs.marking import changed_remarks
    from daq.recording.notebook import with_tags

    check_outputs(File("--json", json, JSON), inputs=[recording], overwrite=overwrite)
    changed_remarks(recording, lambda now: with_tags(now, tuple(tags), remove=remove), json)
