"""What the pictures promise: one measure of gamma, clipped points marked, harmonics told apart without colour."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from analysis.loop.result import ClosedLoop
from analysis.report import style
from analysis.report.figures_loop import draw_candidates, draw_errors
from analysis.report.figures_residuals import draw_landings, draw_plate, draw_takeoffs
from analysis.report.gamma import gamma_scale
from analysis.report.style import HARMONICS, clipped_dots, save_picture
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


def test_ticks_chosen_once_are_those_of_every_drawing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With ticks kept, pictures with shared, logarithmic and small axes are the same files, byte for byte."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots(2, 2, sharex="col", gridspec_kw={"height_ratios": [1, 4]})
        for ax, scale in zip(axes.flat, (1e-7, 1.0, 3e5, 40.0), strict=True):
            ax.plot(np.linspace(0.1, 2.0, 9), scale * np.arange(1.0, 10.0), "o")
            ax.set_ylabel("$z_0$, m")
        axes[1, 1].set_yscale("log")

    save_picture(tmp_path / "kept", "a", "SIMULATED RIG: run", draw)
    monkeypatch.setattr(style, "_keep_ticks", lambda figure: None)
    save_picture(tmp_path / "anew", "a", "SIMULATED RIG: run", draw)
    for name in ("a.png", "a.svg"):
        assert (tmp_path / "kept" / name).read_bytes() == (tmp_path / "anew" / name).read_bytes()


def test_kept_ticks_follow_the_range(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another range, another choice; the same range, none."""
    ax = Figure().subplots()
    chosen: list[tuple[float, float]] = []
    choose = ax.xaxis._update_ticks
    monkeypatch.setattr(ax.xaxis, "_update_ticks", lambda: chosen.append(ax.get_xlim()) or choose())
    style._keep_ticks(ax.figure)
    for limits in ((0.0, 1.0), (0.0, 1.0), (0.0, 50.0)):
        ax.set_xlim(*limits)
        drawn = [tick.get_loc() for tick in ax.xaxis._update_ticks()]
        assert drawn[-1] == limits[1]
    assert chosen == [(0.0, 1.0), (0.0, 50.0)]


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
