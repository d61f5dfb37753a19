"""A small profile for every test of the rig's hands, and a device that does as it is told."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.files.tables import Block, volts_per_code
from rig.backends.base import BackendError
from rig.profile import Profile, parse_profile

TEXT = """
name = "test"
[sampling]
rate_hz = 2000
[forcing]
frequency_hz = 25.37
ratio = {ratio}
[drive]
g_per_volt = 2.0
[channels.continuity]
[channels.accelerometer]
sensitivity = 0.1
unit = "V/g"
[ball]
mass_kg = 0.25
[ramp]
gamma = [0.2, 0.5, 0.3]
settle_cycles = 2
hold_cycles = 3
[limits]
drive_v = 9.5
plate_mps2 = 120.0
displacement_m = 0.02
velocity_mps = 2.0
contact_cycles = 8
"""


@pytest.fixture(scope="session")
def make_profile() -> Callable[..., Profile]:
    """A profile of three short steps; keyword ``ratio``, and ``(old, new)`` replacements of its text."""

    def make(*changes: tuple[str, str], ratio: int = 1) -> Profile:
        text = TEXT.format(ratio=ratio)
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        return parse_profile(text, "test.toml")

    return make


class FakeRig:
    """A device whose plate follows the drive exactly, with the ball at rest; faults on demand, by sample index."""

    name = "fake"
    simulated = True
    scenario_sha256: str | None = None
    channels = ("continuity", "accelerometer", "drive")

    def __init__(self, profile: Profile) -> None:
        self.rate_hz = profile.sampling.rate_hz
        scale = volts_per_code(10.0)
        self.scales = dict.fromkeys(self.channels, (scale, 0.0))
        self.played: list[np.ndarray] = []
        self.running = False
        self.dead_from = self.unplugged_from = self.open_from = self.silent_from = 10**9
        self.order = (0, 1, 2)  # of the inputs, as they are wired
        self.flags = 0  # of blocks without drive
        self.gain = 1.0
        self.noise_v, self._rng = 0.0, np.random.default_rng(0)
        self.ball_flies = False
        self.stalls_from, self.stall_s = 10**9, 0.0

    @property
    def drive_v(self) -> np.ndarray:
        """Everything played so far."""
        return np.concatenate(self.played) if self.played else np.zeros(0)

    def start(self) -> None:
        self.running = True

    def exchange(self, drive_v: np.ndarray) -> Block:
        first = sum(map(len, self.played))
        if not self.running or first + len(drive_v) > self.unplugged_from:
            raise BackendError("the card is gone")
        index = first + np.arange(len(drive_v))
        volts = np.zeros((len(drive_v), 3))
        volts[:, 0] = 5.0 * ((index >= self.open_from) | (self.ball_flies & (drive_v > 0.5)))
        volts[:, 1] = np.where(index < self.dead_from, self.gain * drive_v * 2.0 * 0.1, 0.0)
        volts[:, 2] = drive_v
        volts[index >= self.silent_from, 1:] = 0.0
        volts = volts[:, self.order] + self.noise_v * self._rng.standard_normal(volts.shape)
        self.played.append(np.array(drive_v))
        if first >= self.stalls_from:
            time.sleep(self.stall_s)
            self.stall_s = 0.0
        codes = np.clip(np.rint(volts / volts_per_code(10.0)), -32768, 32767).astype(np.int16)
        return Block(first_sample=first, codes=codes, flags=self.flags if first >= self.silent_from else 0)

    def stop(self) -> None:
        self.running = False


@pytest.fixture
def fake_rig() -> type[FakeRig]:
    """The class of the obedient device."""
    return FakeRig


@pytest.fixture
def recording_path(tmp_path: Path) -> Path:
    """Where a test may record."""
    return tmp_path / "run.h5"
