"""The report of recordings: one page that needs nothing but itself, for the screen and for paper.

A section a recording: verdict, figures, steps, residuals, and where the data come from; several recordings are compared
in a table. Every text of a recording is escaped.
"""

from __future__ import annotations

import datetime
import html
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.flights.compare import Comparison, compare
from analysis.flights.table import FlightFlag, Flights
from analysis.loop.result import ClosedLoop
from analysis.report.figures_flights import draw_bifurcations, draw_return_maps, draw_trajectory
from analysis.report.figures_histories import draw_history
from analysis.report.figures_plate import draw_plate
from analysis.report.gamma import GammaScale, gamma_scale
from analysis.report.headline import headline
from analysis.report.interactive import content_policy, flight_columns, inline_figure, json_element, script
from analysis.report.page import COLOURS, loop_figures, loop_parts, plain_html, software_words
from analysis.report.pedigree import calibration_rows, file_rows, rig_rows
from analysis.report.run_style import CAPTIONS, STYLE
from analysis.report.step_table import step_table
from analysis.report.wording import microseconds, plain
from daq.files.whole_file import whole
from daq.recording import Recording
from daq.recording.header import header_of
from daq.recording.notebook import notebook, read_remarks, side_file
from daq.recording.provenance import software_commit, software_version
from daq.recording.verify import VerifyReport
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[str, float], None]
SYMBOLS = {"gamma": "Γ", "gamma_peak": "Γ peak"}
OPEN_VERDICT = "The loop was not closed"


@dataclass(frozen=True)
class Run:
    """A recording with all that its section shows.

    Attributes
    ----------
    recording
        Open.
    state
        What `daq.recording.verify.verify` found.
    flights
        As assembled from the recording.
    loop
        None where the loop was not closed.
    without_loop
        Why it was not, in words.
    """

    recording: Recording
    state: VerifyReport
    flights: Flights
    loop: ClosedLoop | None
    without_loop: str = ""


@dataclass(frozen=True)
class Section:
    """A finished section: its HTML, its row of the comparison, and the sentence at its top."""

    name: str
    simulated: bool
    html: str
    row: tuple[str, ...]
    verdict: str | None
    sentence: str


def section_of(run: Run, number: int, progress: Progress | None = None) -> Section:
    """The section of one recording.

    Parameters
    ----------
    run
        The recording and what was made of it.
    number
        Of the section, from 1; sets the section's names apart.
    progress
        Called with what is being done and the fraction done.
    """
    say = progress or (lambda what, part: None)
    recording, flights, loop = run.recording, run.flights, run.loop
    scale = gamma_scale(recording.setup.forcing, flights.plate.ratio)
    compared = compare(flights, recording.setup, steps_table=recording.steps) if len(flights) else None
    pictures = _Pictures(number, recording, flights, loop, say)
    pictures.measured(compared)
    sentence = headline(loop) if loop is not None else f"{OPEN_VERDICT}: {run.without_loop}."
    name = recording.path.name
    colour = COLOURS[loop.verdict] if loop is not None else "#495057"
    story = (
        []
        if loop is None
        else ["<h3>Residuals: before, after, and why</h3>", *_nested(loop_parts(loop, scale, pictures.loop))]
    )
    parts = [
        f"<section id='run{number}'><h2>{html.escape(name)} {badge(bool(recording.attrs.get('simulated')))}</h2>",
        f"<p class='verdict' style='--c:{colour}'>{_emphasised(sentence)}</p>",
        f"<p class='meta'>{plain_html(scale.definition)}</p>",
        "<h3>Measured and predicted</h3>",
        *(pictures.element(key) for key in ("bifurcation", "return_maps", "history", "trajectory")),
        "<h3>Steps</h3>",
        step_table(recording, compared, loop, scale, flights)
        if compared is not None
        else "<p>No flights were seen.</p>",
        *story,
        "<h3>The plate</h3>",
        pictures.element("motion"),
        "<h3>The rig</h3>",
        table((), rig_rows(recording), "meta"),
        "<h3>Calibrations</h3>",
        table(
            ("quantity", "value", "uncertainty", "date", "age at the run", "source", "remark"),
            calibration_rows(recording),
            "meta",
        ),
        "<h3>Notebook</h3>",
        _notebook(recording),
        "<h3>The data</h3>",
        table((), file_rows(recording, run.state), "meta"),
        *pictures.tables(scale),
        "</section>",
    ]
    row = _summary(run, compared, scale)
    return Section(
        name, bool(recording.attrs.get("simulated")), "\n".join(p for p in parts if p), row,
        None if loop is None else loop.verdict, sentence,
    )  # fmt: skip


def _notebook(recording: Recording) -> str:
    """Tags, and what was noted before, during and after the run."""
    try:
        later = read_remarks(side_file(recording.path))
    except InputError as error:
        return f"<p>{html.escape(str(error))}.</p>"
    entries = [
        (one.at[:16].replace("T", " "), "" if one.at_s is None else f"{one.at_s:.2f} s", one.text)
        for one in notebook(header_of(recording, all_bytes=True), later)
    ]
    tags = f"<p>Tags: {html.escape(', '.join(later.tags))}.</p>" if later.tags else ""
    if not entries:
        return tags or "<p>Nothing was noted.</p>"
    return tags + table(("written (UTC)", "in the run at", "note"), entries, "meta")


def _emphasised(words: str) -> str:
    """The sentences as HTML, the first one bold."""
    first, *others = re.split(r"(?<=[^. ]\.) (?=[A-Z])", words, maxsplit=1)
    return " ".join([f"<b>{plain_html(first)}</b>", *map(plain_html, others)])


def _nested(parts: Iterable[str]) -> list[str]:
    """Headings of a page of its own, one level down."""
    return [p.replace("<h2>", "<h4>").replace("</h2>", "</h4>") for p in parts]


class _Pictures:
    """The figures of one section, as elements, and the data behind their points."""

    def __init__(
        self, number: int, recording: Recording, flights: Flights, loop: ClosedLoop | None, say: Progress
    ) -> None:
        self._number, self._recording, self._flights, self._loop, self._say = number, recording, flights, loop, say
        self._elements: dict[str, str] = {}
        self._figures = {} if loop is None else loop_figures(loop)

    def measured(self, compared: Comparison | None) -> None:
        """Draw the figures of the recording."""
        recording, flights = self._recording, self._flights
        figures: dict[str, Callable[[Figure], None]] = {"motion": partial(draw_plate, recording, flights)}
        if compared is not None:
            figures |= {
                "bifurcation": partial(draw_bifurcations, recording, flights, loop=self._loop),
                "return_maps": partial(draw_return_maps, recording, flights, compared),
                "history": partial(draw_history, recording, flights, compared),
                "trajectory": partial(draw_trajectory, recording, flights),
            }
        for i, (name, draw) in enumerate(figures.items()):
            self._say(f"{recording.path.name}: figure of {name}", i / len(figures))
            self._elements[name] = self._drawn(name, draw, "flights")

    def element(self, name: str) -> str:
        """The element of a drawn figure; empty where there is nothing to draw."""
        return self._elements.get(name, "")

    def loop(self, name: str) -> str:
        """The element of a figure of the closed loop, drawn when it is asked for."""
        return self._drawn(name, self._figures[name], "loop") if name in self._figures else ""

    def _drawn(self, name: str, draw: Callable[[Figure], None], flights: str) -> str:
        made = inline_figure(draw)
        if made is None:
            return ""
        key = f"{name}{self._number}"
        caption = plain_html(" ".join(filter(None, (CAPTIONS.get(name, ""), made.remark))))
        source = html.escape(self._recording.path.name)
        mark = "simulated rig" if self._recording.attrs.get("simulated") else "measured"
        told = f"<figcaption>{caption} <span class='source'>{source}, {mark}.</span></figcaption>"
        if not made.points["row"]:
            return f"<figure>{made.svg}{told}</figure>"
        live = f"data-points='points-{key}' data-flights='{flights}-{self._number}'"
        return f"<figure {live}>{made.svg}{told}{json_element(f'points-{key}', dict(made.points))}</figure>"

    def tables(self, scale: GammaScale) -> list[str]:
        """The tables of flights that the pointer reads."""
        flights = self._flights
        columns = {
            "takeoff_s": flights.takeoff_s, "duration_s": flights.duration_s, "step": flights.step,
            "gamma": scale.factor * flights.gamma, "flags": flights.flags.astype(np.int64),
        }  # fmt: skip
        flags = [str(f.name).lower().replace("_", " ") for f in FlightFlag]
        shown = SYMBOLS[scale.name]
        out = [json_element(f"flights-{self._number}", _told(columns, shown) | {"flags": flags})]
        if self._loop is not None:
            own, steps = self._loop.flights, self._loop.steps
            columns = {
                "takeoff_s": own.takeoff_s, "duration_s": own.landing_s - own.takeoff_s,
                "step": steps.number[own.step], "gamma": scale.factor * steps.gamma[own.step],
                "before_us": 1e6 * own.before.landing_residual_s, "after_us": 1e6 * own.after.landing_residual_s,
            }  # fmt: skip
            out.append(json_element(f"loop-{self._number}", _told(columns, shown)))
        return out


def _told(columns: dict[str, Any], gamma: str) -> dict[str, Any]:
    return {"columns": flight_columns(columns), "gamma": gamma}


def badge(simulated: bool) -> str:
    """Mark of a simulated or a real rig."""
    return (
        '<span class="badge simulated">simulated rig</span>'
        if simulated
        else '<span class="badge">measured on a rig</span>'
    )


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "") -> str:
    """A table of plain texts, escaped."""
    head = f"<thead><tr>{''.join(f'<th>{html.escape(h)}</th>' for h in heads)}</tr></thead>" if heads else ""
    body = "".join(f"<tr>{''.join(f'<td>{plain_html(x)}</td>' for x in row)}</tr>" for row in rows)
    return f"<div class='wide'><table class='{kind}'>{head}<tbody>{body}</tbody></table></div>"


COMPARED = (
    "recording", "begun", "rig", "c", "gamma", "steps", "flights", "lost", "state", "verdict",
    "landings before (µs)", "after (µs)", "noise (µs)", "first bifurcation: measured", "model",
)  # fmt: skip


def _summary(run: Run, compared: Comparison | None, scale: GammaScale) -> tuple[str, ...]:
    """The row of the comparison."""
    recording, loop = run.recording, run.loop
    gammas = [scale.factor * p.gamma for p in run.flights.plate.steps if p is not None]
    found = measured = model = "-"
    if loop is not None:
        found = loop.verdict.replace("_", " ") + (f": {', '.join(plain(n) for n in loop.names)}" if loop.names else "")
    if compared is not None and compared.first.measured is not None:
        low, high = compared.first.measured.gamma_before, compared.first.measured.gamma_after
        measured = f"{compared.first.measured.type}, {scale.factor * low:.4f} .. {scale.factor * high:.4f}"
    if compared is not None and math.isfinite(compared.first.predicted_gamma):
        model = f"{compared.first.predicted_type}, {scale.factor * compared.first.predicted_gamma:.4f}"
    us = ("-", "-", "-") if loop is None else tuple(
        microseconds(x) for x in (loop.before.landing_rms_us, loop.after.landing_rms_us, loop.noise_floor_us)
    )  # fmt: skip
    return (
        recording.path.name,
        str(recording.attrs.get("started") or "unknown")[:16].replace("T", " "),
        recording.setup.name + (" (simulated)" if recording.attrs.get("simulated") else ""),
        ", ".join(str(c) for c in sorted(set(recording.steps["ratio"].tolist()))) or str(recording.setup.forcing.ratio),
        f"{scale.name} {min(gammas):.3f} .. {max(gammas):.3f}" if gammas else "-",
        str(len(recording.steps)),
        str(int((~run.flights.has(FlightFlag.FALSE)).sum())),
        str(run.state.lost_samples),
        run.state.state,
        found,
        *us,
        measured,
        model,
    )


def write_page(sections: Sequence[Section], path: Path) -> None:
    """Write the page of one or more sections; it appears under its name only when it is whole.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    names = html.escape(", ".join(s.name for s in sections))
    own = software_words(software_version(), software_commit())
    made = f"<p class='meta'>Made {datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M} UTC by {html.escape(own)}.</p>"
    compared = ""
    if len(sections) > 1:
        listed = "".join(
            f"<li><a href='#run{i}'>{html.escape(s.name)}</a>: {plain_html(s.sentence)}</li>"
            for i, s in enumerate(sections, 1)
        )
        compared = f"<h2>Comparison</h2><ol>{listed}</ol>{table(COMPARED, [s.row for s in sections], 'small')}"
    head = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f'<meta http-equiv="Content-Security-Policy" content="{content_policy()}">',
        "<meta name='viewport' content='width=device-width'>",
        f"<title>Report: {names}</title><style>{STYLE}</style></head><body>",
        f"<h1>Report of {'a run' if len(sections) == 1 else f'{len(sections)} runs'}</h1>{made}",
        "<p class='meta screen'>Point at a dot to see its flight; click to pin it; Escape takes the pins away.</p>",
    ]
    tail = f"<script>{script()}</script></body></html>"
    try:
        with whole(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
            file.write("\n".join([*head, compared, *(s.html for s in sections), tail]) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error}); name a file in a folder you can write to") from error
