"""A runs' folder with recordings in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.runs.recordings import record


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three recordings in folders of a runs' folder, one of them with lost samples."""
    runs = tmp_path / "runs"
    record(runs / "one" / "a.h5", profile="paper", gammas=(0.6, 0.8), note="first <b>run</b>")
    record(runs / "one" / "b.h5", profile="paper", c=2, gammas=(1.0, 1.4), lost=70)
    record(runs / "two" / "c.h5", profile="spring", gammas=(1.5, 1.9), note="100% sure")
    return runs
