"""One suite for every back end: what `rig.backends.base` promises, held over each of them.

A new back end joins by one function in `BACKENDS` that builds it on fakes, without a device.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from bench.profiles.find import load
from daq.files.tables import Block
from daq.recording.writer import RecordingWriter
from rig.backends.base import Backend, BackendError, running
from rig.backends.nidaqmx import NiDaqmxBackend
from rig.backends.registry import open_backend
from rig.backends.replay import ReplayBackend
from rig.backends.serial_daq import SerialReader, SoundcardSerialBackend
from rig.backends.simulated import SimulatedBackend
from rig.sim.scenario import Scenario
from rig.virtual import SerialDevice
from tests.fakes.faults import FaultyBackend
from tests.fakes.nidaqmx_bench import Bench
from tests.fakes.serial_loopback import WiredCard, WiredPort

RATE_HZ = 20000.0


class Output(NamedTuple):
    """The drive's output as its device has it: volts now, and a count that grows with all that reaches it."""

    drive_v: float
    activity: int


Made = tuple[Backend, Callable[[], Output]]


def simulated(folder: Path) -> Made:
    """The simulated rig, ideal."""
    backend = SimulatedBackend(RATE_HZ, Scenario("ideal"), seed=1)
    return backend, lambda: Output(backend.drive_v, backend._n_samples)


def replay(folder: Path) -> Made:
    """Three seconds of the simulated rig, replayed; nothing is driven."""
    profile, text = load("simulated")
    source, _ = simulated(folder)
    path = folder / "source.h5"
    with running(source), RecordingWriter(
        path, profile.setup(), profile_text=text, channels=source.channels, backend="simulated", simulated=True,
        scales=source.scales,
    ) as writer:  # fmt: skip
        for _ in range(60):
            writer.append(source.exchange(np.zeros(1000)))
    return ReplayBackend(path), lambda: Output(0.0, 1)


def faultless(folder: Path) -> Made:
    """The simulated rig seen through the layer of faults, without any."""
    backend, output = simulated(folder)
    return FaultyBackend(backend, []), output


def card_and_serial(folder: Path) -> Made:
    """The drive through a card, frames from a serial device whose clock is 80 ppm slow."""
    device = SerialDevice(Scenario("ideal"), RATE_HZ, np.random.default_rng(1), ppm=80.0)
    port = WiredPort(device)
    reader = SerialReader("wired", 3, RATE_HZ, lambda: port)
    card = WiredCard(port, RATE_HZ)
    backend = SoundcardSerialBackend(card, reader, dict.fromkeys(device.plant.channels, 10.0), 0.2, 25.0)
    return backend, lambda: Output(card.last_v, port.played_samples)


def ni(folder: Path) -> Made:
    """An NI device, its driver played by the simulated rig."""
    names = ("continuity", "accelerometer", "drive")
    terminals = {name: f"Dev1/ai{i}" for i, name in enumerate(names)}
    bench = Bench(RATE_HZ)
    backend = NiDaqmxBackend(RATE_HZ, terminals, dict.fromkeys(names, 10.0), "Dev1/ao0", daqmx=bench.package)
    return backend, lambda: Output(bench.output_v, bench.calls)


BACKENDS: dict[str, Callable[[Path], Made]] = {
    "simulated": simulated,
    "replay": replay,
    "faultless": faultless,
    "soundcard+serial": card_and_serial,
    "nidaqmx": ni,
}


@pytest.fixture(params=[*sorted(BACKENDS), "soundcard", "soundcard+serial by drivers"])
def made(request: pytest.FixtureRequest, tmp_path: Path) -> Made:
    """Each back end in turn, not started; the last two through the real drivers, with the plant in another process."""
    if request.param in BACKENDS:
        return BACKENDS[request.param](tmp_path)
    if request.param == "soundcard":
        backend = open_backend(request.getfixturevalue("virtual_card"))
    else:
        backend = open_backend(request.getfixturevalue("virtual_both")[0])
    tap = request.getfixturevalue("card_tap")

    def output() -> Output:
        """The last sample played, and how many were not zero."""
        return Output(float(tap.played[-1][1][-1]), sum(np.count_nonzero(out) for _, out, *_ in tap.played))

    return backend, output


@pytest.fixture
def backend(made: Made) -> Backend:
    """The back end alone."""
    return made[0]


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
    """Blocks of any size come back whole, none for none; NaN, infinity and a wrong shape are refused in between."""
    expected = 0
    with running(backend):
        for n in (1, 7, 0, 1024, 200, 3):
            block = backend.exchange(drive(n, expected))
            assert isinstance(block, Block)
            assert block.codes.dtype == np.int16 and block.codes.shape == (n, len(backend.channels))
            assert block.first_sample == expected and block.lost_before == 0
            expected += n
            for bad in (np.array([np.nan]), np.array([np.inf, 0.0]), np.zeros((3, 2))):
                with pytest.raises(ValueError, match="finite"):
                    backend.exchange(bad)


def test_stop_leaves_zero_volts_and_a_second_stop_does_nothing(made: Made) -> None:
    """Stop may come before start and twice: the drive is at 0 V after the first, and the second reaches no device."""
    backend, output = made
    backend.stop()
    backend.start()
    for k in range(4):
        backend.exchange(drive(2500, 2500 * k))
    assert output().activity > 0
    assert output().drive_v != 0.0 or backend.name not in ("simulated", "nidaqmx")  # others are heard later, or never
    backend.stop()
    stopped = output()
    assert stopped.drive_v == 0.0
    backend.stop()
    assert output() == stopped
    with pytest.raises(BackendError, match="not started"):
        backend.exchange(np.zeros(5))


def test_starts_over(backend: Backend) -> None:
    """A second start begins again at sample 0, with the same frames for the same drive where it is no real device.

    Before the first, and after each stop, an exchange is refused instead of invented.
    """
    runs = []
    for _ in range(2):
        with pytest.raises(BackendError):
            backend.exchange(np.zeros(10))
        with running(backend):
            first = backend.exchange(drive(2000))
            assert first.first_sample == 0
            runs.append(first.codes)
    with pytest.raises(BackendError):
        backend.exchange(np.zeros(10))
    if backend.simulated:
        assert np.array_equal(*runs)


def test_block_size_does_not_show(backend: Backend) -> None:
    """The same drive in other blocks gives the same frames, where it is no real device."""
    if not backend.simulated:
        pytest.skip("a real device does not repeat itself")
    whole = drive(6000)
    with running(backend):
        one = backend.exchange(whole).codes
    with running(backend):
        many = np.concatenate([backend.exchange(piece).codes for piece in np.split(whole, [10, 77, 1900, 5999])])
    assert np.array_equal(one, many)


def test_replay_plays_what_was_recorded_and_ends(tmp_path: Path) -> None:
    """A replay returns the recording's codes and fails, instead of going on, where the recording ends."""
    backend, _ = replay(tmp_path)
    with running(backend):
        backend.exchange(np.zeros(59_000))
        with pytest.raises(BackendError, match="ends after 60000 samples"):
            backend.exchange(np.zeros(1001))


def test_pacing_changes_no_sample() -> None:
    """The simulated rig in real time gives the frames it gives at full speed, and not before they are due."""
    frames = []
    for real_time in (False, True):
        backend = SimulatedBackend(RATE_HZ, Scenario("ideal"), 5, real_time=real_time)
        began_ns = time.monotonic_ns()
        with running(backend):
            blocks = [backend.exchange(drive(500, 500 * i)) for i in range(4)]
        frames.append(np.concatenate([block.codes for block in blocks]))
    assert np.array_equal(*frames)
    assert blocks[-1].clock_ns - began_ns >= 0.1e9
