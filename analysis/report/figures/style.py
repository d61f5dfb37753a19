"""Plot style, colours and badge of every picture, the row of a table of figures, and the saving of a picture.

Measured values are dark dots, predicted ones the light line or cloud beneath them. A badge on each saved picture
separates a simulated rig from a real one. Decision 317.
"""

from __future__ import annotations

import gc
import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogFormatter

from daq.files.disk import whole
from daq.recording import Recording
from daq.setup.errors import InputError
from kernels.arrays import Floats, Integers

INK = "#12355b"
MEASURED, MODEL = INK, "#e07a5f"
BEFORE, AFTER, FLOOR = MODEL, INK, "#8d99ae"  # declared model, improved model, noise
DOUBTFUL = "#b5651d"
IMPROVED = "#2a9d8f"  # improved model in diagrams, where the measurement has the colour of AFTER
ZONE = "#f2d0a4"  # forbidden zones of the ideal ball
EVENT = "#9b2226"  # bifurcations
PLATE = "#5c677d"
BAND = "#c9d6e3"  # 95 % bands
NEUTRAL, ERROR_BAR = "#adb5bd", "#495057"
SIMULATED_BADGE, REAL_BADGE = "#a4161a", "#2d6a4f"
HARMONICS = (  # colour (Okabe and Ito's, which the colour-blind distinguish), mark and line of each harmonic
    ("#0072b2", "o", "-"),
    ("#d55e00", "s", "--"),
    ("#000000", "^", ":"),
    ("#cc79a7", "D", "-."),
    ("#009e73", "v", "-"),
    ("#e69f00", "P", "--"),
    ("#56b4e9", "X", ":"),
)
PNG_DPI = 160
FORMATS: dict[str, dict[str, Any]] = {
    "png": {"pil_kwargs": {"compress_level": 1}},  # a little larger than at level 6, and written in half the time
    "svg": {"metadata": {"Date": None}},
}
STYLE: dict[Any, Any] = {
    "font.family": "serif",
    "font.serif": ["DejaVu Serif"],  # it comes with matplotlib; a list is looked through for each text
    "text.hinting": "none",  # at this many dots the letters look the same, and take two thirds of the time
    "mathtext.fontset": "cm",
    "font.size": 10,
    "axes.linewidth": 0.8,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "figure.dpi": PNG_DPI,  # texts are measured once, for placing the axes and for the PNG
    "savefig.dpi": PNG_DPI,
    "svg.fonttype": "none",
    "svg.hashsalt": "shakerbench",  # the same picture gives the same file
}
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
FLIGHT_ROWS = "flight_rows"  # attribute of a drawn line: the flight behind each of its points


@dataclass(frozen=True)
class Figure:
    """A row of a table of figures."""

    name: str  # of its files and of its element in the page
    # draws a `Measured` or a `ClosedLoop` on an empty figure. What draws no axes is left out.
    draw: Callable[[Any, Canvas], None]
    # part of the page; figures of one part stand in the order of the table
    place: Literal["flights", "plate", "errors", "why", "residuals"]
    caption: str  # one or two sentences


def badge_text(name: str, *, simulated: bool) -> str:
    """Text of the badge: simulated or real, and which recording."""
    return f"{'SIMULATED RIG' if simulated else 'measured on a rig'}: {name}"


def badge_of(recording: Recording) -> str:
    """Badge of an open recording."""
    return badge_text(recording.path.name, simulated=bool(recording.attrs.get("simulated")))


def save_picture(folder: Path, name: str, badge: str, draw: Callable[[Canvas], None]) -> None:
    """Save what ``draw`` draws on a new figure as PNG and SVG, with the badge; nothing where it draws no axes.

    Raises `InputError` when the folder cannot be written.
    """
    enabled = gc.isenabled()
    gc.disable()  # a picture is ten thousand objects that all live until it is saved: a search finds no garbage
    try:
        with matplotlib.rc_context(STYLE):
            figure = Canvas()
            FigureCanvasAgg(figure)
            draw(figure)
            if not figure.axes:
                return
            height = figure.get_figheight()
            colour = SIMULATED_BADGE if badge.startswith("SIMULATED") else REAL_BADGE
            box = {"boxstyle": "round,pad=0.3", "facecolor": colour, "edgecolor": "none"}
            at: dict[str, Any] = {"ha": "right", "va": "top", "fontsize": 8, "color": "white", "weight": "bold"}
            # a file may be called $x$
            text = figure.text(0.993, 1.0 - 0.07 / height, badge, bbox=box, parse_math=False, **at)
            text.set_in_layout(False)
            for ax in figure.axes:  # a spine would ask for all ticks of its axis again, and they point inwards
                for spine in ax.spines.values():
                    spine.set_in_layout(False)
            # an engine that the figure owned would place the axes again for each file
            # the badge takes 0.36 inches above the axes, texts of axes 0.07
            below = (0.0, 0.0, 1.0, 1.0 - 0.36 / height)
            ConstrainedLayoutEngine(h_pad=0.07, rect=below).execute(figure)
            files = {}
            for form, options in FORMATS.items():
                file = io.BytesIO()
                figure.savefig(file, format=form, **options)
                files[form] = file.getvalue()
    finally:
        if enabled:
            gc.enable()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for form, content in files.items():
            with whole(folder / f"{name}.{form}") as part:
                part.write_bytes(content)
    except OSError as error:
        raise InputError(f"{folder}: cannot write {name} ({error}); name a folder you can write to") from error


def plain_decades(axis: Any) -> None:
    """Write the ticks of a logarithmic axis as plain numbers: 0.01, 100; very small or large ones as powers of ten."""

    class Minor(LogFormatter):
        """Names the ticks between decades that matplotlib names: on axes of about a decade."""

        def __call__(self, x: float, pos: int | None = None) -> str:
            return plain_number(x) if super().__call__(x, pos) else ""

    axis.set_major_formatter(FuncFormatter(lambda value, _: plain_number(value)))
    if axis.get_scale() == "log":
        axis.set_minor_formatter(Minor())


def plain_number(value: float) -> str:
    """The text of the tick at ``value``."""
    power = math.log10(abs(value)) if value else 0.0
    sign = "\u2212" if value < 0.0 else ""
    if not -4.0 < power < 6.0 and math.isclose(power, round(power)):
        return f"{sign}10{str(round(power)).translate(SUPERSCRIPTS)}"
    return f"{sign}{abs(value):g}"


def name_flights(line: Any, rows: Integers) -> None:
    """Say which flight is behind each point of a drawn line: ``rows`` (n,) of the table of flights."""
    setattr(line, FLIGHT_ROWS, np.asarray(rows, np.int64))


def clipped_dots(ax: Any, x: Floats, y: Floats, limit: float, flights: Integers | None = None, **style: Any) -> int:
    """Dots within ``+-limit``; points beyond are triangles at the edge that point outwards.

    ``flights`` (n,) are the rows of the flights behind the points, where there are any. Returns the number of points
    beyond.
    """
    above, below = y > limit, y < -limit
    inside = ~above & ~below
    (line,) = ax.plot(x[inside], y[inside], ".", ms=4.5, mew=0, alpha=0.6, **style)
    if flights is not None:
        name_flights(line, flights[inside])
    for rows, mark, edge in ((above, "^", limit), (below, "v", -limit)):
        if not rows.any():  # the extent of an unclipped line without points would be the figure's corner
            continue
        at = np.full(int(rows.sum()), 0.95 * edge)
        (line,) = ax.plot(x[rows], at, mark, ms=4.5, mfc="none", mew=0.8, clip_on=False, **style)
        if flights is not None:
            name_flights(line, flights[rows])
    return int(above.sum() + below.sum())
