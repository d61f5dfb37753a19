"""Events changed by hand: whatever finds flights reads them and says so; undone, the flights are those found."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import FlightFlag, Flights, flights_of
from analysis.residuals.observations import observed
from daq.recording import open_recording
from daq.recording.header import stored_id
from daq.recording.notebook import change_remarks, made_now, side_file, with_event
from daq.setup.errors import InputError


@pytest.fixture
def recording(make, tmp_path: Path) -> Path:
    """A copy of a ramp of the simulated rig, which the test may change."""
    return Path(shutil.copy(make([0.9, 1.6, 1.9]).path, tmp_path / "run.h5"))


def read(path: Path) -> Flights:
    """All flights of a recording."""
    with open_recording(path) as opened:
        return flights_of(opened)


def change(path: Path, kind: str, was_s: float | None, now_s: float | None) -> Flights:
    """The flights after one more change."""
    with open_recording(path) as opened:
        identity = stored_id(opened)
    change_remarks(path, identity, lambda now: with_event(now, made_now(kind, was_s, now_s)))
    return read(path)


def test_edges_and_impacts_are_moved_removed_and_added(recording: Path) -> None:
    """A take-off moves, a landing taken away with its impact joins two flights, an impact splits one; all is undone."""
    found = read(recording)
    plain = np.flatnonzero(found.good() & ~found.has(FlightFlag.ACCELEROMETER) & (found.duration_s > 5e-3))
    i = int(plain[3])
    takeoff, landing = found.takeoff_s[i], found.landing_s[i]
    moved = change(recording, "takeoff", takeoff, takeoff + 2e-4)
    assert len(moved) == len(found) and moved.takeoff_s[i] == takeoff + 2e-4
    assert moved.has(FlightFlag.BY_HAND).sum() == 1 and moved.landing_s[i] == landing
    middle = 0.5 * (takeoff + landing)
    split = change(recording, "impact", None, middle)
    assert len(split) == len(found) + 1 and split.landing_s[i] == middle
    heard = change(recording, "landing", landing, None)  # the accelerometer still shows it
    assert heard.has(FlightFlag.ACCELEROMETER)[i + 1] and heard.landing_s[i + 1] == pytest.approx(landing, abs=2e-5)
    joined = change(recording, "impact", heard.landing_s[i + 1], None)
    assert len(joined) == len(found) and joined.landing_s[i + 1] == pytest.approx(found.landing_s[i + 1], abs=1e-9)
    (said,) = (line for line in _observed(recording) if "by hand" in line)
    assert said.startswith("4 events were changed by hand (1 moved, 2 removed, 1 added), the last")
    for _ in range(4):
        change_remarks(recording, "", lambda now: with_event(now, None))
    assert np.array_equal(read(recording).takeoff_s, found.takeoff_s) and not side_file(recording).exists()
    with pytest.raises(InputError, match="nothing to take back"):
        change_remarks(recording, "", lambda now: with_event(now, None))


def _observed(path: Path) -> tuple[str, ...]:
    """Remarks on the data of a closed loop of the recording."""
    with open_recording(path) as opened:
        return observed(opened, flights_of(opened), with_mode=False).notes


def test_a_changed_event_of_another_recording_of_that_name_is_left_alone(recording: Path) -> None:
    """The side file carries the identity of its recording: one that has its name neither reads nor changes it."""
    changed = change_remarks(recording, "0" * 32, lambda now: with_event(now, made_now("impact", None, 0.5)))
    assert len(changed.events) == 1 and not read(recording).edges.by_hand
    with pytest.raises(InputError, match="another recording that had this name"):
        change(recording, "impact", None, 0.6)
    side_file(recording).unlink()
    change_remarks(recording, "", lambda now: with_event(now, made_now("impact", None, 0.5)))  # before a run was over
    assert not read(recording).edges.by_hand
    with pytest.raises(InputError, match="at least one time"):
        made_now("landing", None, None)
    with pytest.raises(InputError, match="takeoff, landing, impact"):
        made_now("jump", 1.0, 2.0)
