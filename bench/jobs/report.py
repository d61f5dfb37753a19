"""The report of recordings: flights and pictures, a closed loop at hand or computed, a section each, and paper."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.flights.assemble import Flights, flights_of
from analysis.flights.compare import Comparison
from analysis.flights.table import FlightFlag
from analysis.loop.close_loop import close_loop
from analysis.loop.result import ClosedLoop, load_verdict
from bench.jobs.loops import keep_verdict, verdict_file
from bench.terminal.console import DEFECTS, progress_bar
from daq.files.disk import whole
from daq.recording import Recording, open_recording
from daq.recording.notebook import BY_HAND, in_words
from daq.recording.verify import verify
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from analysis.report.run_page import Section


def sections_of(
    recordings: Sequence[Path], *, with_loop: bool, say: Callable[[str], None], quiet: bool
) -> tuple[list[Section], list[dict[str, Any]]]:
    """Sections of the recordings, in their order, and an answer for scripts of each (raises `InputError`).

    An answer's ``loop`` says where its closed loop comes from: ``saved``, ``computed`` or ``none``.
    """
    from analysis.report.figures.flights import measured
    from analysis.report.run_page import section_of

    sections, answers = [], []
    for number, path in enumerate(recordings, 1):
        found = verify(path)
        with open_recording(path) as recording, progress_bar(quiet) as bar:
            flights = flights_of(recording, progress=lambda part: bar(f"reading {path.name}", 0.3 * part))  # noqa: B023
            loop, source, why = None, "none", "it was left out of this page"
            if with_loop:
                loop, source, why = _loop(recording, flights, say=say, bar=bar)
            shown = measured(recording, flights, loop=loop)
            section = section_of(shown, found, number, why, lambda what, part: bar(what, 0.8 + 0.2 * part))
            sections.append(section)
            answers.append({
                "recording": path,
                "simulated": bool(recording.attrs.get("simulated")),
                "state": found.state,
                "lost_samples": found.lost_samples,
                "flights": int((~flights.has(FlightFlag.FALSE)).sum()),
                "loop": source,
                "verdict": None if loop is None else loop.verdict,
                "sentence": section.sentence,
            })  # fmt: skip
    return sections, answers


def _loop(
    recording: Recording, flights: Flights, *, say: Callable[[str], None], bar: Callable[[str, float], None]
) -> tuple[ClosedLoop | None, str, str]:
    """The saved answer where it belongs to the recording, else a new one; its source; or why there is none."""
    saved = verdict_file([recording.path])
    if saved.is_file():
        try:
            loop = load_verdict(saved)
            other = not_of(loop, recording, flights)
        except InputError as error:
            other = str(error)
        if not other:
            return loop, "saved", ""
        say(f"{saved.name} is not used: {other}")
    try:
        loop = close_loop([recording.path], progress=lambda what, part: bar(what, 0.3 + 0.5 * part))
    except InputError as error:
        return None, "none", str(error).rstrip(".")
    except DEFECTS as error:  # the page of what was measured is worth having without a verdict
        return None, "none", f"a defect of shakerbench ended it ({type(error).__name__}: {error})".rstrip(".")
    if problem := keep_verdict(loop, [recording.path]):
        say(problem)
    return loop, "computed", ""


def not_of(loop: ClosedLoop, recording: Recording, flights: Flights) -> str:
    """Why a saved answer is not this recording's; empty where date, profile and, to the last digit, take-offs agree."""
    if len(loop.sources) != 1:
        return f"it was found from {len(loop.sources)} recordings together"
    source = loop.sources[0]
    if source.started != str(recording.attrs.get("started", "")):
        return f"it belongs to a recording begun {source.started or 'at an unknown time'}"
    if loop.setup != recording.setup:
        return "it was found with another profile"
    if {line for line in loop.notes if BY_HAND in line} != set(in_words(flights.edges.by_hand)):
        return "events of the recording were changed by hand since"
    if not np.isin(loop.flights.takeoff_s, flights.takeoff_s).all():
        return "its flights are not those of the recording"
    return ""


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
PLACES = (  # where the installers of macOS and Windows put one
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    "C:/Program Files/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Microsoft/Edge/Application/msedge.exe",
)


def browser() -> str | None:
    """A browser that prints without a window, or None."""
    named = (shutil.which(name) for name in BROWSERS)
    return next((found for found in (*named, *PLACES) if found and Path(found).is_file()), None)


def refuse_without_printer() -> None:
    """Refuse early where nothing can make a PDF (raises InputError)."""
    if browser() is not None:
        return
    try:
        import weasyprint  # noqa: F401
    except (ImportError, OSError) as error:  # OSError: the libraries behind it are not there
        raise InputError(
            "--pdf: neither Chromium, Chrome or Edge nor WeasyPrint was found; install one of them, or open the page "
            "in any browser and print it to a PDF"
        ) from error


def print_pdf(page: Path, pdf: Path) -> None:
    """Print the page ``page`` to ``pdf``, which appears only when it is whole; raises `InputError` where it cannot."""
    found = browser()
    with whole(pdf) as part, tempfile.TemporaryDirectory() as folder:
        if found is None:
            from weasyprint import HTML

            HTML(filename=str(page)).write_pdf(str(part))
            return
        made = Path(folder) / "page.pdf"
        root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []  # Chromium refuses root one
        call = [
            found, "--headless", *root, "--disable-gpu", "--disable-extensions", "--disable-dev-shm-usage",
            f"--user-data-dir={Path(folder) / 'profile'}", "--no-first-run", "--no-pdf-header-footer",
            f"--print-to-pdf={made}", page.resolve().as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(call, capture_output=True, text=True, errors="replace", timeout=180.0, check=False)
        except subprocess.TimeoutExpired:
            raise InputError(f"{page}: {found} did not print it in 180 s; print it from a browser") from None
        if done.returncode != 0 or not made.is_file():
            last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise InputError(
                f"{page}: {found} could not print it ({last}); open the page in a browser and print it there"
            )
        shutil.copyfile(made, part)


def flights_with_progress(opened: Recording, *, quiet: bool) -> Flights:
    """The flights, with a bar on standard error while the file is read."""
    with progress_bar(quiet) as bar:
        return flights_of(opened, progress=lambda part: bar(f"reading {opened.path.name}", part))


def draw(opened: Recording, table: Flights, folder: Path, held: Comparison | None = None) -> None:
    """Every picture of a recording, into ``folder``; ``held`` is its comparison with the declared model, if known."""
    from analysis.report.figures.flights import measured
    from analysis.report.figures.recording import FIGURES
    from analysis.report.figures.style import badge_of, save_picture

    badge = badge_of(opened)
    shown = measured(opened, table, held)
    for figure in FIGURES:
        save_picture(folder, figure.name, badge, partial(figure.draw, shown))
