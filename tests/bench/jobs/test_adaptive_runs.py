"""Runs made until one explanation stands: what had been computed is kept when one of them fails."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import bench.jobs.run_ramp
import bench.profiles.next_run
from bench.jobs import adaptive_runs
from daq.setup.errors import InputError


class Simulated:
    """A recording of the simulated rig, as far as it is looked at."""

    attrs = {"simulated": True, "profile_text": "name = 'x'"}

    def __enter__(self) -> "Simulated":
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_failed_run_keeps_the_verdict_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop closed before the failing run comes back with the reason, instead of an exception."""
    tie = SimpleNamespace(names=("restitution",))
    loop: Any = SimpleNamespace(attribution=SimpleNamespace(ties=(tie, tie)))
    design = SimpleNamespace(priors={}, words="c = 2")

    def fails(*_: Any, **__: Any) -> None:
        raise InputError("no space left on device")

    monkeypatch.setattr("daq.recording.open_recording", lambda path: Simulated())
    monkeypatch.setattr(adaptive_runs, "close_loop", lambda *a, **k: loop)
    monkeypatch.setattr(
        bench.profiles.next_run, "possible_runs", lambda *a: [SimpleNamespace(design=design, nats=90.0)]
    )
    monkeypatch.setattr(bench.profiles.next_run, "profile_of", lambda text, design: text)
    monkeypatch.setattr(bench.profiles.next_run, "profile_text", lambda path: "")
    monkeypatch.setattr("rig.profile.parse_profile", lambda *a: None)
    monkeypatch.setattr(bench.jobs.run_ramp, "make_backend", lambda *a, **k: None)
    monkeypatch.setattr(bench.jobs.run_ramp, "record", fails)
    found, made, failure = adaptive_runs.until_clear([Path("run.h5")], None, 1, say=lambda line: None, quiet=True)
    assert found is loop and made == [Path("run.h5")]
    assert "no space left" in failure
