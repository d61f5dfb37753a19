"""Runs made until one explanation stands: what had been computed is kept when one of them fails."""

from pathlib import Path

import pytest

from analysis.loop.design import Design, Ranked
from analysis.loop.result import ClosedLoop
from bench.jobs import loops


class Simulated:
    """A recording of the simulated rig, as far as it is looked at."""

    attrs = {"simulated": True, "profile_text": "name = 'x'"}

    def __enter__(self) -> "Simulated":
        return self

    def __exit__(self, *_: object) -> None:
        pass


def test_a_failed_run_keeps_the_verdict_before_it(closed_loop: ClosedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop closed before a run that cannot be driven comes back with the reason, instead of an exception."""
    ranked = Ranked(Design("ratio_2", "c = 2", 2, (0.3, 0.5)), 90.0, ("restitution",))

    monkeypatch.setattr(loops, "open_recording", lambda path: Simulated())
    monkeypatch.setattr(loops, "fit_loop", lambda *a, **k: (closed_loop, None))
    monkeypatch.setattr(loops, "possible_runs", lambda *a: [ranked])
    monkeypatch.setattr(loops, "profile_of", lambda text, design: text)
    monkeypatch.setattr(loops, "profile_text", lambda path: "name = 'next'")
    found, _, made, failure = loops.until_clear([Path("run.h5")], None, 1, say=lambda line: None, quiet=True)
    assert found is closed_loop and made == [Path("run.h5")]
    assert "next_run.toml" in failure and "ramp" in failure
