"""Plot style, colours and the badge of every picture, and how a picture is saved.

Measured values are dark dots, predicted ones the light line or cloud beneath them. A badge on each saved picture
separates a simulated rig from a real one.
"""

from __future__ import annotations

import gc
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from daq.files.whole_file import whole
from daq.recording import Recording
from daq.setup.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]

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
HARMONICS = (  # colour (Okabe and Ito's, which the colour-blind tell apart), mark and line of each harmonic
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
BADGE_INCHES = 0.36  # of height, above the axes
STYLE: dict[Any, Any] = {
    "font.family": "serif",
    "font.serif": ["DejaVu Serif"],  # it comes with matplotlib; a list is looked through for each text
    "text.hinting": "none",  # at this many dots the letters look the same, and take two thirds of the time
    "mathtext.fontset": "cm",
    "font.size": 10,
    "axes.linewidth": 0.8,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "figure.constrained_layout.use": True,
    "figure.dpi": PNG_DPI,  # texts are measured once for placing the axes and for the PNG
    "savefig.dpi": PNG_DPI,
    "svg.fonttype": "none",
    "svg.hashsalt": "shakerbench",  # the same picture gives the same file
}
FLIGHT_ROWS = "flight_rows"  # attribute of a drawn line: the flight behind each of its points


def badge_text(name: str, *, simulated: bool) -> str:
    """Text of the badge: simulated or real, and which recording."""
    return f"{'SIMULATED RIG' if simulated else 'measured on a rig'}: {name}"


def badge_of(recording: Recording) -> str:
    """Badge of an open recording."""
    return badge_text(recording.path.name, simulated=bool(recording.attrs.get("simulated")))


def save_picture(folder: Path, name: str, badge: str, draw: Callable[[Figure], None]) -> None:
    """Save what ``draw`` draws on a new figure as PNG and SVG, with the badge; nothing where it draws no axes.

    Raises
    ------
    InputError
        When the folder cannot be written.
    """
    with _no_collecting():
        files = _drawn(badge, draw)
    try:
        for form, content in files.items():
            folder.mkdir(parents=True, exist_ok=True)
            with whole(folder / f"{name}.{form}") as part:
                part.write_bytes(content)
    except OSError as error:
        raise InputError(f"{folder}: cannot write {name} ({error}); name a folder you can write to") from error


def _drawn(badge: str, draw: Callable[[Figure], None]) -> dict[str, bytes]:
    """The files of a picture by their ending; none where no axes are drawn."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from analysis.report.placing import place

    with matplotlib.rc_context(STYLE):
        figure = Figure()
        figure.set_layout_engine("none")
        canvas: Any = FigureCanvasAgg(figure)
        draw(figure)
        if not figure.axes:
            return {}
        _add_badge(figure, badge)
        place(figure, canvas.get_renderer(), BADGE_INCHES)
        files = {}
        for form, options in FORMATS.items():
            file = io.BytesIO()
            figure.savefig(file, format=form, **options)
            files[form] = file.getvalue()
        return files


@contextmanager
def _no_collecting() -> Iterator[None]:
    """No search for garbage: a picture is ten thousand objects that all live until it is drawn."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _add_badge(figure: Figure, badge: str) -> None:
    """The badge in the upper right corner."""
    height = figure.get_figheight()
    colour = SIMULATED_BADGE if badge.startswith("SIMULATED") else REAL_BADGE
    box = {"boxstyle": "round,pad=0.3", "facecolor": colour, "edgecolor": "none"}
    at: dict[str, Any] = {"ha": "right", "va": "top", "fontsize": 8, "color": "white", "weight": "bold"}
    figure.text(0.993, 1.0 - 0.07 / height, badge, bbox=box, parse_math=False, **at)  # a file may be called $x$


def name_flights(line: Any, rows: npt.NDArray[np.int64]) -> None:
    """Say which flight is behind each point of a drawn line: ``rows`` (n,) of the table of flights."""
    setattr(line, FLIGHT_ROWS, np.asarray(rows, np.int64))


def clipped_dots(
    ax: Any, x: Floats, y: Floats, limit: float, flights: npt.NDArray[np.int64] | None = None, **style: Any
) -> int:
    """Dots within ``+-limit``; points beyond are triangles at the edge that point outwards.

    ``flights`` (n,) are the rows of the flights behind the points, where there are any.

    Returns
    -------
    int
        Number of points beyond.
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
