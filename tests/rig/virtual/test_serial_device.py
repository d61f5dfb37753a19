"""The rig on a clock of its own: the same rig at 0 ppm, the same events in the drive's time at any other."""

from __future__ import annotations

import numpy as np
import pytest

from daq.clocks.serial_frames import FrameDecoder
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario
from rig.virtual import SerialDevice

RATE = 20000.0


def drive(n: int) -> np.ndarray:
    """A tone that makes the ball fly."""
    return 0.8 * np.sin(2 * np.pi * 25.37 / RATE * np.arange(n))


def sent(ppm: float, n: int, piece: int, ppm_per_minute: float = 0.0) -> tuple[np.ndarray, int]:
    """What comes out of the device, decoded, and the samples lost on the way."""
    device = SerialDevice(Scenario("ideal"), RATE, np.random.default_rng(3), ppm=ppm, ppm_per_minute=ppm_per_minute)
    decoder = FrameDecoder(3)
    played = drive(n)
    frames = [frame for at in range(0, n, piece) for frame in decoder.feed(device.play(played[at : at + piece]))]
    assert (decoder.counts.damaged, decoder.counts.stale) == (0, 0)
    return np.concatenate([frame.codes for frame in frames]), decoder.counts.lost_samples


def test_on_the_drives_own_clock_it_is_the_rig() -> None:
    """At 0 ppm the codes are the plant's, sample for sample, whatever the pieces."""
    plant = Plant(Scenario("ideal", {"clock_error": {"relative": 0.0}}), RATE, np.random.default_rng(3))
    wanted = plant.exchange(drive(30_000))
    for piece in (256, 999, 30_000):
        codes, lost = sent(0.0, 30_000, piece)
        assert lost == 0 and 29_700 < len(codes) <= 30_000
        assert np.array_equal(codes, wanted[: len(codes)])


@pytest.mark.parametrize(("ppm", "ppm_per_minute"), [(200.0, 0.0), (-200.0, 0.0), (0.0, 60.0)])
def test_on_another_clock_the_drive_is_where_its_time_says(ppm: float, ppm_per_minute: float) -> None:
    """The device's frame m hears the drive of its own instant, to the converter's step, also between the samples."""
    codes, _ = sent(ppm, 100_000, 512, ppm_per_minute)
    m = np.arange(len(codes))
    scale = Plant(Scenario("ideal"), RATE, np.random.default_rng(0)).channel_scales["drive"]
    place = m * (1.0 + 1e-6 * (ppm + 0.5 * ppm_per_minute / 60.0 * m / RATE))
    wanted = 0.8 * np.sin(2 * np.pi * 25.37 / RATE * place)
    off = codes[:, 2] * scale - wanted
    assert np.abs(off).max() < 6.0 * scale + 2e-4
    moved = len(codes) - 100_000 / (1.0 + 1e-6 * (ppm + 0.5 * ppm_per_minute / 60.0 * 5.0))
    assert -300 < moved <= 1
