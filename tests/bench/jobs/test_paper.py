"""The seed paper's figures and numbers as one page."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.jobs import paper
from bench.profiles.find import load


def test_a_device_is_never_driven(tmp_path: Path) -> None:
    """For a rig that is no simulated one every run's profile is written, and how to record the first is said."""
    result = CliRunner().invoke(app, ["paper", "--profile", "soundcard", "--out", str(tmp_path)])
    assert result.exit_code == 2 and "bench ramp" in result.output
    assert {path.stem for path in (tmp_path / "runs").glob("*.toml")} >= set(paper.RUNS)
    assert load(tmp_path / "runs" / "c2.toml")[0].forcing.ratio == 2


def test_a_recording_that_is_there_is_used(tmp_path: Path) -> None:
    """A real rig's run in the folder is taken as it is, and nothing is driven."""
    (tmp_path / "full.h5").write_bytes(b"a recording")
    plan = paper.write_plan(tmp_path / "full.toml", load("soundcard")[1])
    assert paper.recorded(plan, 0) == tmp_path / "full.h5"


@pytest.mark.slow
def test_the_page_holds_every_figure_with_its_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each figure has a picture and a table; the numbers are the ideal ball's without, and the paper's with effects."""
    short = {name: (c, gammas, min(hold, 15)) for name, (c, gammas, hold) in paper.RUNS.items()}
    fewer = {"full": (1, (0.5, 4.0, 15), 15), "humps": (1, (1.68, 1.72, 8), 15)}
    fewer |= {"c2": (2, (0.16, 1.28, 5), 15), "c3": (3, (0.08, 0.64, 5), 15)}
    monkeypatch.setattr(paper, "RUNS", short | fewer)
    narrow = {name: (c, low, 0.5 * high, effects) for name, (c, low, high, effects) in paper.DIAGRAMS.items()}
    monkeypatch.setattr(paper, "DIAGRAMS", narrow)
    found = paper.paper(load("paper")[1], tmp_path, 1, lambda *_: None)
    page = (tmp_path / "paper.md").read_text(encoding="utf-8")
    for name in ("figure_1", *paper.DIAGRAMS, *(row[0] for row in paper.FIGURES), "humps"):
        assert f"(paper/{name}.png)" in page and (tmp_path / "paper" / f"{name}.png").stat().st_size > 10_000
        with (tmp_path / "paper" / f"{name}.csv").open(encoding="utf-8") as file:
            assert len(list(csv.reader(file))) > 20
    ideal, friction = found["ideal"], found["friction"]
    assert ideal["first"] == pytest.approx(math.hypot(math.pi, 1.0), abs=0.5 * ideal["step"])
    assert ideal["shorter"] == pytest.approx(0.0, abs=1e-3) and ideal["in_band"] == 0.0
    assert friction["at_two"] == pytest.approx(0.825, abs=0.01)
    assert found["slow"]["onset"] == pytest.approx(1.3, abs=found["slow"]["step"])
    assert found["slow"]["first"] == pytest.approx(found["slow"]["predicted"], abs=0.2)
