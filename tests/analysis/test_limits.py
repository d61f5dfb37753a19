"""What cannot be analysed in time, or makes no sense together, is refused with the reason before any work."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from analysis.flights.compare import compare
from analysis.residuals import observations
from daq.setup.errors import InputError


def test_a_plate_at_a_million_g_is_not_compared() -> None:
    """A plate that no shaker moves so is refused with the scale to check, not followed for minutes."""
    steps = [None, SimpleNamespace(step=1, gamma=1e6)]
    with pytest.raises(ValueError, match=r"step 1: the accelerometer reads gamma = 1e\+06.*sensitivity"):
        compare(SimpleNamespace(plate=SimpleNamespace(steps=steps)), SimpleNamespace())


def test_recordings_of_unlike_c_are_not_judged_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two recordings of another c each are refused by name before either is analysed."""

    @contextmanager
    def opened(path: Path):
        yield SimpleNamespace(setup=SimpleNamespace(forcing=SimpleNamespace(ratio=len(path.stem))))

    monkeypatch.setattr(observations, "open_recording", opened)
    with pytest.raises(InputError, match=r"recordings of one c .* one\.h5: 3, three\.h5: 5"):
        observations.observations_from([Path("one.h5"), Path("three.h5")])
