"""The report of recordings: one page that needs nothing but itself, for the screen and for paper.

A section a recording: verdict, figures, steps, residuals, and where the data come from; several recordings are compared
in a table. Figures are inline SVG that names the flights behind its points (`name_flights`): the page's script finds
the point nearest to the pointer; paper shows the same vectors.
"""

from __future__ import annotations

import base64
import datetime
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.flights.table import FlightFlag
from analysis.loop.verdict import short_verdict
from analysis.report import page
from analysis.report.figures import loop as of_loop
from analysis.report.figures import recording as of_recording
from analysis.report.figures import style
from analysis.report.figures.flights import Measured
from analysis.report.narrative import headline
from analysis.report.page import Drawn, Progress
from analysis.report.wording import GammaScale, fixed, gamma_scale, microseconds, plain
from analysis.statistics import mad_sigma
from daq.files.disk import whole
from daq.recording import Recording
from daq.recording.header import header_of
from daq.recording.notebook import in_words, notebook, read_remarks, side_file
from daq.recording.verify import VerifyReport
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version

MOST_VECTOR_POINTS = 15_000  # in one figure; with more of them the dots are one picture under vector axes
MOST_HOVER_POINTS = 60_000  # in one figure that the pointer can name; of more, every second, third, ... one


def inline_figure(row: style.Figure, draw: Callable[[Figure], None], key: str = "", flights: str = "") -> Drawn | None:
    """A new figure, filled by ``draw``, as inline SVG; None where that draws no axes.

    ``row``, ``key`` and ``flights`` are those of `Drawn`; its points are the named ones, of a page's many some.
    """
    with matplotlib.rc_context({**style.STYLE, "svg.fonttype": "path"}):  # the reader's machine lacks TeX's fonts
        figure = Figure(layout="constrained")
        draw(figure)
        if not figure.axes:
            return None
        dots = [line for ax in figure.axes for line in ax.lines]
        named = [line for line in dots if hasattr(line, style.FLIGHT_ROWS)]
        sizes = [0 if line.get_rasterized() else int(np.isfinite(line.get_xydata()).all(axis=1).sum()) for line in dots]
        n = sum(sizes)
        if n > MOST_VECTOR_POINTS:
            for line, size in zip(dots, sizes, strict=True):
                # a line of more than 500 dots joins the picture
                line.set_rasterized(bool(line.get_rasterized()) or size > 500)
        out = io.BytesIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
        points, known = _points(figure, named)
    text = out.getvalue().decode("utf-8")
    element = re.sub(r"\s*<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL).strip()
    remarks = []
    if n > MOST_VECTOR_POINTS:
        remarks.append(f"Its {n} points are drawn as a picture; axes and text are vectors.")
    if known[0] < known[1]:
        remarks.append(f"The pointer knows {known[0]} of the {known[1]} points, evenly chosen.")
    return Drawn(row, Markup(element), " ".join(remarks), key, flights, points if points["row"] else None)


def _points(figure: Figure, lines: list[Any]) -> tuple[dict[str, str], tuple[int, int]]:
    """Places (in the SVG's units) and rows of the named points, and how many of them the page holds, of how many."""
    places, rows = [np.zeros((0, 2))], [np.zeros(0, np.int64)]
    for line in lines:
        places.append(line.get_transform().transform(np.column_stack([line.get_xdata(), line.get_ydata()])))
        rows.append(getattr(line, style.FLIGHT_ROWS))
    place, row = np.concatenate(places) * (72.0 / figure.dpi), np.concatenate(rows)
    seen = np.isfinite(place).all(axis=1)
    place, row = place[seen], row[seen]
    stride = max(1, -(-len(row) // MOST_HOVER_POINTS))
    shown, y = place[::stride], 72.0 * figure.get_figheight()
    coded = {"x": packed(shown[:, 0], "<f4"), "y": packed(y - shown[:, 1], "<f4"), "row": packed(row[::stride], "<i4")}
    return coded, (len(shown), len(row))


def packed(values: Any, kind: str) -> str:
    """Numbers as base64 of the little-endian type ``kind``."""
    return base64.b64encode(np.ascontiguousarray(values, kind).tobytes()).decode("ascii")


def flight_columns(columns: Mapping[str, NDArray[Any]]) -> dict[str, str]:
    """Columns of a table of flights for the script: whole numbers as ``i4``, others as ``f8``, by name."""
    return {
        name: ("i4:" + packed(x, "<i4")) if np.issubdtype(x.dtype, np.integer) else "f8:" + packed(x, "<f8")
        for name, x in columns.items()
    }


SYMBOLS = {"gamma": "Γ", "gamma_peak": "Γ peak"}


@dataclass(frozen=True)
class Section:
    """A finished section: its HTML, its row of the comparison, and the sentence at its top."""

    name: str
    html: Markup
    row: tuple[str, ...]
    sentence: str


def section_of(
    shown: Measured, found: VerifyReport, number: int, without_loop: str = "", progress: Progress | None = None
) -> Section:
    """The section of one recording, which has the state ``found``; ``number``, from 1, is part of every name in it.

    ``without_loop`` says why the loop was not closed; ``progress`` is called with what is done and the fraction done.
    """
    recording, flights, loop = shown.recording, shown.flights, shown.loop
    scale = gamma_scale(recording.setup.forcing, flights.plate.ratio)
    simulated = bool(recording.attrs.get("simulated"))
    sentence = headline(loop) if loop is not None else f"The loop was not closed: {without_loop}."
    first, *more = re.split(r"(?<=[^. ]\.) (?=[A-Z])", sentence, maxsplit=1)
    html = page.fill(
        "section.html", number=number, recording=recording, simulated=simulated, closed=loop, scale=scale,
        first_sentence=first, more=" ".join(more),
        drawn=_drawn(shown, number, progress or (lambda what, part: None)),
        source=page.source_words(recording.path.name, simulated=simulated),
        steps=_step_table(shown, scale), rig=page.rig_rows(recording), calibrations=page.calibration_rows(recording),
        notebook=_notebook(recording), file=page.file_rows(recording, found), term_effect=None, level=4,
        first={} if loop is None else page.first_bifurcations(loop, flights),
        pointed=_flights_behind(shown, number, scale), by_hand=in_words(flights.edges.by_hand),
    )  # fmt: skip
    return Section(recording.path.name, html, _summary(shown, found, scale), sentence)


def _drawn(shown: Measured, number: int, say: Progress) -> list[Drawn]:
    """Figures of the recording and of its closed loop, as elements."""
    figures = [(figure, partial(figure.draw, shown), "flights") for figure in of_recording.FIGURES]
    if shown.loop is not None:
        figures += [(figure, partial(figure.draw, shown.loop), "loop") for figure in of_loop.FIGURES]
    out = []
    for i, (figure, draw, table) in enumerate(figures):
        say(f"{shown.recording.path.name}: figure of {figure.name}", i / len(figures))
        out.append(inline_figure(figure, draw, f"{figure.name}{number}", f"{table}-{number}"))
    return [one for one in out if one is not None]


def _notebook(recording: Recording) -> dict[str, Any]:
    """Tags, and what was noted before, during and after the run; or the problem: why it cannot be read."""
    try:
        later = read_remarks(side_file(recording.path))
    except InputError as error:
        return {"tags": (), "entries": [], "problem": str(error)}
    entries = [
        (one.at[:16].replace("T", " "), "" if one.at_s is None else f"{one.at_s:.2f} s", one.text)
        for one in notebook(header_of(recording, all_bytes=True), later)
    ]
    return {"tags": later.tags, "entries": entries, "problem": ""}


def _flights_behind(shown: Measured, number: int, scale: GammaScale) -> dict[str, dict[str, Any]]:
    """The tables of flights that the pointer reads, by their names in the page."""
    flights, loop = shown.flights, shown.loop
    columns = {
        "takeoff_s": flights.takeoff_s, "duration_s": flights.duration_s, "step": flights.step,
        "gamma": scale.factor * flights.gamma, "flags": flights.flags.astype(np.int64),
    }  # fmt: skip
    flags = [str(f.name).lower().replace("_", " ") for f in FlightFlag]
    symbol = SYMBOLS[scale.name]
    out: dict[str, dict[str, Any]] = {
        f"flights-{number}": {"columns": flight_columns(columns), "gamma": symbol, "flags": flags}
    }
    if loop is not None:
        own, steps = loop.flights, loop.steps
        columns = {
            "takeoff_s": own.takeoff_s, "duration_s": own.landing_s - own.takeoff_s,
            "step": steps.number[own.step], "gamma": scale.factor * steps.gamma[own.step],
            "before_us": 1e6 * own.before.landing_residual_s, "after_us": 1e6 * own.after.landing_residual_s,
        }  # fmt: skip
        out[f"loop-{number}"] = {"columns": flight_columns(columns), "gamma": symbol}
    return out


HEADS = (
    "step", "gamma set", "reached", "+-", "measured", "model", "flights", "mean flight time (ms)", "over model",
    "rms to model (us)",
)  # fmt: skip
ERRORS = ("landing error before (us)", "after (us)")


def _step_table(shown: Measured, scale: GammaScale) -> tuple[list[str], list[list[str]]] | None:
    """Headings and a row for each step: set and reached, measured and predicted, error before and after (robust).

    Held-out steps have a star. None where no flight was seen.
    """
    loop = shown.loop
    if shown.compared is None:
        return None
    held = set(loop.held_out) if loop is not None else set()
    errors = [] if loop is None else [
        dict(zip(loop.steps.number.tolist(), of_loop.by_step(loop, side.landing_residual_s, mad_sigma), strict=True))
        for side in (loop.flights.before, loop.flights.after)
    ]  # fmt: skip
    rows = []
    for own in shown.compared.steps:
        plate, stated = shown.flights.plate.steps[own.step], shown.recording.steps[own.step]
        cells = [
            f"{own.step}{'*' if own.step in held else ''}",
            fixed(scale.factor * float(stated["gamma"]), 4),
            fixed(scale.factor * own.gamma, 4),
            fixed(scale.factor * plate.gamma_uncertainty if plate is not None else math.nan, 4),
            own.measured.label,
            own.predicted,
            str(own.measured.flights),
            fixed(1e3 * own.measured.mean_s, 3),
            fixed(own.mean_ratio, 4),
            fixed(1e6 * own.rms_s, 1) + (f" ({own.unfit_reason})" if own.unfit_reason else ""),
        ]
        rows.append([*cells, *(fixed(of_side.get(own.step, math.nan), 1) for of_side in errors)])
    heads = [head.replace("gamma", scale.name) for head in HEADS] + (list(ERRORS) if loop is not None else [])
    return heads, rows


COMPARED = (
    "recording", "begun", "rig", "c", "gamma", "steps", "flights", "lost", "state", "verdict",
    "landings before (us)", "after (us)", "noise (us)", "first bifurcation: measured", "model",
)  # fmt: skip


def _summary(shown: Measured, found: VerifyReport, scale: GammaScale) -> tuple[str, ...]:
    """The row of the comparison."""
    recording, loop, compared = shown.recording, shown.loop, shown.compared
    gammas = [scale.factor * p.gamma for p in shown.flights.plate.steps if p is not None]
    verdict = measured = model = "-"
    if loop is not None:
        verdict = short_verdict(loop.verdict) + (
            f": {', '.join(plain(n) for n in loop.selection.names)}" if loop.selection.names else ""
        )
    if compared is not None and compared.first.measured is not None:
        low, high = compared.first.measured.gamma_before, compared.first.measured.gamma_after
        measured = f"{compared.first.measured.type}, {scale.factor * low:.4f} .. {scale.factor * high:.4f}"
    if compared is not None and math.isfinite(compared.first.predicted_gamma):
        model = f"{compared.first.predicted_type}, {scale.factor * compared.first.predicted_gamma:.4f}"
    us = ("-", "-", "-") if loop is None else tuple(
        microseconds(x)
        for x in (loop.errors.before.landing_rms_us, loop.errors.after.landing_rms_us, loop.errors.landing_floor_us)
    )  # fmt: skip
    return (
        recording.path.name,
        str(recording.attrs.get("started") or "unknown")[:16].replace("T", " "),
        recording.setup.name + (" (simulated)" if recording.attrs.get("simulated") else ""),
        ", ".join(str(c) for c in sorted(set(recording.steps["ratio"].tolist()))) or str(recording.setup.forcing.ratio),
        f"{scale.name} {min(gammas):.3f} .. {max(gammas):.3f}" if gammas else "-",
        str(len(recording.steps)),
        str(int((~shown.flights.has(FlightFlag.FALSE)).sum())),
        str(found.lost_samples),
        found.state,
        verdict,
        *us,
        measured,
        model,
    )


def write_page(sections: Sequence[Section], path: Path) -> None:
    """Write the page of one or more sections; it appears under its name only when it is whole.

    Raises `InputError` when the file cannot be written.
    """
    text = page.whole_page(
        "run.html", title=f"Report: {', '.join(one.name for one in sections)}", kind="runs",
        heading=f"Report of {'a run' if len(sections) == 1 else f'{len(sections)} runs'}", sections=sections,
        made=f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M}",
        software=page.software_words(software_version(), software_commit()), heads=COMPARED,
    )  # fmt: skip
    try:
        with whole(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error}); name a file in a folder you can write to") from error
