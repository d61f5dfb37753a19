"""Events on the page of a run: their places in the scope where samples were lost, changes by hand, and undo."""

from __future__ import annotations

import json
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
from starlette.testclient import TestClient

from bench.runs.folder import run_id
from bench.runs.pages import section
from bench.runs.prepare import Workshop, make_flights
from bench.runs.scope import on_recording, on_scope
from bench.web.access import Access
from bench.web.serve import Place, make_app
from daq.recording.notebook import read_remarks, side_file
from tests.bench.runs.test_pages import OWN, ready


def test_times_of_the_scope_and_of_the_recording() -> None:
    """A time of the recording leads to the scope and back across gaps; one within a gap leads to its beginning."""
    gaps = np.array([[500, 70], [800, 30]])
    times = np.array([0.0, 0.4999, 0.5, 0.7, 0.9])
    shown = on_scope(times, gaps, 1000.0)
    assert shown.tolist() == pytest.approx([0.0, 0.4999, 0.57, 0.77, 1.0])
    assert [on_recording(t, gaps, 1000.0) for t in shown] == pytest.approx(times.tolist())
    assert on_recording(0.53, gaps, 1000.0) == on_recording(0.57, gaps, 1000.0) == 0.5


def test_events_are_changed_and_undone_on_the_page(folder: Path, tmp_path: Path) -> None:
    """A page lists events, moves one, and takes it back; its file says who did it; what is no change is refused."""
    run, own = folder / "one" / "b.h5", {"origin": OWN}
    address = f"/runs/api/{run_id('one/b.h5')}"
    with TestClient(make_app(Access("127.0.0.1", 8625), [section(Place(folder.resolve()))]), base_url=OWN) as client:
        assert client.post(f"{address}/events", json={"undo": True}, headers=own).status_code == 409
        ready(client, f"{address}/open")
        found = ready(client, f"{address}/events?from_s=0&to_s=1.07")
        assert found["count"] == len(found["events"]["kind"]) > 40 and found["changes"] == 0 and not found["said"]
        i = next(k for k, t in enumerate(found["events"]["shown_s"]) if t > 0.6)
        kind, was_s, shown_s = (found["events"][name][i] for name in ("kind", "at_s", "shown_s"))
        assert shown_s == pytest.approx(was_s + 0.07)
        moved = {"kind": kind, "was_s": was_s, "now_shown_s": shown_s + 0.002}
        told = client.post(f"{address}/events", json=moved, headers=own).json()
        assert told["said"][0].startswith("1 event was changed by hand (1 moved), the last")
        (change,) = read_remarks(side_file(run)).events
        assert change.now_s == pytest.approx(was_s + 0.002) and change.at
        changed = json.loads(make_flights(run, tmp_path / "made.json", (change,)).read_text())["events"]
        assert not make_flights(run, tmp_path / "late.json", ()).exists()  # the change came while they were found
        assert changed["by_hand"][i] and changed["shown_s"][i] == pytest.approx(shown_s + 0.002)
        assert client.get(f"{address}/events?from_s=0").status_code == 422
        for wrong in ({}, [1], moved | {"kind": "jump"}, {"kind": kind, "was_s": None, "now_shown_s": None}):
            assert client.post(f"{address}/events", json=wrong, headers=own).status_code == 422
        client.post(f"{address}/events", json={"undo": True}, headers=own)
        assert not side_file(run).exists()
        assert ready(client, f"{address}/events?from_s=0&to_s=1.07") == found


def test_flights_of_an_earlier_version_are_found_anew(folder: Path) -> None:
    """Where the folder holds flights that an earlier program made, they are made anew, and are those that are shown."""
    run, workshop = folder / "one" / "b.h5", Workshop(folder)
    old = workshop.place / "old.flights.json"
    old.write_text('{"version": 1, "steps": []}')
    done = Future[Path]()
    done.set_result(old)
    workshop._jobs["flights old.flights.json"] = done
    row = {"identity": "old", "ended": "complete"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.runs.prepare.FLIGHTS_VERSION", 0)
        workshop._read("flights", old)
        old.write_text('{"version": 0, "steps": [1]}')
        assert workshop.flights(row, run) == {"version": 0, "steps": [1]}
    workshop.close()
