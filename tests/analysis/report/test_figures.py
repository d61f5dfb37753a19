"""What the pictures promise: one measure of gamma, clipped points marked, harmonics told apart without colour."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from PIL import Image

import model.tones
from analysis.loop.result import ClosedLoop
from analysis.report.figures import loop as of_loop
from analysis.report.figures import recording as of_recording
from analysis.report.figures import style
from analysis.report.figures.style import HARMONICS, clipped_dots, plain_decades, plain_number
from analysis.report.figures.theory import zones_over
from analysis.report.wording import gamma_scale
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


def laid_out(loop: ClosedLoop) -> Iterator[tuple[str, Figure]]:
    """Each figure of a closed loop that draws anything, placed as it is saved."""
    with matplotlib.rc_context(style.STYLE):
        for one in of_loop.FIGURES:
            figure = Figure(layout="constrained")
            FigureCanvasAgg(figure)
            one.draw(loop, figure)
            if figure.axes:
                figure.draw_without_rendering()  # a layout that finds no room is a warning, and so an error here
                yield one.name, figure


def test_no_text_is_cut_off_or_covered(closed_loop: ClosedLoop) -> None:
    """Titles, ticks and labels of every figure lie within the picture, outside the axes, and none on another."""
    names = []
    for name, figure in laid_out(closed_loop):
        names.append(name)
        boxes = [box for ax in figure.axes for box in boxes_outside(ax)]
        assert len(boxes) > 6, name
        for box in boxes:
            assert min(box.x0, box.y0) >= 0.0 and box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height, name
        for one, other in itertools.combinations(boxes, 2):
            assert not (one.x0 < other.x1 and other.x0 < one.x1 and one.y0 < other.y1 and other.y0 < one.y1), name
    assert len(names) == 5


def boxes_outside(ax: Axes) -> list[Bbox]:
    """Extents of the texts of an axes, its ticks' included, whose middle is outside it."""
    low, high = zip(ax.get_xlim(), ax.get_ylim(), strict=True)
    texts = [text for text in ax.get_children() if isinstance(text, Text)]
    for axis, first, last in zip((ax.xaxis, ax.yaxis), low, high, strict=True):
        texts.append(axis.label)
        ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
        texts += [x.label1 for x in ticks if min(first, last) <= x.get_loc() <= max(first, last)]
    boxes = [text.get_window_extent() for text in texts if text.get_visible() and text.get_text()]
    return [box for box in boxes if not ax.bbox.contains(0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1))]


def test_the_tables_of_figures_are_complete() -> None:
    """No two figures share a name, which is their element's in the page, and each has a caption."""
    figures = (*of_recording.FIGURES, *of_loop.FIGURES)
    assert len({one.name for one in figures}) == len(figures)
    assert all(one.caption.endswith(".") for one in figures)


def test_no_figure_holds_a_formula_to_parse(closed_loop: ClosedLoop) -> None:
    """Texts and ticks of a report are plain Unicode, which needs no parsing."""
    for name, figure in laid_out(closed_loop):
        assert not [text.get_text() for text in figure.findobj(Text) if "$" in text.get_text()], name


def test_decades_are_plain_numbers() -> None:
    """Ticks read 0.01 or 100, and as powers of ten beyond what is quickly counted."""
    said = [plain_number(value) for value in (0.0, 0.01, 100.0, -100.0, 1e-6, -1e7, 2e-6)]
    assert said == ["0", "0.01", "100", "\u2212100", "10⁻⁶", "\u221210⁷", "2e-06"]


def test_ticks_between_decades_are_named_only_on_short_axes() -> None:
    """Over less than a decade 2, 3 and more are named, as plain numbers; over three decades only the decades."""
    ax = Figure().subplots()
    ax.set_yscale("log")
    plain_decades(ax.yaxis)
    ax.set_ylim(1.5, 6.0)
    minor = ax.yaxis.get_minor_formatter().format_ticks(ax.yaxis.get_minorticklocs())
    assert {"2", "3", "4"} <= set(minor) and not any("$" in text for text in minor)
    ax.set_ylim(1.0, 1000.0)
    assert not any(ax.yaxis.get_minor_formatter().format_ticks(ax.yaxis.get_minorticklocs()))
