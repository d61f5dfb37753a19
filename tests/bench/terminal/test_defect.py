"""Errors that no input causes: they end as a defect, with the traceback in a file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.commands import runs
from daq.setup.errors import InputError
from model.effects.registry import effect


@pytest.mark.parametrize("fails", [lambda: np.concatenate([]), lambda: np.linalg.cholesky(-np.eye(2)), lambda: {}["x"]])
def test_error_of_a_library_is_a_defect_with_its_traceback_in_a_file(fails, monkeypatch, tmp_path: Path) -> None:
    """A library's own error ends with status 1 and one line that names the file of its traceback."""
    monkeypatch.setattr(runs, "note", lambda: fails())
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    result = CliRunner().invoke(app, ["note"])
    assert result.exit_code == 1 and result.stderr.startswith("error: this is a defect of shakerbench")
    assert "Traceback" not in result.stderr
    named = re.search(r"traceback is in (\S+):", result.stderr)
    assert named and "Traceback" in Path(named[1]).read_text("utf-8")


def test_refusal_of_the_model_is_the_callers_fault() -> None:
    """What the model refuses is the same error as what a reader of files refuses, and ends with status 2."""
    with pytest.raises(InputError, match="no effect is called"):
        effect("magic")
    result = CliRunner().invoke(
        app, ["predict", "--c", "1", "--gamma", "1", "--effect", "coulomb_friction.mu_down=1.5"]
    )
    assert result.exit_code == 2 and "defect" not in result.stderr
