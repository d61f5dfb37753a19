"""The evidence behind a verdict: from its numbers to rivals, steps, residuals and edges, all from the saved loop."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from starlette.testclient import TestClient

from analysis.loop.result import ClosedLoop
from bench.jobs.loops import keep_verdict
from bench.runs.folder import run_id
from bench.runs.pages import section
from bench.runs.prepare import evidence
from bench.web.access import Access
from bench.web.serve import Place, make_app
from daq.recording.notebook import change_remarks, made_now, with_event
from daq.setup.errors import InputError
from tests.bench.runs.recordings import verdict_on
from tests.bench.runs.test_pages import OWN, ready
from tests.loops import changed


def test_every_number_has_its_rows(closed_loop: ClosedLoop) -> None:
    """Each step's error is the rms of its residuals; measured less predicted is the residual; times jump over gaps."""
    loop = changed(closed_loop, sources=(dataclasses.replace(closed_loop.sources[0], identity="ab"),))
    found = evidence(loop, "ab", np.array([[20_000, 1000]]), 10_000.0)
    flights = {name: np.array(column, float) for name, column in found["flights"].items()}
    for step in found["steps"]:
        own = (flights["step"] == step["step"]) & (flights["scored"] == 1)
        assert step["flights"] == own.sum() == 11
        assert step["declared_us"] == pytest.approx(np.sqrt(np.mean(flights["declared_us"][own] ** 2)))
    left = 1e6 * (flights["landing_s"] - flights["improved_landing_s"])
    assert np.allclose(left[flights["scored"] == 1], flights["improved_us"][flights["scored"] == 1], atol=2e-3)
    assert np.allclose(flights["shown_s"] - flights["takeoff_s"], np.where(flights["takeoff_s"] < 2.0, 0.0, 0.1))
    outcomes = {tuple(row["names"]): row["outcome"] for row in found["rivals"]}
    assert outcomes[("coulomb_friction",)] == "added" and outcomes[("adhesion",)] == "less good"
    assert outcomes[("stribeck_friction",)] == "the data cannot tell it from the best"
    with pytest.raises(InputError, match="no flight of this recording"):
        evidence(loop, "cd", np.zeros((0, 2), np.int64), 1e4)


def test_a_page_opens_the_evidence_of_the_saved_verdict(folder: Path, closed_loop: ClosedLoop) -> None:
    """The page gives steps and rivals of the latest verdict, then the flights of one step; without one it says so.

    An event that is changed after a verdict is said of it.
    """
    run = folder / "one" / "a.h5"
    keep_verdict(verdict_on(closed_loop, run), [run])
    with TestClient(make_app(Access("127.0.0.1", 8625), [section(Place(folder.resolve()))]), base_url=OWN) as client:
        address = f"/runs/api/{run_id('one/a.h5')}/why"
        client.get("/runs/api/list")
        told = ready(client, address)
        assert len(told["steps"]) == 9 and told["rivals"][0]["names"] == ["coulomb_friction"]
        step = ready(client, f"{address}?step=4")
        assert step["step"] == [4] * 12 and len(step["declared_us"]) == len(step["takeoff_s"]) == 12
        assert client.get(f"/runs/api/{run_id('two/c.h5')}/why").status_code == 404
        details = f"/runs/api/{run_id('one/a.h5')}"
        assert not client.get(details).json()["loops"][0]["outdated"]
        identity = client.get(details).json()["run"]["identity"]
        change_remarks(run, identity, lambda now: with_event(now, made_now("landing", 0.1, 0.2)))
        assert client.get(details).json()["loops"][0]["outdated"]
