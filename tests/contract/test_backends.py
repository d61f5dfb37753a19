"""One suite for every back end: what `rig.backends.base` promises, held over each of them.

A new back end joins by one function in `BACKENDS` that builds it on fakes, without a device.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from bench.jobs.run_ramp import make_backend
from bench.profiles.find import load
from daq.recording import RecordingWriter
from daq.recording.tables import Block
from rig.backends.base import Backend, BackendError, Running
from rig.backends.nidaqmx import NiDaqmxBackend
from rig.backends.replay import ReplayBackend
from rig.backends.serial_daq import SerialReader, SoundcardSerialBackend
from rig.backends.simulated import SimulatedBackend
from rig.backends.soundcard import SoundcardBackend
from rig.fakes.fake_nidaqmx import Bench
from rig.fakes.faults import FaultyBackend
from rig.fakes.serial_device import SerialDevice
from rig.fakes.serial_loopback import WiredCard, WiredPort
from rig.sim.scenario import Scenario

RATE_HZ = 20000.0


def simulated(folder: Path) -> Backend:
    """The simulated rig, ideal."""
    return SimulatedBackend(RATE_HZ, Scenario("ideal"), seed=1)


def replay(folder: Path) -> Backend:
    """Three seconds of the simulated rig, replayed."""
    profile, text = load("simulated")
    source = simulated(folder)
    path = folder / "source.h5"
    with Running(source), RecordingWriter(
        path, profile.setup(), profile_text=text, channels=source.channels, backend="simulated", simulated=True,
        scales=source.scales,
    ) as writer:  # fmt: skip
        for _ in range(60):
            writer.append(source.exchange(np.zeros(1000)))
    return ReplayBackend(path)


def faultless(folder: Path) -> Backend:
    """The simulated rig seen through the layer of faults, without any."""
    return FaultyBackend(simulated(folder), [])


def card_and_serial(folder: Path) -> Backend:
    """The drive through a card, frames from a serial device whose clock is 80 ppm slow."""
    device = SerialDevice(Scenario("ideal"), RATE_HZ, np.random.default_rng(1), ppm=80.0)
    port = WiredPort(device)
    reader = SerialReader("wired", 3, RATE_HZ, lambda: port)
    return SoundcardSerialBackend(
        WiredCard(port, RATE_HZ), reader, dict.fromkeys(device.plant.channels, 10.0), marker_v=0.2
    )


def ni(folder: Path) -> Backend:
    """An NI device, its driver played by the simulated rig."""
    names = ("continuity", "accelerometer", "drive")
    terminals = {name: f"Dev1/ai{i}" for i, name in enumerate(names)}
    return NiDaqmxBackend(RATE_HZ, terminals, dict.fromkeys(names, 10.0), "Dev1/ao0", daqmx=Bench(RATE_HZ).package)


BACKENDS: dict[str, Callable[[Path], Backend]] = {
    "simulated": simulated,
    "replay": replay,
    "faultless": faultless,
    "soundcard+serial": card_and_serial,
    "nidaqmx": ni,
}


@pytest.fixture(params=[*sorted(BACKENDS), "soundcard", "soundcard+serial by drivers"])
def backend(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Backend]:
    """Each back end in turn, not started; the last two through the real drivers, with the plant in another process."""
    if request.param == "soundcard":
        yield SoundcardBackend(request.getfixturevalue("virtual_card"))
    elif request.param in BACKENDS:
        yield BACKENDS[request.param](tmp_path)
    else:
        yield make_backend(request.getfixturevalue("virtual_both")[0])


def drive(n: int, first: int = 0) -> np.ndarray:
    """A gentle sine."""
    return 0.3 * np.sin(2 * np.pi * 25.37 / RATE_HZ * np.arange(first, first + n))


def test_says_what_it_is(backend: Backend) -> None:
    """Name, rate, channels and scales are known before it is started, and make sense."""
    assert backend.name and backend.rate_hz == RATE_HZ
    assert {"accelerometer", "drive"} <= set(backend.channels)
    assert set(backend.scales) == set(backend.channels)
    assert all(scale > 0 for scale, _ in backend.scales.values())


def test_returns_as_many_frames_as_it_was_given(backend: Backend) -> None:
    """Blocks of any size come back whole: int16, one column a channel, indices without holes."""
    expected = 0
    with Running(backend):
        for n in (1, 7, 1024, 200, 3):
            block = backend.exchange(drive(n, expected))
            assert isinstance(block, Block)
            assert block.codes.dtype == np.int16 and block.codes.shape == (n, len(backend.channels))
            assert block.first_sample == expected and block.lost_before == 0
            expected += n


def test_not_started_is_an_error(backend: Backend) -> None:
    """Without start, and after stop, an exchange is refused instead of invented."""
    with pytest.raises(BackendError):
        backend.exchange(np.zeros(10))
    with Running(backend):
        backend.exchange(np.zeros(10))
    with pytest.raises(BackendError):
        backend.exchange(np.zeros(10))


def test_stop_is_idempotent(backend: Backend) -> None:
    """Stop may come before start, twice, and after an error."""
    backend.stop()
    backend.start()
    backend.stop()
    backend.stop()


def test_starts_over(backend: Backend) -> None:
    """A second start begins again at sample 0, with the same frames for the same drive where it is no real device."""
    runs = []
    for _ in range(2):
        with Running(backend):
            first = backend.exchange(drive(2000))
            assert first.first_sample == 0
            runs.append(first.codes)
    if backend.simulated:
        assert np.array_equal(*runs)


def test_block_size_does_not_show(backend: Backend) -> None:
    """The same drive in other blocks gives the same frames, where it is no real device."""
    if not backend.simulated:
        pytest.skip("a real device does not repeat itself")
    whole = drive(6000)
    with Running(backend):
        one = backend.exchange(whole).codes
    with Running(backend):
        many = np.concatenate([backend.exchange(piece).codes for piece in np.split(whole, [10, 77, 1900, 5999])])
    assert np.array_equal(one, many)


@pytest.mark.parametrize("bad", [np.array([np.nan]), np.array([np.inf, 0.0]), np.zeros((3, 2))])
def test_refuses_a_drive_it_cannot_play(backend: Backend, bad: np.ndarray) -> None:
    """NaN, infinity and a wrong shape are refused, and the device still works afterwards."""
    with Running(backend):
        with pytest.raises(ValueError, match="finite"):
            backend.exchange(bad)
        assert len(backend.exchange(np.zeros(5)).codes) == 5


def test_empty_block(backend: Backend) -> None:
    """No samples in, no frames out."""
    with Running(backend):
        assert backend.exchange(np.zeros(0)).codes.shape == (0, len(backend.channels))


def test_replay_plays_what_was_recorded_and_ends(tmp_path: Path) -> None:
    """A replay returns the recording's codes and fails, instead of going on, where the recording ends."""
    backend = replay(tmp_path)
    with Running(backend):
        backend.exchange(np.zeros(59_000))
        with pytest.raises(BackendError, match="ends after 60000 samples"):
            backend.exchange(np.zeros(1001))


def test_pacing_changes_no_sample() -> None:
    """The simulated rig in real time gives the frames it gives at full speed, and not before they are due."""
    frames = []
    for real_time in (False, True):
        backend = SimulatedBackend(RATE_HZ, Scenario("ideal"), 5, real_time=real_time)
        began_ns = time.monotonic_ns()
        with Running(backend):
            blocks = [backend.exchange(drive(500, 500 * i)) for i in range(4)]
        frames.append(np.concatenate([block.codes for block in blocks]))
    assert np.array_equal(*frames)
    assert blocks[-1].clock_ns - began_ns >= 0.1e9
