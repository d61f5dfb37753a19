"""Axes of a picture, placed in one pass around their texts, with ticks of few artists.

matplotlib makes five artists of each tick, and its constrained layout measures all of them twice. Here the marks of an
axis are one artist, its labels plain texts at fixed distances from the axes; what all texts need beyond the axes is
measured once, and the rows and columns of axes share the rest of the figure.
"""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import TICKRIGHT, TICKUP
from matplotlib.text import Text
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LINE = 0.2  # inches for a line of text, while ticks are chosen
PAD, GAP = 0.045, 0.07  # inches around all texts of a picture, and between those of neighbours
POINT = 1.0 / 72.0  # inch


def place(figure: Figure, renderer: Any, top: float) -> None:
    """Choose the ticks, draw them as few artists, and place the axes.

    Parameters
    ----------
    figure
        With axes of one grid, none of them over several cells.
    renderer
        Measures the texts.
    top
        Inches kept free above the axes and their texts.
    """
    axes: list[Any] = figure.axes
    _share_out(figure, np.array([_expected(ax) for ax in axes]), (PAD, PAD, PAD, top))
    needed = np.array([_beyond(ax, renderer) for ax in axes]) / figure.dpi
    _share_out(figure, needed, _edges(figure, renderer, top))


def _share_out(figure: Figure, needed: Floats, edges: tuple[float, float, float, float]) -> None:
    """Give each row and column of axes what its texts need, and share the rest by the ratios of the grid.

    ``needed`` (n, 4) and ``edges`` are inches left, below, right and above, of each axes and of the whole grid.
    """
    specs: list[Any] = [ax.get_subplotspec() for ax in figure.axes]
    grid = specs[0].get_gridspec()
    columns, rows = np.array([s.colspan.start for s in specs]), np.array([s.rowspan.start for s in specs])
    width, height = figure.get_size_inches()
    across = _cells(grid.get_width_ratios(), columns, needed[:, [0, 2]], (edges[0], width - edges[2]))
    down = _cells(grid.get_height_ratios(), rows, needed[:, [3, 1]], (edges[3], height - edges[1]))
    for ax, (left, wide), (above, high) in zip(figure.axes, across[columns], down[rows], strict=True):
        ax.set_position((left / width, 1.0 - (above + high) / height, wide / width, high / height))


def _cells(ratios: list[float] | None, cell: NDArray[np.int64], needed: Floats, between: tuple[float, float]) -> Floats:
    """Start and length, inches, of the axes in each cell along one direction, (m, 2)."""
    share = np.array(ratios or np.ones(int(cell.max()) + 1), np.float64)
    around = np.zeros((len(share), 2))
    np.maximum.at(around, cell, needed)
    free = between[1] - between[0] - float(around.sum()) - GAP * (len(share) - 1)
    length = max(free, 0.1) * share / share.sum()
    ends = between[0] + np.cumsum(around.sum(axis=1) + length + GAP) - GAP - around[:, 1]
    return np.column_stack([ends - length, length])


def _expected(ax: Any) -> tuple[float, float, float, float]:
    """About what is needed left of, below, right of and above the axes, inches: the number of ticks depends on it."""
    labels, below = (ax.yaxis.get_tick_params()["labelleft"], ax.xaxis.get_tick_params()["labelbottom"])
    left = LINE * (2 * labels + bool(ax.get_ylabel()))
    return left, LINE * (below + bool(ax.get_xlabel())), 0.0, LINE * bool(ax.get_title() or ax.get_title("left"))


def _edges(figure: Figure, renderer: Any, top: float) -> tuple[float, float, float, float]:
    """Inches that the grid leaves free at the figure's edges: labels of the whole figure stand there."""
    left, below = PAD, PAD
    for text in figure.texts:
        box = text.get_window_extent(renderer)
        if text.get_rotation():
            left = max(left, box.x1 / figure.dpi + PAD)
        elif box.y0 < 0.5 * figure.bbox.height:
            below = max(below, box.y1 / figure.dpi + PAD)
    return left, below, PAD, top


def _beyond(ax: Any, renderer: Any) -> Floats:
    """Draw the axes' ticks; pixels that texts and legend reach beyond the axes, left, below, right and above, (4,)."""
    ax.apply_aspect()
    texts = [text for text in ax.get_children() if isinstance(text, Text) and text.get_text()]
    boxes = [(text.get_window_extent(renderer), "xy" if text in ax.texts else "y") for text in texts]  # titles: height
    if ax.get_legend() is not None:
        boxes.append((ax.get_legend().get_window_extent(renderer), "xy"))
    for axis in (ax.xaxis, ax.yaxis) if ax.axison else ():
        boxes += _drawn(ax, axis, renderer)
        axis.set_visible(False)
    most, inner = np.zeros(4), ax.bbox
    for box, ways in boxes:
        reach = (inner.x0 - box.x0, inner.y0 - box.y0, box.x1 - inner.x1, box.y1 - inner.y1)
        most = np.maximum(most, np.where(["x" in ways, "y" in ways] * 2, reach, 0.0))
    return most


def _drawn(ax: Any, axis: Any, renderer: Any) -> list[tuple[Any, str]]:
    """Draw an axis as marks and texts; the extents of the texts, each with the directions in which it takes room."""
    is_x = axis.axis_name == "x"
    texts = [*_ticks(ax, axis, "minor", axis.get_minorticklocs()), *_ticks(ax, axis, "major", axis.get_majorticklocs())]
    boxes = [(text.get_window_extent(renderer), "xy") for text in texts]
    labels = max((box.height if is_x else box.width for box, _ in boxes), default=0.0) / ax.figure.dpi
    pad = POINT * _rc()[f"{axis.axis_name}tick.major.pad"]
    away = pad + labels
    power = axis.get_major_formatter().get_offset()
    if power and texts:
        shift = (0.0, -away) if is_x else (-pad, 0.5 * LINE)  # below the labels, or above them and beside titles
        text = _text(ax, 1.0 if is_x else 0.0, 0.0 if is_x else 1.0, power, shift)
        text.set(ha="right", va="top" if is_x else "bottom")
        boxes.append((text.get_window_extent(renderer), "xy"))
    if axis.label.get_text():
        away += POINT * axis.labelpad
        at, shift = ((0.5, 0.0), (0.0, -away)) if is_x else ((0.0, 0.5), (-away, 0.0))
        label = _text(ax, *at, axis.label.get_text(), shift, axis.label)
        boxes.append((label.get_window_extent(renderer), "y" if is_x else "x"))
    return boxes


def _text(ax: Any, x: float, y: float, words: str, shift: tuple[float, float], like: Text | None = None) -> Text:
    """A text at a place in the axes, shifted by inches, in the style of another one."""
    text: Text = ax.add_artist(Text(x, y, words, clip_on=False))
    if like is not None:
        text.update_from(like)
        text.set_rotation_mode(like.get_rotation_mode())
    text.set_transform(ax.transAxes + ScaledTranslation(*shift, ax.figure.dpi_scale_trans))
    return text


def _ticks(ax: Any, axis: Any, which: str, at: Any) -> list[Text]:
    """Draw the marks at ``at`` (n,), into the axes, and their labels; the labels."""
    way, is_x, told, rc = axis.axis_name, axis.axis_name == "x", axis.get_tick_params(which), _rc()
    formatter = axis.get_major_formatter() if which == "major" else axis.get_minor_formatter()
    words, at = np.array(formatter.format_ticks(at), object), np.asarray(at, np.float64)
    seen = _within(axis, at)
    if not seen.any():
        return []
    at, words = at[seen], words[seen]
    if told["bottom" if is_x else "left"]:
        mark: Any = TICKUP if is_x else TICKRIGHT
        edge = np.zeros(len(at))
        marks = Line2D(*((at, edge) if is_x else (edge, at)), ls="", marker=mark, zorder=2.01)
        marks.set(markersize=rc[f"{way}tick.{which}.size"], markeredgewidth=rc[f"{way}tick.{which}.width"])
        marks.set(color="black", clip_on=False)
        marks.set_transform(ax.get_xaxis_transform("tick1") if is_x else ax.get_yaxis_transform("tick1"))
        ax.add_artist(marks)
    if not told["labelbottom" if is_x else "labelleft"]:
        return []
    pad = rc[f"{way}tick.major.pad"]
    to, va, ha = (ax.get_xaxis_text1_transform if is_x else ax.get_yaxis_text1_transform)(pad)
    labels = []
    for where, word in zip(at, words, strict=True):
        if word:
            x, y = (where, 0.0) if is_x else (0.0, where)
            labels.append(ax.add_artist(Text(x, y, word, transform=to, va=va, ha=ha, clip_on=False)))
    return labels


def _rc() -> Any:
    """The style that is in force."""
    return matplotlib.rcParams


def _within(axis: Any, places: Floats) -> NDArray[np.bool_]:
    """Which of ``places`` (n,) lie within the axis' range, its ends included."""
    to = axis.get_transform().transform
    low, high = sorted(to(np.array(axis.get_view_interval())))
    slack = 1e-9 * (high - low)
    return np.asarray((to(places) >= low - slack) & (to(places) <= high + slack))
