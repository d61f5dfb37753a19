"""Figures as inline SVG, and the flights behind their points, for a page that needs nothing but itself.

A figure names the flights behind its points (`name_flights`). The page's script finds the point nearest to the pointer;
paper shows the same vectors.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analysis.report.figures.style import FLIGHT_ROWS, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_VECTOR_POINTS = 15_000  # in one figure; with more of them the dots are one picture under vector axes
MOST_HOVER_POINTS = 60_000  # in one figure that the pointer can name; of more, every second, third, ... one


@dataclass(frozen=True)
class InlineFigure:
    """A drawn figure."""

    svg: str  # element ``<svg>``
    # place of each named point in the SVG's units and its flight's row, base64 of little-endian numbers
    points: Mapping[str, str]
    remark: str  # what the number of points made necessary, in words; else empty


def inline_figure(draw: Callable[[Figure], None]) -> InlineFigure | None:
    """A new figure, filled by ``draw``, as inline SVG; None where that draws no axes."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context({**STYLE, "svg.fonttype": "path"}):  # the reader's machine lacks TeX's fonts
        figure = Figure(layout="constrained")
        draw(figure)
        if not figure.axes:
            return None
        dots = [line for ax in figure.axes for line in ax.lines]
        named = [line for line in dots if hasattr(line, FLIGHT_ROWS)]
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
    return InlineFigure(element, points, " ".join(remarks))


def _points(figure: Figure, lines: list[Any]) -> tuple[dict[str, str], tuple[int, int]]:
    """Places and rows of the named points, and how many of them the page holds, of how many."""
    places, rows = [np.zeros((0, 2))], [np.zeros(0, np.int64)]
    for line in lines:
        places.append(line.get_transform().transform(np.column_stack([line.get_xdata(), line.get_ydata()])))
        rows.append(getattr(line, FLIGHT_ROWS))
    place, row = np.concatenate(places) * (72.0 / figure.dpi), np.concatenate(rows)
    seen = np.isfinite(place).all(axis=1)
    place, row = place[seen], row[seen]
    stride = -(-len(row) // MOST_HOVER_POINTS) if len(row) else 1
    shown = place[::stride]
    coded = {
        "x": packed(shown[:, 0], "<f4"),
        "y": packed(72.0 * figure.get_figheight() - shown[:, 1], "<f4"),
        "row": packed(row[::stride], "<i4"),
    }
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
