"""`bench report`: one page a physicist can read, print and file, for one recording or several."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import HTML, JSON, PDF, File, Json, Overwrite, check_outputs
from bench.terminal.console import fail, speaker, write_json
from daq.setup.errors import InputError


def command(
    recordings: list[Path] = typer.Argument(metavar="REC.h5...", help="Recordings (HDF5), a section each."),
    out: Path = typer.Option(..., "--out", "-o", metavar="PAGE.html", help="Page to write; it needs no other file."),
    pdf: Path | None = typer.Option(None, "--pdf", metavar="FILE.pdf", help="Print it there as well."),
    no_loop: bool = typer.Option(False, "--no-loop", help="Leave the closed loop out."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Report of recordings as one HTML page: verdict, figures, steps, residuals, rig, calibrations, provenance.

    A closed loop saved next to a recording (REC.loop) is used where it belongs to it; else the loop is closed, which
    takes a while, and saved there. Point at a dot to see its flight. --pdf needs Chromium, Chrome, Edge or WeasyPrint.

    Example: bench report run.h5 --out run.html --pdf run.pdf
    """
    from analysis.report.run_page import write_page
    from bench.jobs.report import print_pdf, refuse_without_printer, report
    from daq.recording.header import refuse_repeated

    check_outputs(
        File("--out", out, HTML), File("--pdf", pdf, PDF), File("--json", json, JSON),
        inputs=recordings, overwrite=overwrite,
    )  # fmt: skip
    if pdf is not None:
        refuse_without_printer()
    refuse_repeated(recordings)
    say = speaker(json == "-")
    sections, answers = report(recordings, with_loop=not no_loop, say=say, quiet=json == "-")
    write_page(sections, out)
    if pdf is not None:
        try:
            print_pdf(out, pdf)
        except InputError as error:  # the page is there: a browser failed, the call was right
            fail(str(error))
    write_json({"file": out, "pdf": pdf, "runs": answers}, json)
    for one in sections:
        say(f"{one.name}: {one.sentence}")
    say(f"report: {out}" + (f" and {pdf}" if pdf is not None else ""))
