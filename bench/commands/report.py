"""`bench report`: one page a physicist can read, print and file, for one recording or several."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bench.outputs import Overwrite

if TYPE_CHECKING:
    from bench.jobs.report import Reported


def command(
    recordings: list[Path] = typer.Argument(metavar="REC.h5...", help="Recordings (HDF5), a section each."),
    out: Path = typer.Option(..., "--out", "-o", metavar="PAGE.html", help="Page to write; it needs no other file."),
    pdf: Path | None = typer.Option(None, "--pdf", metavar="FILE.pdf", help="Print it there as well."),
    no_loop: bool = typer.Option(False, "--no-loop", help="Leave the closed loop out."),
    json: str | None = typer.Option(None, "--json", metavar="FILE", help="The summary for a machine; - prints it."),
    overwrite: Overwrite = False,
) -> None:
    """Report of recordings as one HTML page: verdict, figures, steps, residuals, rig, calibrations, provenance.

    A closed loop saved next to a recording (REC.loop) is used where it belongs to it; else the loop is closed, which
    takes a while, and saved there. Point at a dot to see its flight. --pdf needs Chromium, Chrome, Edge or WeasyPrint.

    Example: bench report run.h5 --out run.html --pdf run.pdf
    """
    from analysis.report.run_page import write_page
    from bench.jobs.print_pdf import print_pdf, refuse_without_printer
    from bench.jobs.report import report
    from bench.outputs import HTML, JSON, PDF, File, check_outputs
    from bench.terminal.console import EXIT_FAILED, EXIT_USAGE, fail, speaker, write_json
    from daq.recording.identity import refuse_repeated
    from daq.setup.errors import InputError

    quiet = json == "-"
    say = speaker(quiet)
    try:
        check_outputs(
            File("--out", out, HTML), File("--pdf", pdf, PDF), File("--json", json, JSON),
            inputs=recordings, overwrite=overwrite,
        )  # fmt: skip
        if pdf is not None:
            refuse_without_printer()
        refuse_repeated(recordings)
        found = report(recordings, with_loop=not no_loop, say=say, quiet=quiet)
    except InputError as error:
        fail(str(error), EXIT_USAGE)
    except OSError as error:
        fail(f"{error}; name files that can be read", EXIT_USAGE)
    try:
        write_page([one.section for one in found], out)
        if pdf is not None:
            print_pdf(out, pdf)
        write_json(as_json(found, out, pdf), json)
    except InputError as error:
        fail(str(error), EXIT_FAILED)
    except OSError as error:
        fail(f"{error}; free some space, or name files that can be written", EXIT_FAILED)
    for one in found:
        say(f"{one.path.name}: {one.section.sentence}")
    say(f"report: {out}" + (f" and {pdf}" if pdf is not None else ""))


def as_json(found: list[Reported], out: Path, pdf: Path | None) -> dict[str, Any]:
    """The sentences at the top of the page, for a machine."""
    return {
        "file": out,
        "pdf": pdf,
        "runs": [
            {
                "recording": one.path,
                "simulated": one.section.simulated,
                "state": one.state,
                "lost_samples": one.lost_samples,
                "flights": one.flights,
                "loop": one.loop,
                "verdict": one.section.verdict,
                "sentence": one.section.sentence,
            }
            for one in found
        ],
    }
