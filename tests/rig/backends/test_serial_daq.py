"""The serial DAQ beside a card: its reader alone, both together, and against a device in a process of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bench.profiles.find import load
from daq.clocks.serial_frames import SerialFrame, encode_frame
from daq.files.tables import Block, BlockFlag, volts_per_code
from daq.recording import open_recording, verify
from daq.recording.writer import RecordingWriter
from rig.backends.base import BackendError, TwoClocked, open_port, running
from rig.backends.serial_daq import SerialReader, SoundcardSerialBackend
from rig.execution.run import run_ramp
from rig.profile import Profile, parse_profile
from rig.sim.scenario import Scenario
from rig.virtual import SerialDevice
from tests.fakes.played_time import played_s
from tests.fakes.serial_loopback import WiredCard, WiredPort

RATE = 20000.0
CHANNELS = ("continuity", "accelerometer", "drive")


class Tape:
    """A port that plays bytes, then is silent or gone."""

    def __init__(self, data: bytes, *, gone: bool = False) -> None:
        self._data, self._gone = data, gone
        self.closed = False

    @property
    def in_waiting(self) -> int:
        return len(self._data)

    def read(self, size: int) -> bytes:
        if not self._data:
            if self._gone:
                raise OSError("unplugged")
            time.sleep(0.01)
        data, self._data = self._data[:size], self._data[size:]
        return data

    def reset_input_buffer(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True


def packets(n: int, rows: int = 10) -> list[bytes]:
    """Frames whose codes say which sample they are."""
    codes = np.arange(n * rows, dtype=np.int16)[:, None].repeat(3, 1)
    return [encode_frame(SerialFrame(i, i * rows, 0, codes[i * rows : (i + 1) * rows])) for i in range(n)]


def reader_of(tape: Tape) -> SerialReader:
    """A reader of a tape."""
    return SerialReader("tape", 3, RATE, lambda: tape)


def test_rows_come_by_counter_whatever_the_frames() -> None:
    """Pieces of any size are the device's rows in order, and what is not there yet is waited for."""
    reader = reader_of(Tape(b"".join(packets(20))))
    reader.start()
    got = [reader.take(until) for until in (3, 3, 47, 200)]
    reader.stop()
    assert [(first, len(codes), lost) for first, codes, lost in got] == [(0, 3, 0), (3, 0, 0), (3, 44, 0), (47, 153, 0)]
    assert np.array_equal(np.concatenate([codes for _, codes, _ in got])[:, 0], np.arange(200))


def test_lost_rows_end_a_piece_and_are_declared_with_the_next() -> None:
    """A hole splits what is taken; the count of what is missing comes with the first rows after it."""
    sent = packets(20)
    reader = reader_of(Tape(b"".join(sent[:5] + sent[8:])))
    reader.start()
    got = [reader.take(until) for until in (60, 70, 90, 200)]
    reader.stop()
    pieces = [(first, len(codes), lost) for first, codes, lost in got]
    assert pieces == [(0, 50, 0), (50, 0, 0), (80, 10, 30), (90, 110, 0)]


@pytest.mark.parametrize(
    ("tape", "said"),
    [
        (Tape(b"".join(packets(3)), gone=True), "tape: went away .unplugged.; check its cable"),
        (Tape(b"".join(packets(3))), "no good frame for 0.5 s; is the device running"),
        (Tape(b"".join(packets(3) * 9)), "its counters do not go on .24 stale frames.: did the device start anew"),
        (Tape(b"".join(packets(3)) + b"\x05\x07\0" * 9), "9 damaged packets: is the baud rate right"),
    ],
    ids=["gone", "silent", "started anew", "garbled"],
)
def test_what_keeps_samples_from_coming_is_named(tape: Tape, said: str) -> None:
    """Unplugged, silent, restarted and garbled devices each end in an error with the port's name and the remedy."""
    reader = reader_of(tape)
    reader.start()
    with pytest.raises(BackendError, match=said):
        reader.take(1000)
    reader.stop()
    assert tape.closed


def test_a_port_that_is_not_there_is_named() -> None:
    """A wrong name in the profile: the error says which, and what lists the right ones."""
    with pytest.raises(BackendError, match=r"/dev/not-there: cannot be opened .* bench devices"):
        open_port("/dev/not-there", 115200, 0.05, whose="serial DAQ", key="backend.port")


def wired(device: SerialDevice, marker_v: float = 0.2) -> tuple[SoundcardSerialBackend, WiredCard, WiredPort]:
    """The back end over a device in this process."""
    port = WiredPort(device)
    card = WiredCard(port, RATE)
    reader = SerialReader("wired", 3, RATE, lambda: port)
    return SoundcardSerialBackend(card, reader, dict.fromkeys(CHANNELS, 10.0), marker_v, 25.0), card, port


def device(ppm: float = 80.0, ppm_per_minute: float = 2.0) -> SerialDevice:
    """The ideal rig on its own clock."""
    return SerialDevice(Scenario("ideal"), RATE, np.random.default_rng(1), ppm=ppm, ppm_per_minute=ppm_per_minute)


def short(steps: int = 3) -> tuple[Profile, str]:
    """A short ramp of the simulated profile."""
    _, text = load("simulated")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", f"start = 0.8, stop = 1.2, steps = {steps}")
    return parse_profile(text), text


def record(backend: SoundcardSerialBackend, path: Path, steps: int = 3):
    """Run the short ramp into ``path``."""
    profile, text = short(steps)
    writer = RecordingWriter(
        path, profile.setup(), profile_text=text, channels=backend.channels, backend=backend.name, simulated=False,
        scales=backend.scales,
    )  # fmt: skip
    return run_ramp(profile, backend, writer)


def test_a_run_is_on_one_time_base(tmp_path: Path) -> None:
    """Frames raw, counters and map stored; by the map the looped-back drive is where it was played, to 0.1 samples."""
    backend, _, _ = wired(device())
    assert isinstance(backend, TwoClocked)
    summary = record(backend, tmp_path / "run.h5")
    assert (summary.how, summary.lost_samples, summary.steps_driven) == ("complete", 0, 3)
    assert verify(tmp_path / "run.h5").state == "complete"
    with open_recording(tmp_path / "run.h5") as recording:
        heard, rows, readings = recording.read_v("drive"), recording.clock_map, recording.clock_readings
        steps, gaps, changes = recording.steps, recording.gaps, recording.drive_changes
    assert len(rows) == 3 and len(readings) > 40
    assert np.all(np.abs(rows["rate"] - 80.5e-6) < 3.0 * rows["rate_uncertainty"] + 0.5e-6)
    np.testing.assert_allclose(steps["frequency_hz"], 25.37 * (1.0 + rows["rate"]), rtol=1e-9)
    for step, change in zip(steps[1:], changes[1:], strict=False):
        first, last = (int(step[name]) for name in ("settle_samples", "n_samples"))
        index = int(step["first_sample"]) + np.arange(first, last)
        place = played_s(index / RATE, rows, gaps, RATE)
        tone = np.exp(-2j * np.pi * 25.37 * place)
        design = np.column_stack([tone.real, tone.imag, np.ones(index.size)])
        re, im, _ = np.linalg.lstsq(design, heard[index], rcond=None)[0]
        off = np.angle(complex(re, im) / complex(change["end_re_v"], change["end_im_v"])) / (2 * np.pi * 25.37)
        assert abs(off) * RATE < 0.1
        place_of_first = np.interp(step["first_sample"], rows["recorded_sample"], rows["played_sample"])
        assert abs(place_of_first - round(place_of_first)) < 1.0


def test_the_closed_loop_runs_on_frames_of_another_clock(tmp_path: Path) -> None:
    """Gamma of two tones, their phase included, reaches its target though frames come late and by another clock."""
    _, text = load("simulated")
    for old, new in (
        ("start = 0.4, stop = 2.6, steps = 23", "start = 0.2, stop = 0.4, steps = 2"),
        ("ratio = 1 ", "ratio = 3 "),
        ("value = 2.0, uncertainty = 0.01", "value = 1.8, uncertainty = 0.01"),
        ("phase_deg = { value = 0.0", "phase_deg = { value = 8.0"),
        ("# [control]", "[control]"),
    ):
        assert old in text
        text = text.replace(old, new)
    profile = parse_profile(text)
    backend, _, _ = wired(device())
    writer = RecordingWriter(
        tmp_path / "run.h5", profile.setup(), profile_text=text, channels=backend.channels, backend=backend.name,
        simulated=False, scales=backend.scales,
    )  # fmt: skip
    summary = run_ramp(profile, backend, writer)
    assert (summary.how, summary.why) == ("complete", "")
    with open_recording(tmp_path / "run.h5") as recording:
        steps = recording.steps
    np.testing.assert_allclose(steps["achieved_gamma"], steps["gamma"], rtol=0.006)


def test_lost_frames_are_declared_and_the_run_goes_on(tmp_path: Path) -> None:
    """A cable that swallows a few hundred bytes: a gap of as many samples, steps still where they were played."""
    backend, _, port = wired(device(ppm=0.0, ppm_per_minute=0.0))
    played = port.play
    calls = iter(range(10**6))

    def torn(drive_v: np.ndarray) -> None:
        before = len(port._bytes)
        played(drive_v)
        if next(calls) == 200:
            del port._bytes[before : before + 300]

    port.play = torn
    summary = record(backend, tmp_path / "run.h5")
    assert summary.how == "complete" and summary.lost_samples in (64, 128)
    report = verify(tmp_path / "run.h5")
    assert report.lost_samples == summary.lost_samples and not report.suspect
    with open_recording(tmp_path / "run.h5") as recording:
        assert len(recording.gaps) == 1
        heard, steps = recording.read_v("drive"), recording.steps
    for step in steps:  # whatever was lost before it, a step's hold has one amplitude
        a, n = int(step["first_sample"] + step["settle_samples"]), int(step["n_samples"] - step["settle_samples"])
        pieces = np.array_split(heard[a : a + n], 5)
        assert np.ptp([np.abs(piece).max() for piece in pieces]) < 0.01 * step["gamma"]


def test_a_card_that_skips_is_written_down() -> None:
    """Frames that the card never played cost no sample of the device, and the block says that the drive was late."""
    backend, card, _ = wired(device())
    with running(backend):
        assert backend.exchange(np.zeros(400)).flags == 0
        exchange = card.exchange
        card.exchange = lambda drive_v: Block(0, exchange(drive_v).codes[:100])
        block = backend.exchange(np.zeros(400))
        assert (block.flags, len(block.codes), block.lost_before) == (BlockFlag.UNDERFLOW, 400, 0)


def test_a_drive_that_is_not_looped_back_is_refused() -> None:
    """No marker in the device's drive channel: the start fails, says so, and leaves everything closed at 0 V."""
    backend, card, _ = wired(device(), marker_v=1e-6)
    with pytest.raises(BackendError, match=r"does not record the start marker .* is the drive looped back into it"):
        backend.start()
    assert card.last_v == 0.0
    with pytest.raises(BackendError, match="not started"):
        backend.exchange(np.zeros(10))


def test_a_device_at_another_rate_is_refused_by_its_rate() -> None:
    """A device whose timer runs at half the rate: the start says what it sends, not that its loop-back is missing."""
    half = device(ppm=0.0, ppm_per_minute=0.0)
    play = half.play
    half.play = lambda drive_v: play(drive_v[::2])
    backend, _, _ = wired(half)
    with pytest.raises(BackendError, match=r"sends about (99\d\d|10\d\d\d) rows a second, sampling.rate_hz is 20000"):
        backend.start()


def test_unplugged_in_mid_run_the_drive_fades_out_and_the_data_stay(tmp_path: Path) -> None:
    """Unplugged: the run fails and names the device, the drive goes to zero without a jump, the frames are kept."""
    backend, card, port = wired(device())
    volts: list[np.ndarray] = []
    exchange = card.exchange

    def watched(drive_v: np.ndarray) -> Block:
        volts.append(drive_v)
        if sum(map(len, volts)) > 3 * RATE:
            port.unplug()
        return exchange(drive_v)

    card.exchange = watched
    summary = record(backend, tmp_path / "run.h5")
    assert summary.how == "failed"
    assert "soundcard+serial: serial DAQ wired: went away (device unplugged)" in summary.why
    drive = np.concatenate(volts)
    assert drive[-1] == pytest.approx(0.0, abs=1e-6) and np.abs(drive).max() > 0.3
    assert np.abs(np.diff(drive[-8000:])).max() < 0.01
    assert verify(tmp_path / "run.h5").state == "stopped" and summary.n_samples > 30_000


class PeerCard:
    """A card that plays into a device in another process."""

    name, simulated, scenario_sha256 = "peer", False, None
    channels = ("drive",)
    rate_hz = RATE
    scales = {"drive": (volts_per_code(10.0), 0.0)}

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self.played: list[np.ndarray] = []
        self._one_at_a_time = threading.Lock()

    def start(self) -> None:
        pass

    def exchange(self, drive_v: np.ndarray) -> Block:
        self.played.append(drive_v)
        with self._one_at_a_time, contextlib.suppress(BrokenPipeError):  # a card goes on playing, into nothing
            self.process.stdin.write(struct.pack("<I", len(drive_v)) + drive_v.astype("<f8").tobytes())
            self.process.stdin.flush()
            self.process.stdout.read(1)
        return Block(0, np.zeros((len(drive_v), 1), np.int16))

    def stop(self) -> None:
        pass


@pytest.fixture
def peer() -> Iterator[tuple[PeerCard, str]]:
    """A device in a process of its own behind a pseudo-terminal, 80 ppm slow and drifting, and the way into it."""
    if not hasattr(os, "openpty"):
        pytest.skip("no pseudo-terminals on this system")
    command = [sys.executable, str(Path(__file__).with_name("serial_peer.py")), "80", "2"]
    root = Path(__file__).parents[3]
    environment = os.environ | {"PYTHONPATH": str(root)}
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root, env=environment) as process:
        name = process.stdout.readline().decode().strip()
        yield PeerCard(process), name
        process.kill()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()


def through(card: PeerCard, name: str) -> SoundcardSerialBackend:
    """The back end with the real port; the device runs before anybody listens."""

    def opener():
        port = open_port(name, 115200, 0.05, whose="serial DAQ", key="backend.port")
        threading.Timer(0.2, card.exchange, [np.zeros(2000)]).start()
        return port

    return SoundcardSerialBackend(card, SerialReader(name, 3, RATE, opener), dict.fromkeys(CHANNELS, 10.0), 0.2, 25.0)


def test_a_run_through_a_real_port(peer: tuple[PeerCard, str], tmp_path: Path) -> None:
    """pyserial, the thread and a pseudo-terminal to another process: a whole run, nothing lost, the map right."""
    summary = record(through(*peer), tmp_path / "run.h5", steps=2)
    assert (summary.how, summary.why, summary.lost_samples) == ("complete", "", 0)
    with open_recording(tmp_path / "run.h5") as recording:
        rate = recording.clock_map["rate"]
    assert len(rate) == 2 and np.all(np.abs(rate - 80.1e-6) < 1e-6)


def test_the_device_process_is_killed(peer: tuple[PeerCard, str], tmp_path: Path) -> None:
    """The peer is killed in mid-run: the run ends softly, names the port, keeps the data."""
    card, name = peer
    exchange = card.exchange

    def killing(drive_v: np.ndarray) -> Block:
        if sum(map(len, card.played)) > 2 * RATE and card.process.poll() is None:
            card.process.send_signal(signal.SIGKILL)
            card.process.wait()
        return exchange(drive_v)

    backend = through(card, name)
    card.exchange = killing
    summary = record(backend, tmp_path / "run.h5")
    assert summary.how == "failed" and f"serial DAQ {name}: went away" in summary.why
    drive = np.concatenate(card.played)
    assert drive[-1] == pytest.approx(0.0, abs=1e-6) and np.abs(np.diff(drive[-6000:])).max() < 0.01
    assert verify(tmp_path / "run.h5").state == "stopped" and summary.n_samples > 10_000


def test_started_again_it_counts_from_zero() -> None:
    """A second start joins the clocks anew: the first frame is sample 0 though the device counts on."""
    backend, _, _ = wired(device())
    places = []
    for _ in range(2):
        with running(backend):
            block = backend.exchange(np.zeros(500))
        assert (block.first_sample, len(block.codes)) == (0, 500)
        places.append(block.place)
    assert all(place is not None and place < 0 for place in places)
