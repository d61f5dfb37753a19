"""The notebooks of the tutorials run from top to bottom, and come to what their text says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"


def executed(name: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """Everything that the notebook prints and shows as text, in order."""
    monkeypatch.setenv("PYTHONPATH", str(TUTORIALS.parents[1]))
    notebook = nbformat.read(TUTORIALS / f"{name}.ipynb", as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "stored outputs age: clear them"
    NotebookClient(notebook, timeout=200, kernel_name="python3").execute()
    outputs: list[Any] = [out for cell in notebook.cells for out in cell.get("outputs", [])]
    return "\n".join(str(out.get("text") or out.get("data", {}).get("text/plain", "")) for out in outputs)


@pytest.mark.slow
def test_a_run_and_its_diagram(monkeypatch: pytest.MonkeyPatch) -> None:
    """The run is complete, the limit refuses, and the ideal rig's flights lie within a sample of the model."""
    said = executed("a-run-and-its-diagram", monkeypatch)
    assert "('complete'," in said and "limits forbid" in said
    assert "take-off" in said and "model with no effects (ideal)" in said


@pytest.mark.slow
def test_closing_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hidden friction is named alone, with intervals, and stands in the improved profile."""
    said = executed("closing-the-loop", monkeypatch)
    assert "('explained', [['coulomb_friction']])" in said
    assert "coulomb_friction.mu_up = 0.1" in said and "improved profile" in said


@pytest.mark.slow
def test_the_seed_paper(monkeypatch: pytest.MonkeyPatch) -> None:
    """Locks move from 3.297 to 4.056, flights to 83 %, and the two humps are the branches 1 and 2."""
    said = executed("the-seed-paper", monkeypatch)
    assert "'lock': 3.297" in said and "'lock': 4.056" in said
    assert "flights over the ideal ball's: 0.8" in said and "branch 2: 6" in said
