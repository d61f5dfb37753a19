"""What cannot be analysed in time, or makes no sense together, is refused with the reason before any work."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest

from analysis.residuals import observations
from daq.setup.errors import InputError


def test_recordings_of_unlike_c_are_not_judged_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two recordings of another c each are refused by name before either is analysed."""

    @contextmanager
    def opened(path: Path):
        yield SimpleNamespace(setup=SimpleNamespace(forcing=SimpleNamespace(ratio=len(path.stem))))

    monkeypatch.setattr(observations, "open_recording", opened)
    with pytest.raises(InputError, match=r"recordings of one c .* one\.h5: 3, three\.h5: 5"):
        observations.observations_from([Path("one.h5"), Path("three.h5")])
