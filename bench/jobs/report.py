"""The report of recordings: flights, a closed loop that is at hand or is computed, and a section for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.jobs.loops.keep_verdict import keep_verdict, verdict_file
from bench.terminal.console import DEFECTS
from bench.terminal.progress import progress_bar
from daq.recording import Recording, open_recording
from daq.recording.event_changes import BY_HAND, in_words
from daq.recording.verify import verify
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from analysis.flights.table import Flights
    from analysis.loop.result import ClosedLoop
    from analysis.report.run_page import Section


@dataclass(frozen=True)
class Reported:
    """A section of the report, and where its closed loop comes from: ``saved``, ``computed`` or ``none``."""

    path: Path
    section: Section
    state: str
    flights: int
    lost_samples: int
    loop: str


def report(recordings: Sequence[Path], *, with_loop: bool, say: Callable[[str], None], quiet: bool) -> list[Reported]:
    """Sections of the recordings, in their order; one recording is held at a time.

    Raises
    ------
    InputError
        When a recording cannot be read.
    """
    from analysis.flights.assemble import flights_of
    from analysis.flights.table import FlightFlag
    from analysis.report.run_page import Run, section_of

    out = []
    for number, path in enumerate(recordings, 1):
        found = verify(path)
        with open_recording(path) as recording, progress_bar(quiet) as bar:
            flights = flights_of(recording, progress=lambda part: bar(f"reading {path.name}", 0.3 * part))  # noqa: B023
            loop, source, why = None, "none", "it was left out of this page"
            if with_loop:
                loop, source, why = _loop(recording, flights, say=say, bar=bar)
            run = Run(recording, found, flights, loop, why)
            n = int((~flights.has(FlightFlag.FALSE)).sum())
            section = section_of(run, number, lambda what, part: bar(what, 0.8 + 0.2 * part))
            out.append(Reported(path, section, found.state, n, found.lost_samples, source))
    return out


def _loop(
    recording: Recording,
    flights: Flights,
    *,
    say: Callable[[str], None],
    bar: Callable[[str, float], None],
) -> tuple[ClosedLoop | None, str, str]:
    """The saved answer where it belongs to the recording, else a new one; its source; or why there is none."""
    from analysis.loop.close_loop import close_loop
    from analysis.loop.storage import load_verdict

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
    """Why a saved answer is not this recording's, in words; empty where it is.

    File name, date, profile and, to the last digit, every take-off time have to agree.
    """
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
