"""What the pictures promise: one measure of gamma, clipped points marked, harmonics told apart without colour."""

import itertools
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import model.tones
from analysis.loop.result import ClosedLoop
from analysis.report import style
from analysis.report.decades import plain_decades
from analysis.report.figures_loop import draw_candidates, draw_errors
from analysis.report.figures_residuals import draw_landings, draw_plate, draw_takeoffs
from analysis.report.gamma import gamma_scale
from analysis.report.placing import place
from analysis.report.style import HARMONICS, clipped_dots
from analysis.report.zones import zones_over
from daq.setup.setup import Forcing


@pytest.mark.parametrize(
    ("ratios", "name", "factor"),
    [([1, 1], "gamma_peak", 2.0), ([2, 2], "gamma", 1.0), ([1, 2], "gamma", 1.0)],
)
def test_gamma_peak_is_shown_at_c_1_alone(ratios: list[int], name: str, factor: float) -> None:
    """At c = 1 the peak of the one sine, twice gamma for two equal tones; gamma wherever another ratio occurs."""
    scale = gamma_scale(Forcing(frequency_hz=25.0, ratio=1), ratios)
    assert (scale.name, scale.factor) == (name, pytest.approx(factor))
    assert scale.definition.startswith(f"{name} = ")


def test_gamma_peak_follows_the_forcing() -> None:
    """Two tones of c = 1 that differ in phase make a smaller sine."""
    forcing = Forcing(frequency_hz=25.0, ratio=1, phase_deg=(0.0, 120.0))
    assert gamma_scale(forcing, 1).factor == pytest.approx(1.0)


def test_what_lies_beyond_the_axis_is_marked() -> None:
    """Points beyond stand at the edge as triangles that point outwards; the others are dots where they belong."""
    ax = Figure().subplots()
    y = np.array([0.5, 30.0, -0.2, -11.0, 40.0])
    assert clipped_dots(ax, np.arange(5.0), y, 10.0, color="k") == 3
    drawn = {line.get_marker(): line for line in ax.lines}
    np.testing.assert_array_equal(drawn["."].get_ydata(), [0.5, -0.2])
    np.testing.assert_array_equal(drawn["^"].get_xdata(), [1.0, 4.0])
    np.testing.assert_array_equal(drawn["v"].get_xdata(), [3.0])
    assert len(ax.lines) == 3
    assert np.all(np.abs(np.concatenate([drawn["^"].get_ydata(), drawn["v"].get_ydata()])) <= 10.0)


def test_harmonics_differ_in_more_than_colour() -> None:
    """No two harmonics share a mark, and neighbours differ in their line as well."""
    marks, lines = [mark for _, mark, _ in HARMONICS], [line for *_, line in HARMONICS]
    assert len(set(marks)) == len(HARMONICS)
    assert all(a != b for a, b in itertools.pairwise(lines))


def placed(draw: Callable[[Figure], None]) -> tuple[Figure, Any]:
    """A figure with its axes placed."""
    with matplotlib.rc_context(style.STYLE):
        figure = Figure()
        figure.set_layout_engine("none")
        draw(figure)
        renderer = FigureCanvasAgg(figure).get_renderer()
        place(figure, renderer, 0.3)
    return figure, renderer


def four_scales(figure: Figure) -> None:
    """Axes with a power of ten, plain ones, large numbers and decades, the columns with one range each."""
    axes = figure.subplots(2, 2, sharex="col", gridspec_kw={"height_ratios": [1, 2]})
    for ax, scale in zip(axes.flat, (1e-7, 1.0, 3e5, 40.0), strict=True):
        ax.plot(np.linspace(0.1, 2.0, 9), scale * np.arange(1.0, 10.0), "o", color="k", rasterized=scale == 1.0)
        ax.set(ylabel="height, m", xlabel="time, s" if ax in axes[1] else "")
        ax.set_title("a title", loc="left")
        ax.plot([0.5, 1.0], [2.0 * scale, 5.0 * scale], "--", lw=3.0, color="k")
    axes[1, 1].set_yscale("log")
    plain_decades(axes[1, 1].yaxis)


def labels_of(ax: Any) -> list[str]:
    """Texts of the ticks that matplotlib itself would write in view, left and below."""
    found = []
    for axis, side in ((ax.xaxis, "labelbottom"), (ax.yaxis, "labelleft")):
        low, high = axis.get_view_interval()
        for told, places, formatter in (
            (axis.get_tick_params(), axis.get_majorticklocs(), axis.get_major_formatter()),
            (axis.get_tick_params("minor"), axis.get_minorticklocs(), axis.get_minor_formatter()),
        ):
            words = zip(places, formatter.format_ticks(places), strict=True)
            found += [word for place, word in words if told[side] and word and low <= place <= high]
    return found


def test_ticks_are_those_that_matplotlib_chooses() -> None:
    """Each axes' texts are its ticks' labels in view, its power of ten and its label; shared ranges are told once."""
    figure, _ = placed(four_scales)
    for ax in figure.axes:
        told = sorted(text.get_text() for text in ax.texts)
        extra = [axis.get_major_formatter().get_offset() for axis in (ax.xaxis, ax.yaxis)]
        names = [name for name in (ax.get_xlabel(), ax.get_ylabel(), extra[1]) if name]
        assert told == sorted([*labels_of(ax), *names])
    assert "1e\u22127" in {text.get_text() for text in figure.axes[0].texts}


def test_no_text_is_cut_off_or_covered(closed_loop: ClosedLoop) -> None:
    """Titles, ticks and labels lie within the picture, beside the axes, and none on another."""
    parts = (draw_errors, draw_candidates, draw_landings, draw_takeoffs, draw_plate)
    for draw in (four_scales, *(partial(part, closed_loop) for part in parts)):
        figure, renderer = placed(draw)
        boxes = [box for ax in figure.axes for box in boxes_beside(ax, renderer)]
        assert len(boxes) > 6
        for box in boxes:
            assert min(box.x0, box.y0) >= 0.0 and box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height
        for one, other in itertools.combinations(boxes, 2):
            assert not (one.x0 < other.x1 and other.x0 < one.x1 and one.y0 < other.y1 and other.y0 < one.y1)


def boxes_beside(ax: Any, renderer: Any) -> list[Any]:
    """Extents of an axes' own texts whose middle is outside the axes."""
    texts = [text for text in ax.get_children() if isinstance(text, Text) and text.get_text()]
    boxes = [text.get_window_extent(renderer) for text in texts]
    return [box for box in boxes if not ax.bbox.contains(0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1))]


def test_png_and_svg_are_one_picture(tmp_path: Path) -> None:
    """Both formats have the same size, and the SVG the texts that were placed, as texts."""
    style.save_picture(tmp_path, "scales", "measured on a rig: a.h5", four_scales)
    with Image.open(tmp_path / "scales.png") as shown:
        inches = np.array(shown.size) / style.PNG_DPI
        assert shown.info["dpi"] == pytest.approx((style.PNG_DPI, style.PNG_DPI), rel=1e-3)
    root = ElementTree.parse(tmp_path / "scales.svg").getroot()
    assert (root.get("width"), root.get("height")) == tuple(f"{72 * x:g}pt" for x in inches)
    texts = [x.text for x in root.iter("{http://www.w3.org/2000/svg}text")]
    assert texts.count("height, m") == 4 and "measured on a rig: a.h5" in texts


def test_a_zone_reaches_to_where_it_is_born() -> None:
    """Between two gammas of a coarse grid the first zone of one sine begins where it is known to."""
    zones = zones_over(model.tones.Forcing.superposition(1), np.linspace(2.0, 3.0, 5))
    assert [len(zones), zones[0][0, 0]] == [1, pytest.approx(2.305, abs=0.01)]
    assert np.all(np.diff(zones[0][:, 0]) > 0.0) and zones[0][-1, 0] == 3.0


def test_figures_are_laid_out_around_their_labels(closed_loop: ClosedLoop) -> None:
    """Each figure draws on the one passed in, and the layout finds room: no empty artist reaches for a corner."""
    for draw in (draw_errors, draw_candidates, draw_landings, draw_takeoffs, draw_plate):
        figure = Figure(layout="constrained")
        draw(closed_loop, figure)
        figure.draw_without_rendering()  # a layout that finds no room is a warning, and so an error here
        assert figure.axes


def test_no_figure_holds_a_formula_to_parse(closed_loop: ClosedLoop) -> None:
    """Texts and ticks of a report are plain Unicode, which needs no parsing."""
    for draw in (draw_errors, draw_candidates, draw_landings, draw_takeoffs, draw_plate):
        figure = Figure(layout="constrained")
        draw(closed_loop, figure)
        figure.draw_without_rendering()
        assert not [text.get_text() for text in figure.findobj(Text) if "$" in text.get_text()]
