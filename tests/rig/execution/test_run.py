"""A run into a real recording: reproducible, stoppable, and kept whatever fails."""

from __future__ import annotations

import numpy as np
import pytest

from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from rig.execution.operator import StopRequest
from rig.execution.plate_monitor import ToneMeter
from rig.execution.run import run_ramp
from rig.programme.ramp import plan
from rig.programme.sequencer import State, Stop
from tests.fakes.commanded_drive import commanded, fades_of_changes, fades_of_steps
from tests.fakes.faults import FaultyBackend, LostFrames


def record(profile, rig, path, **options):
    """Run the profile on the device into a recording."""
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=rig.channels, backend=rig.name, simulated=True,
        scales=rig.scales,
    )  # fmt: skip
    return run_ramp(profile, rig, writer, **options)


@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_commanded_samples_come_back_bit_for_bit(make_profile, fake_rig, recording_path, ratio: int) -> None:
    """What was played is computed again from the recording's setup and step table alone, bit for bit."""
    profile = make_profile(("contact_cycles = 8", "contact_cycles = 0"), ratio=ratio)
    rig = fake_rig(profile)
    summary = record(profile, rig, recording_path)
    assert (summary.how, summary.steps_driven) == ("complete", 3)
    with open_recording(recording_path) as recording:
        assert recording.attrs["ended"] == "complete"
        assert recording.n_samples == summary.n_samples == len(rig.drive_v)
        by_steps = fades_of_steps(recording.setup, recording.steps)
        by_changes = fades_of_changes(recording.setup, recording.drive_changes)
        for fades in (by_steps, by_changes):
            assert np.array_equal(commanded(recording.setup, fades, 0, recording.n_samples), rig.drive_v)
        assert recording.steps["gamma"].tolist() == [0.2, 0.5, 0.3]


def test_a_stop_leaves_a_valid_recording(make_profile, fake_rig, recording_path) -> None:
    """Asked to stop in the second step: marked stopped with the reason, cut step in the table, samples reproducible."""
    profile, request = make_profile(), StopRequest()

    def watch(status) -> None:
        if status.step.index == 1 and status.sample > status.step.first_sample + 100:
            request.ask(Stop.RAMP_DOWN, "the operator asked")
            request.ask(Stop.FINISH_STEP, "a weaker wish")

    rig = fake_rig(profile)
    summary = record(profile, rig, recording_path, progress=watch, stop_request=request)
    assert (summary.how, summary.why, summary.steps_driven) == ("stopped", "the operator asked", 2)
    with open_recording(recording_path) as recording:
        assert (recording.attrs["ended"], recording.attrs["why"]) == ("stopped", "the operator asked")
        assert len(recording.steps) == 2
        fades = fades_of_steps(recording.setup, recording.steps)
        assert np.array_equal(commanded(recording.setup, fades, 0, recording.n_samples), rig.drive_v)
        assert not np.any(rig.drive_v[-40:])


def test_an_unplugged_device_fails_the_run_and_keeps_the_data(make_profile, fake_rig, recording_path) -> None:
    """The card goes away mid-run: the run failed, what came before is kept, the cut step says how long it was."""
    profile = make_profile()
    rig = fake_rig(profile)
    rig.unplugged_from = 1000
    summary = record(profile, rig, recording_path)
    assert summary.how == "failed" and "the card is gone" in summary.why
    with open_recording(recording_path) as recording:
        assert recording.attrs["ended"] == "failed"
        assert recording.n_samples == len(rig.drive_v) > 900
        last = recording.steps[-1]
        assert last["first_sample"] + last["n_samples"] == recording.n_samples


@pytest.mark.parametrize("where", ["the screen", "the recorder", "a measurement"])
def test_an_exception_of_our_own_lands_softly(make_profile, fake_rig, recording_path, monkeypatch, where: str) -> None:
    """Whatever raises an error in each block, the plate is not jolted: the drive fades, the recording says failed."""
    profile = make_profile()
    rig = fake_rig(profile)
    rig.simulated = False  # each block is written as it comes

    def crash(*arguments) -> None:
        if len(rig.drive_v) > 700:
            raise RuntimeError(f"{where} is gone")
        if where == "the recorder":
            append(*arguments)

    append = RecordingWriter.append
    if where == "the recorder":
        monkeypatch.setattr(RecordingWriter, "append", crash)
    if where == "a measurement":
        monkeypatch.setattr(ToneMeter, "add", crash)
    with pytest.raises(RuntimeError, match=f"{where} is gone"):
        record(profile, rig, recording_path, progress=crash if where == "the screen" else None)
    assert not np.any(rig.drive_v[-40:]) and np.abs(np.diff(rig.drive_v)).max() < 0.06
    assert not rig.running
    with open_recording(recording_path) as recording:
        assert recording.attrs["ended"] == "failed" and f"{where} is gone" in recording.attrs["why"]


def test_a_full_disk_stops_the_drive_softly(make_profile, fake_rig, recording_path, monkeypatch) -> None:
    """A disk that refuses ends the run softly; the blocks before it are kept."""
    profile = make_profile()
    rig = fake_rig(profile)
    rig.simulated = False  # each block is written as it comes
    append, kept = RecordingWriter.append, [0]

    def refuse(self, *blocks) -> None:
        for block in blocks:
            if kept[-1] > 300:
                raise OSError("no space left on device")
            append(self, block)
            kept.append(self.n_samples)

    monkeypatch.setattr(RecordingWriter, "append", refuse)
    summary = record(profile, rig, recording_path)
    assert summary.how == "failed" and "no space left" in summary.why
    assert not np.any(rig.drive_v[-40:]) and np.abs(np.diff(rig.drive_v)).max() < 0.06
    with open_recording(recording_path) as recording:
        assert recording.n_samples == kept[-1] > 300


@pytest.mark.parametrize("declared", [True, False])
@pytest.mark.parametrize(("at", "lost"), [(300, 5), (655, 40), (900, 333)])
def test_lost_frames_are_counted_and_steps_stay_in_place(
    make_profile, fake_rig, recording_path, declared: bool, at: int, lost: int
) -> None:
    """Frames that never came are declared where they are missing; the table still points at the right samples."""
    profile = make_profile()
    rig = fake_rig(profile)
    device = FaultyBackend(rig, [LostFrames(at, lost, declared=declared)])
    summary = record(profile, device, recording_path)
    assert (summary.how, summary.lost_samples) == ("complete", lost)
    with open_recording(recording_path) as recording:
        assert recording.n_samples + lost == len(rig.drive_v)
        (gap,) = recording.gaps.tolist()
        assert gap[1] == lost and at <= gap[0] < at + 20
        kept = np.delete(rig.drive_v, np.s_[gap[0] : gap[0] + lost])
        assert np.abs(recording.read_v("drive") - kept).max() < 1e-3
        fades = fades_of_changes(recording.setup, recording.drive_changes)
        assert np.array_equal(commanded(recording.setup, fades, 0, len(rig.drive_v)), rig.drive_v)
        played = np.delete(np.arange(len(rig.drive_v)), np.s_[gap[0] : gap[0] + lost])
        planned = [step.first_sample for step in plan(profile).steps]
        for row, first in zip(recording.steps, planned, strict=True):
            assert played[row["first_sample"]] >= first
            assert row["first_sample"] == 0 or played[row["first_sample"] - 1] < first
            assert row["achieved_gamma"] == pytest.approx(row["gamma"], rel=2e-3)


def test_a_hold_that_nobody_ends_is_a_stop(make_profile, fake_rig, recording_path, monkeypatch) -> None:
    """Held longer than a plate shakes by itself, the run is stopped, by nobody's wish, and says why."""
    monkeypatch.setattr("rig.programme.sequencer.LONGEST_PAUSE_S", 0.5)
    profile, request = make_profile(("contact_cycles = 8", "contact_cycles = 0")), StopRequest()
    request.hold("a person")
    summary = record(profile, fake_rig(profile), recording_path, stop_request=request)
    assert (summary.how, summary.asked, summary.steps_driven) == ("stopped", False, 1)
    assert "without being resumed" in summary.why


def test_a_trip_after_a_stop_is_not_hidden_by_it(make_profile, fake_rig, recording_path) -> None:
    """Asked to finish the step, then tripped: both are said, and it is no longer the operator's end alone."""
    profile, request = make_profile(), StopRequest()
    rig = fake_rig(profile)

    def watch(status) -> None:
        request.ask(Stop.FINISH_STEP, "the operator asked")
        rig.dead_from = 0  # the accelerometer

    summary = record(profile, rig, recording_path, progress=watch, stop_request=request)
    assert summary.how == "stopped" and summary.why.startswith("the operator asked; then interlock: ")
    assert not summary.asked


def test_notes_and_a_pause_are_kept(make_profile, fake_rig, recording_path) -> None:
    """Notes stand in the recording at the sample where they came, and a pause lies between two whole steps."""
    profile, request = make_profile(("contact_cycles = 8", "contact_cycles = 0")), StopRequest()
    paused = 0

    def watch(status) -> None:
        nonlocal paused
        request.pause = status.step.index == 0 and paused < 30
        paused += status.state is State.PAUSED
        if paused == 10:
            request.notes = ["ball looks dusty", "\u03b3 \N{DEGREE SIGN} " + 200 * "\u03b3\u03b3"]

    rig = fake_rig(profile)
    summary = record(profile, rig, recording_path, progress=watch, stop_request=request)
    assert (summary.how, summary.steps_driven) == ("complete", 3) and paused >= 30
    with open_recording(recording_path) as recording:
        first, second = recording.steps[:2]
        end = first["first_sample"] + first["n_samples"]
        assert end < recording.notes["first_sample"][0] < second["first_sample"]
        texts = [text.decode() for text in recording.notes["text"]]
        assert texts[0] == "ball looks dusty" and texts[1].startswith("\u03b3 \N{DEGREE SIGN}")
        fades = fades_of_changes(recording.setup, recording.drive_changes)
        assert np.array_equal(commanded(recording.setup, fades, 0, recording.n_samples), rig.drive_v)
