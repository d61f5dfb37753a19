"""Lose samples in whole runs through `rig.execution.run.run_ramp`: found, count right, false alarms.

Behind a driver's buffer, blocks stay whole and the looped-back drive alone tells (up to the buffer's length; what is
beyond comes short). As many runs lose nothing.

    python -m benchmarks.rig.run_losses --runs 100
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.profiles.find import load
from benchmarks.daq.losses import arguments, drawn_loss
from daq.files.tables import Block
from daq.recording import open_recording, verify
from daq.recording.writer import RecordingWriter
from rig.backends.simulated import SimulatedBackend
from rig.execution.run import run_ramp
from rig.profile import Profile
from rig.programme.ramp import plan
from rig.sim.scenario import Scenario
from tests.fakes.faults import Device, Fault, FaultyBackend, LostFrames

BUFFER = 600  # samples; less than a cycle, or the interlock takes the silence for a dead accelerometer


class Buffered(Fault):
    """A driver's buffer: a loss before it shortens the buffer, not the blocks."""

    def reset(self, device: Device) -> None:
        self._held = np.zeros((BUFFER, len(device.columns)), np.int16)

    def on_drive(self, first: int, drive_v: np.ndarray) -> np.ndarray:
        self._asked = len(drive_v)
        return drive_v

    def on_block(self, first: int, block: Block) -> Block:
        held = np.concatenate([self._held, block.codes])
        n = min(len(held), self._asked)
        self._held = held[n:]
        return replace(block, codes=held[:n], clock_ns=0)


def run(profile: Profile, faults: list[Fault], seed: int, path: Path) -> tuple[list[list[int]], bool]:
    """Gaps that the recording declares, and whether it says suspect."""
    device = FaultyBackend(SimulatedBackend(profile.sampling.rate_hz, Scenario("ideal"), seed), faults)
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=device.channels, backend="simulated", simulated=True,
        scales=device.scales,
    )  # fmt: skip
    run_ramp(profile, device, writer)
    with open_recording(path) as recording:
        gaps = recording.gaps.tolist()
    suspect = verify(path).suspect
    path.unlink()
    return gaps, suspect


def main() -> None:
    """Run and print the score."""
    options = arguments(__doc__.splitlines()[0])
    rng = np.random.default_rng(options.seed)
    profiles = [load(name)[0] for name in ("simulated", "c2", "c3")]
    found = right = alarms = doubted = 0
    with tempfile.TemporaryDirectory() as folder:
        for i in range(options.runs):
            whole = profiles[i % 3]
            ramp = whole.ramp.model_copy(update={"gamma": (0.4, 0.7, 0.5), "order": None})
            profile = whole.model_copy(update={"ramp": ramp})
            lost = drawn_loss(rng)
            at = int(rng.integers(15_000, plan(profile).n_samples - 15_000))
            gaps, suspect = run(profile, [LostFrames(at, lost), Buffered()], i, Path(folder) / "lossy.h5")
            total = sum(n for _, n in gaps)
            found, doubted = found + bool(gaps), doubted + suspect
            right += abs(total - lost) <= 1
            if abs(total - lost) > 1:
                print(f"  run {i}: c = {1 + i % 3}, lost {lost} at {at}, declared {gaps}, suspect {suspect}")
            alarms += bool(run(profile, [Buffered()], i, Path(folder) / "clean.h5")[0])
    print(f"found {found}/{options.runs}, count right to 1 sample {right}/{options.runs}, suspect {doubted}")
    print(f"clean runs with a false alarm: {alarms}/{options.runs}")


if __name__ == "__main__":
    main()
