"""Numbers and pictures of a drop test's figure."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from analysis.drop.figures import FitPlot, ModelCurve, draw_fit, in_plain_words


def test_balls_have_their_colours_and_models_plain_words(tmp_path: Path, monkeypatch) -> None:
    """In the picture of several balls each has one colour and an entry in the legend; a model is said without code."""
    x, seen = np.arange(3.0), []
    models = [ModelCurve(in_plain_words("quadratic_drag+axis_distortion"), [(x, x)] * 3, [(x, x)] * 3)]
    plot = FitPlot("x", "y", "left", [(x, x)] * 3, models, [0, 1, 2], ["golf", "golf", "tennis"])
    monkeypatch.setattr(Figure, "savefig", lambda self, *_args, **_more: seen.append(self))
    draw_fit(plot, "falls", tmp_path / "x.png")
    top = seen[0].axes[0]
    assert [text.get_text() for text in top.get_legend().get_texts()] == [
        "golf",
        "tennis",
        "quadratic drag, axis distortion",
    ]
    points = [line.get_color() for line in top.get_lines()[:3]]
    assert points[0] == points[1] != points[2]
