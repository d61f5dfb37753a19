"""The how-to for figures: its function and its row are drawn by the report and by the pictures of a recording."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.flights.assemble import flights_of
from analysis.report.figures import recording as table
from analysis.report.figures.flights import measured
from analysis.report.figures.style import Figure
from analysis.report.run_page import section_of
from bench.jobs.report import draw
from daq.recording import open_recording
from daq.recording.verify import VerifyReport

PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "add-a-figure.md").read_text(encoding="utf-8")


def test_a_function_and_a_row_are_a_figure(
    make: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the page's two pieces of code, and nothing else, the page shows the figure and the folder holds it."""
    function, row = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, Any] = {"Figure": Figure}
    exec(function, names)
    (added,) = eval(row, names)
    others = tuple(one for one in table.FIGURES if one.name == "plate")
    monkeypatch.setattr(table, "FIGURES", (*others, added))
    with open_recording(make(np.array([0.8, 1.1]), settle=3, hold=6).path) as recording:
        flights = flights_of(recording)
        section = section_of(measured(recording, flights), VerifyReport("complete"), 1, "left out")
        draw(recording, flights, tmp_path)
    assert section.html.count("<svg") == 2 and added.caption in section.html
    made = {path.name for path in tmp_path.iterdir()}
    assert made == {f"{name}.{form}" for name in ("plate", "histogram") for form in ("png", "svg")}
