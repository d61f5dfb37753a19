"""Each device fault does what it says, to the sample, and nothing else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from daq.files.tables import Block, BlockFlag
from rig.backends.base import BackendError
from rig.backends.simulated import SimulatedBackend
from rig.sim.scenario import Scenario
from tests.fakes.faults import (
    AcCoupling,
    AmplifierTrip,
    Clipping,
    ClockError,
    Fault,
    FaultyBackend,
    JammedSensor,
    LooseCable,
    LostFrames,
    RepeatedBlock,
    Unplugged,
)

RATE_HZ = 20000.0
BLOCK = 500
DRIVE_V = 1.2 * np.sin(2.0 * math.pi * 25.37 * np.arange(20000) / RATE_HZ)


def run(*faults: Fault) -> list[Block]:
    """One second of the ideal rig through faults, in blocks of 500."""
    backend = FaultyBackend(SimulatedBackend(RATE_HZ, Scenario("ideal"), seed=1), faults)
    backend.start()
    blocks = [backend.exchange(piece) for piece in np.split(DRIVE_V, DRIVE_V.size // BLOCK)]
    backend.stop()
    return blocks


def codes(*faults: Fault) -> np.ndarray:
    """Frames of such a run."""
    return np.concatenate([block.codes for block in run(*faults)]).astype(int)


CLEAN = codes()


def test_no_fault_changes_nothing() -> None:
    """The layer without faults is the device."""
    plain = SimulatedBackend(RATE_HZ, Scenario("ideal"), seed=1)
    plain.start()
    assert np.array_equal(CLEAN, plain.exchange(DRIVE_V).codes)


@pytest.mark.parametrize("n_samples", [1, 499, 500, 1234, 5000])
def test_lost_frames_are_missing_and_the_drive_plays_on(n_samples: int) -> None:
    """Frames go missing at a block boundary; recorded indices stay without holes."""
    blocks = run(LostFrames(6100, n_samples))
    frames = np.concatenate([block.codes for block in blocks])
    assert np.array_equal(frames, np.delete(CLEAN, np.s_[6500 : 6500 + n_samples], axis=0))
    starts = np.cumsum([0, *(len(block.codes) for block in blocks)])[:-1]
    assert [block.first_sample for block in blocks] == starts.tolist()
    assert sum(block.lost_before for block in blocks) == 0
    assert not any(block.flags & BlockFlag.OVERFLOW for block in blocks)


def test_a_driver_that_reports_losses_gives_their_number() -> None:
    """Declared: count and overflow flag come with the block after the loss."""
    blocks = run(LostFrames(6100, 700, declared=True))
    reported = [(block.first_sample, block.lost_before) for block in blocks if block.lost_before]
    assert reported == [(6500, 700)]
    assert [bool(block.flags & BlockFlag.OVERFLOW) for block in blocks].count(True) == 1


def test_a_repeated_block_replaces_the_one_after_it() -> None:
    """The block at the fault equals the one before; all others are as without."""
    frames = codes(RepeatedBlock(3000))
    assert np.array_equal(frames[3000:3500], CLEAN[2500:3000])
    keep = np.ones(len(CLEAN), bool)
    keep[3000:3500] = False
    assert np.array_equal(frames[keep], CLEAN[keep])


def test_clock_readings_have_offset_and_drift() -> None:
    """Offset, 200 parts per million, and no jitter: readings to the nanosecond."""
    readings = [block.clock_ns for block in run(ClockError(offset_ns=5_000_000, drift=2e-4))]
    assert readings[0] == 5_000_000 + 25_005_000
    assert np.all(np.diff(readings) == 25_005_000)


def test_late_callbacks_only_delay_readings() -> None:
    """Jitter makes a reading late, never early."""
    jittered = ClockError(jitter_ns=1e6, rng=np.random.default_rng(1))
    late = np.array([block.clock_ns for block in run(jittered)]) - 25_000_000 * np.arange(1, 41)
    assert np.all(late >= 0)
    assert np.std(late) > 3e5


def test_ac_coupling_takes_away_the_mean_and_keeps_the_tone() -> None:
    """0.5 Hz corner: a reading of gravity goes, the forcing's amplitude stays within a percent."""
    backend = SimulatedBackend(RATE_HZ, Scenario("g", {}, {"accelerometer_reads_gravity": 1.0}), seed=1)
    faulty = FaultyBackend(backend, [AcCoupling("accelerometer", 0.5)])
    faulty.start()
    t = np.arange(100000) / RATE_HZ
    volts = 0.2 * np.sin(2.0 * math.pi * 25.0 * t)
    frames = np.concatenate([faulty.exchange(piece).codes for piece in np.split(volts, 100)])[60000:, 1]
    assert abs(frames.mean()) < 2.0
    tone = 2.0 * abs(np.mean(frames * np.exp(-2j * math.pi * 25.0 * t[60000:])))
    assert tone == pytest.approx(0.4 * 0.1 * 32768.0 / 10.0, rel=0.01)


def test_clipping_limits_a_channel() -> None:
    """Nothing above the limit, everything below it untouched."""
    frames = codes(Clipping("accelerometer", 0.1))
    limit = 0.1 * 32768.0 / 10.0
    assert np.abs(frames[:, 1]).max() == int(limit)
    below = np.abs(CLEAN[:, 1]) < limit - 1
    assert np.array_equal(frames[below], CLEAN[below])


def test_a_jammed_sensor_repeats_its_last_value() -> None:
    """From a sample within a block on, one value; before it, the clean data."""
    frames = codes(JammedSensor("accelerometer", 7123))
    assert np.array_equal(frames[:7123], CLEAN[:7123])
    assert np.all(frames[7123:, 1] == CLEAN[7122, 1])
    assert np.array_equal(frames[:, 0], CLEAN[:, 0])


def test_a_loose_cable_comes_and_goes() -> None:
    """Within its span the channel reads 5 V now and then, outside it never; other channels are untouched."""
    frames = codes(LooseCable("continuity", 4000, 9000, np.random.default_rng(2), apart_v=5.0))
    outside = np.ones(len(CLEAN), bool)
    outside[4000:9000] = False
    assert np.array_equal(frames[outside], CLEAN[outside])
    changed = np.abs(frames[4000:9000, 0] - CLEAN[4000:9000, 0]) > 3000
    assert np.count_nonzero(changed) > 100
    assert np.array_equal(frames[:, 1:], CLEAN[:, 1:])


def test_an_unplugged_card_raises_and_stays_away() -> None:
    """The exchange that reaches the moment fails with what to do, and so does the next."""
    backend = FaultyBackend(SimulatedBackend(RATE_HZ, Scenario("ideal"), seed=1), [Unplugged(600)])
    backend.start()
    backend.exchange(np.zeros(BLOCK))
    for _ in range(2):
        with pytest.raises(BackendError, match="cable"):
            backend.exchange(np.zeros(BLOCK))
    backend.stop()


def test_a_tripped_amplifier_stills_the_plate_but_not_the_loop_back() -> None:
    """After the trip the accelerometer is noise alone while the drive reads on."""
    frames = codes(AmplifierTrip(8000))
    assert np.array_equal(frames[:8000], CLEAN[:8000])
    assert np.std(frames[10000:, 1]) < 15
    assert np.abs(frames[8000:, 2] - CLEAN[8000:, 2]).max() <= 6
