"""Losses in a run: found on the loop-back where the count of frames tells nothing, declared in the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.profiles.find import load
from daq.files.tables import Block, BlockFlag
from daq.recording import open_recording, verify
from daq.recording.writer import RecordingWriter
from rig.backends.simulated import SimulatedBackend
from rig.execution.loss_account import LossAccount
from rig.execution.run import run_ramp
from rig.sim.scenario import Scenario
from tests.fakes.faults import Fault, FaultyBackend, LostFrames, RepeatedBlock

LONGER = ("hold_cycles = 3", "hold_cycles = 60")


class Buffered(Fault):
    """A driver's buffer: a loss before it shortens the buffer, not the blocks."""

    def __init__(self, n_samples: int) -> None:
        self._n_samples = n_samples

    def reset(self, device) -> None:
        self._held = np.zeros((self._n_samples, len(device.columns)), np.int16)

    def on_block(self, first: int, block: Block) -> Block:
        held = np.concatenate([self._held, block.codes])
        n = min(len(held), self._n)
        self._held = held[n:]
        return replace(block, codes=held[:n])

    def on_drive(self, first: int, drive_v):
        self._n = len(drive_v)
        return drive_v


def record(profile, rig, path):
    """Run the profile on the device into a recording."""
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=rig.channels, backend=rig.name, simulated=True,
        scales=rig.scales,
    )  # fmt: skip
    return run_ramp(profile, rig, writer)


@pytest.mark.parametrize("lost", [1, 17, 45])
def test_a_loss_behind_a_buffer_is_found(make_profile, fake_rig, recording_path, lost: int) -> None:
    """Blocks stay whole, the drive slips: the gap is declared with the right count, near its place."""
    profile = make_profile(LONGER)
    rig = fake_rig(profile)
    summary = record(profile, FaultyBackend(rig, [LostFrames(4000, lost), Buffered(60)]), recording_path)
    assert (summary.how, summary.lost_samples) == ("complete", lost)
    with open_recording(recording_path) as recording:
        ((at, n),) = recording.gaps.tolist()
        assert n == lost and abs(at - 4060) < 40
    assert not verify(recording_path).suspect


@pytest.mark.parametrize(("at", "lost", "seed"), [(36_273, 107, 5), (21_968, 30, 11), (46_868, 2472, 23)])
def test_the_start_of_two_tones_is_not_mistaken(recording_path, at: int, lost: int, seed: int) -> None:
    """At c = 3 a drive that fades in looks like itself a third of a cycle earlier; the latency is told all the same."""
    profile, _ = load("c3")
    ramp = profile.ramp.model_copy(update={"gamma": (0.4, 0.7, 0.5), "order": None})
    profile = profile.model_copy(update={"ramp": ramp})
    rig = SimulatedBackend(profile.sampling.rate_hz, Scenario("ideal"), seed)
    summary = record(profile, FaultyBackend(rig, [LostFrames(at, lost), Buffered(600)]), recording_path)
    assert abs(summary.lost_samples - lost) <= 1


def test_a_repeated_block_is_flagged(make_profile, fake_rig, recording_path) -> None:
    """A block handed out twice in the place of the next shifts nothing: no gap, flagged."""
    profile = make_profile(LONGER)
    record(profile, FaultyBackend(fake_rig(profile), [RepeatedBlock(6000)]), recording_path)
    with open_recording(recording_path) as recording:
        flagged = recording.blocks[(recording.blocks["flags"] & BlockFlag.FILLED) != 0]
        assert len(recording.gaps) == 0 and len(flagged)
        assert np.abs(flagged["first_sample"] - 6000).min() < 3200


@pytest.mark.parametrize("ratio", [1, 3])
def test_a_clean_run_has_nothing_to_declare(make_profile, fake_rig, recording_path, ratio: int) -> None:
    """Without a fault: no gap, no flag, and the counts add up."""
    profile = make_profile(LONGER, ("contact_cycles = 8", "contact_cycles = 0"), ratio=ratio)
    record(profile, fake_rig(profile), recording_path)
    with open_recording(recording_path) as recording:
        assert len(recording.gaps) == 0 and not recording.blocks["flags"].any()
        assert recording.attrs["expected_samples"] == recording.n_samples


def test_frames_that_never_come_back_make_the_file_suspect(make_profile, fake_rig, recording_path) -> None:
    """A device that falls silent before the end: what is missing is in no gap, so the file says so."""
    profile = make_profile()
    rig = fake_rig(profile)
    record(profile, FaultyBackend(rig, [LostFrames(1000, 10**6)]), recording_path)
    assert verify(recording_path).suspect


def test_blocks_that_say_their_place_are_believed(make_profile) -> None:
    """Frames that lie behind the drive, slip by one and lose some: each played sample is found where it is."""
    account = LossAccount(make_profile(), 2, (1.0, 0.0))
    blocks = [
        Block(0, np.zeros((100, 3), np.int16), place=-30),
        Block(100, np.zeros((101, 3), np.int16), place=70),
        Block(201, np.zeros((100, 3), np.int16), place=170),  # the clocks have parted by a frame
        Block(301, np.zeros((60, 3), np.int16), place=310, lost_before=40),
    ]
    kept = []
    for block in blocks:
        account.played(np.arange(100.0))
        kept += account.heard(block, 100)
    kept += account.flush()
    assert [(block.first_sample, block.lost_before) for block in kept] == [(0, 0), (100, 0), (201, 0), (301, 40)]
    assert (account.lost_samples, account.expected_samples) == (40, 401)
    assert (account.next_sample, account.settled_sample) == (370, 370)
    assert [account.recorded(played) for played in (-30, 0, 69, 70, 169, 170, 269)] == [0, 30, 99, 100, 199, 201, 300]
    assert [account.recorded(played) for played in (280, 309, 310, 369)] == [301, 301, 301, 360]  # lost ones: the next
    assert [account.counted(recorded) for recorded in (0, 300, 301, 360)] == [0, 300, 341, 400]
    assert np.array_equal(account.driven(blocks[1], np.zeros(100)), np.r_[70:100, 0:71])
