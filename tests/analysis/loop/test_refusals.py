"""Recordings that no loop can be closed on: an error that names the file and what to look at, never a library's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.linear_algebra import NotFiniteError
from analysis.loop import close_loop
from analysis.loop.close_loop import judge_loop
from analysis.residuals.forward_model import ForwardModel
from daq.setup.errors import InputError


def test_a_recording_without_a_flight_to_compare_is_refused(
    fly_ramp: Callable[..., ForwardModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contact and accelerometer exchanged leave no landing that could be predicted."""
    made = fly_ramp({}, 0).observations
    none = np.zeros(len(made), dtype=bool)
    bare = replace(made, scored=none, measured=replace(made.measured, wanted=none))
    monkeypatch.setattr(close_loop, "observations_from", lambda *args, **options: bare)
    with pytest.raises(InputError, match=r"run\.h5: wanted flights .* found none; see with bench info"):
        judge_loop([Path("run.h5")], anyway=True)


def test_a_declared_model_that_cannot_be_fitted_names_the_recording(
    fly_ramp: Callable[..., ForwardModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where not even the declared model is finite, the file and the places to look at are named."""

    def failing(*args: object) -> None:
        raise NotFiniteError("its equations are not finite")

    made = fly_ramp({}, 0).observations
    monkeypatch.setattr(close_loop, "observations_from", lambda *args, **options: made)
    monkeypatch.setattr(close_loop.StepwiseSelection, "run", failing)
    with pytest.raises(InputError, match=r"run\.h5: the declared model cannot be fitted.*bench info.*profile"):
        judge_loop([Path("run.h5")], anyway=True)
