"""The simulated plant behind real drivers, in a process of its own: as a JACK client, or as a serial device.

As a JACK client the plant has one input (the drive) and three outputs (continuity, accelerometer, looped-back drive).
Its time is the server's: a period that the server skipped is a period the plant went through without a drive, and its
frames are lost.

As a serial device it samples by its own clock and sends serial frames through a pseudo-terminal, as a microcontroller
would; the drive, which it knows as a voltage in time and nothing else, comes by JACK. What it converts at its own
instants lies between the samples that were played; a cubic through the four around an instant gives it to a few parts
in a million. POSIX only has pseudo-terminals: elsewhere this is refused.
"""

from __future__ import annotations

import functools
import gc
import os
import queue
import select
import shutil
import subprocess
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from daq.clocks.serial_frames import SerialFrame, encode_frame
from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.kinds.soundcard import card_options
from rig.backends.kinds.soundcard_serial import SoundcardSerialOptions
from rig.execution.priority import may_run_first
from rig.profile import Profile
from rig.programme.ramp import HighPass
from rig.sim.plant import REFRESH_SAMPLES, Plant
from rig.sim.scenario import Scenario

PRIORITY = 40  # of the server, where it may have one


class PlantClient:
    """A client of a JACK server that takes the drive, period by period, the server's skipped frames included.

    The profile's ``[backend]`` gives the client's name and the full scale of the output. Through ``skipped_frames`` the
    plant went without a drive; ``alive``: the server is there. Raises `InputError` when the profile's back end is no
    sound card, or there is no such server, or it runs at another rate.
    """

    def __init__(self, profile: Profile, server: str) -> None:
        self._card = card_options(profile.backend)
        self._client = _client(self._card.device, server)
        own_hz, rate_hz = self._client.samplerate, profile.sampling.rate_hz
        if own_hz != rate_hz:
            self._client.close()
            raise InputError(
                f"JACK server {server!r} runs at {own_hz} Hz, sampling.rate_hz is {rate_hz:g}: start it at that rate"
            )
        self._amplifier = self._client.inports.register("amplifier")
        self._frame: int | None = None
        self.skipped_frames = 0
        self.alive = True
        self._client.set_process_callback(self._process)
        self._client.set_shutdown_callback(self._shut_down)

    def _shut_down(self, status: Any, reason: str) -> None:
        """Called when the server went away."""
        self.alive = False

    def _process(self, frames: int) -> None:
        """Called for each period."""
        now = self._client.last_frame_time
        skipped = 0 if self._frame is None else (now - self._frame) % 2**32
        if 0 < skipped < 2**31:
            self.skipped_frames += skipped
            self._move(np.zeros(skipped), None)
        self._frame = (now + frames) % 2**32
        self._move(np.asarray(self._amplifier.get_array(), np.float64) * self._card.output_range_v, now)

    def _move(self, drive_v: Floats, frame: int | None) -> None:
        """Move the plant through a period that began at the server's ``frame``; None: through frames it skipped."""
        raise NotImplementedError


class JackPlant(PlantClient):
    """A plant behind the ports of the client ``profile.backend.device``.

    The profile's ``[channels]`` give the full scale of the inputs. All that the plant gave is written to ``log`` at the
    end, where there is one, as NPZ: the server's ``frame`` of each period's first, and the ``codes``. Raises
    `InputError` as `PlantClient`.
    """

    def __init__(self, profile: Profile, scenario: Scenario, seed: int, server: str, log: Path | None) -> None:
        rng = np.random.default_rng(seed)
        made = functools.partial(Plant, scenario, profile.sampling.rate_hz, further=profile.channels.recorded())
        made(rng.spawn(1)[0]).exchange(np.zeros(64))  # compiled before it counts
        self._plant = made(rng)
        self._log = log
        self._given: list[tuple[int, NDArray[np.int16]]] = []
        super().__init__(profile, server)
        ports = {number: name for name, number in self._card.inputs.wired(profile.channels).items()}
        self._names = [ports.get(number, "") for number in range(1, max(ports) + 1)]
        self._outs = [self._client.outports.register(name or f"unused_{k}") for k, name in enumerate(self._names)]
        self._output = HighPass(profile.drive.highpass_hz, self._plant.rate_hz)
        # the virtual card's AC-coupled inputs pass nothing below 5 Hz
        self._inputs: dict[str, tuple[HighPass, float]] = {}  # high-pass of each channel, and volts to full scale
        for name in self._plant.channels:
            channel = getattr(profile.channels, name)
            corner_hz = 5.0 if channel is not None and channel.coupling == "ac" else None
            scale = 0.0 if channel is None else self._plant.channel_scales[name] / channel.range_v
            self._inputs[name] = HighPass(corner_hz, self._plant.rate_hz), scale

    def _move(self, drive_v: Floats, frame: int | None) -> None:
        codes = self._plant.exchange(self._output(drive_v))
        heard = {}
        for k, name in enumerate(self._plant.channels):
            high_pass, scale = self._inputs[name]
            heard[name] = high_pass(np.asarray(codes[:, k] * scale, np.float64))
        if frame is not None:
            for port, name in zip(self._outs, self._names, strict=True):
                port.get_array()[:] = heard.get(name, 0.0)
            if self._log is not None:
                self._given.append((frame, codes))

    def __enter__(self) -> Self:
        gc.collect()
        gc.freeze()  # what is there now is not looked through again while the server waits
        self._client.activate()
        return self

    def __exit__(self, *exc: object) -> None:
        self._client.deactivate()
        self._client.close()
        if self._log is not None:
            np.savez(
                self._log, frame=np.array([at for at, _ in self._given]), codes=np.array([x for _, x in self._given])
            )


@contextmanager
def jack_server(name: str, rate_hz: float, period: int) -> Iterator[bool]:
    """The JACK server ``name`` with the dummy driver for as long as the block runs; gives whether it was started here.

    A server of that name that is there already is used, and left running.

    Raises `InputError` when there is none and none can be started, or the package JACK-Client is missing.
    """
    _jack()
    if _answers(name):
        yield False
        return
    jackd = shutil.which("jackd")
    if jackd is None:
        raise InputError("jackd: not installed; on Debian: apt-get install jackd2")
    process = _started(jackd, name, rate_hz, period)
    try:
        yield True
    finally:
        process.terminate()
        process.wait(10.0)


def _started(jackd: str, name: str, rate_hz: float, period: int) -> subprocess.Popen[bytes]:
    """A server that answers: before all other work where that is allowed and works; raises `InputError`."""
    command: list[str] = []
    for mode in [["-R", "-P", str(PRIORITY)], ["-r"]] if may_run_first(PRIORITY) else [["-r"]]:
        command = [jackd, *mode, "-n", name, "-d", "dummy", "-r", f"{rate_hz:.0f}", "-p", str(period)]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until = time.monotonic() + 10.0
        while process.poll() is None and time.monotonic() < until:
            if _answers(name):
                return process
            time.sleep(0.1)
        process.kill()
        process.wait()
    raise InputError(
        f"JACK server {name!r} does not start: try  {' '.join(command)}  (servers that were killed keep their places: "
        "with none running, remove /dev/shm/jack*)"
    )


def _answers(server: str) -> bool:
    """Whether a server of that name is there."""
    try:
        _client("probe", server).close()
    except InputError:
        return False
    return True


def _jack() -> Any:
    """The package JACK-Client; raises `InputError` where it, or the library that it calls, is missing."""
    try:
        import jack
    except (ImportError, OSError) as error:
        raise InputError(
            f"JACK is not installed ({error}); on Debian: apt-get install jackd2, then pip install 'shakerbench[jack]'"
        ) from error
    return jack


def _client(name: str, server: str) -> Any:
    """A client of the server; raises `InputError`."""
    jack = _jack()
    jack.set_error_function(lambda text: None)
    jack.set_info_function(lambda text: None)
    try:
        return jack.Client(name, no_start_server=True, servername=server, use_exact_name=True)
    except jack.JackError as error:
        raise InputError(f"JACK server {server!r} does not answer as {name!r} ({error})") from error


ROWS = 64  # in a frame


class SerialDevice:
    """A plant behind a converter with a quartz of its own, which replaces the scenario's clock error.

    An interval of the device is too long by ``ppm`` at the start, and gains ``ppm_per_minute``; the rate is nominal.
    The rest is as for `rig.sim.plant.Plant`.
    """

    def __init__(
        self,
        scenario: Scenario,
        rate_hz: float,
        rng: np.random.Generator,
        *,
        ppm: float = 0.0,
        ppm_per_minute: float = 0.0,
        further: Collection[str] = (),
    ) -> None:
        drift = dict(scenario.drift_per_minute)
        if ppm_per_minute:
            drift["clock_error.relative"] = ppm_per_minute * 1e-6
        effects = dict(scenario.effects) | {"clock_error": {"relative": ppm * 1e-6}}
        scenario = replace(scenario, effects=effects, drift_per_minute=drift)
        self.plant = Plant(scenario, rate_hz, rng, further=further)
        self._ppm, self._ppm_per_s = ppm, ppm_per_minute / 60.0
        self._rate_hz = rate_hz
        self._drive = np.zeros(2)  # from two samples before the first
        self._first = -2
        self._time_s = 0.0
        self._codes = np.zeros((0, len(self.plant.channels)), np.int16)
        self._sent = self._sequence = 0

    def play(self, drive_v: Floats) -> bytes:
        """Take in drive samples; gives back the bytes that the device sends meanwhile."""
        self._drive = np.concatenate([self._drive, drive_v])
        while self._convert():
            pass
        wire = b""
        while len(self._codes) >= ROWS:
            frame = SerialFrame(self._sequence, self._sent, 0, self._codes[:ROWS])
            wire += encode_frame(frame)
            self._codes = self._codes[ROWS:]
            self._sent, self._sequence = self._sent + ROWS, (self._sequence + 1) % 2**32
        return wire

    def _convert(self) -> bool:
        """The next conversions, as many as the plant takes with one clock error; False when the drive ends first."""
        interval_s = (1.0 + 1e-6 * (self._ppm + self._ppm_per_s * self._time_s)) / self._rate_hz
        step: Floats = np.arange(REFRESH_SAMPLES, dtype=np.float64)
        place: Floats = (self._time_s + interval_s * step) * self._rate_hz - self._first
        if int(place[-1]) + 2 >= len(self._drive):
            return False
        self._codes = np.concatenate([self._codes, self.plant.exchange(_between(self._drive, place))])
        self._time_s += interval_s * REFRESH_SAMPLES
        done = int(place[-1]) - 2
        self._drive, self._first = self._drive[done:], self._first + done
        return True


def _between(samples: Floats, place: Floats) -> Floats:
    """Values at places between samples: the cubic through the four nearest (Lagrange)."""
    k = place.astype(np.int64)
    u = place - k
    before, here, after, beyond = (samples[k + i] for i in (-1, 0, 1, 2))
    return np.asarray(
        -u * (u - 1.0) * (u - 2.0) / 6.0 * before
        + (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0 * here
        - (u + 1.0) * u * (u - 2.0) / 2.0 * after
        + (u + 1.0) * u * (u - 1.0) / 6.0 * beyond
    )


HELD_PERIODS = 4  # of frames that the device holds for a reader that is late


class JackSerialPlant(PlantClient):
    """A plant that hears the client ``profile.backend.device`` and sends its frames to a pseudo-terminal.

    Arguments are as of `rig.virtual.JackPlant` and `rig.virtual.SerialDevice`. ``port`` is the terminal's
    name; ``profile.backend.port`` is a link to it while the block runs. Raises `InputError` when there is no such
    server, it runs at another rate, or the system has no pseudo-terminals.
    """

    def __init__(
        self, profile: Profile, scenario: Scenario, seed: int, server: str, *, ppm: float, ppm_per_minute: float
    ) -> None:
        if not hasattr(os, "openpty"):
            raise InputError("a virtual serial device needs pseudo-terminals, which this system does not have")
        rate_hz = profile.sampling.rate_hz
        rng = np.random.default_rng(seed)
        further = profile.channels.recorded()
        warm = SerialDevice(scenario, rate_hz, rng.spawn(1)[0], further=further)
        warm.play(np.zeros(256))  # compiled before it counts
        self.device = SerialDevice(scenario, rate_hz, rng, ppm=ppm, ppm_per_minute=ppm_per_minute, further=further)
        if not isinstance(profile.backend, SoundcardSerialOptions):
            raise InputError(f"backend.kind is {profile.backend.kind}; wanted soundcard+serial")
        self._link = Path(profile.backend.port)
        if self._link.exists() or self._link.is_symlink():
            raise InputError(f"backend.port = {str(self._link)!r} is there already; name a path that is not")
        super().__init__(profile, server)
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        # bytes as they are: no echo, no line ends. The module is POSIX's
        import tty

        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._periods: queue.SimpleQueue[Floats | None] = queue.SimpleQueue()
        self._sender = threading.Thread(target=self._send, name="virtual serial", daemon=True)

    def _move(self, drive_v: Floats, frame: int | None) -> None:
        self._periods.put(drive_v)  # the device runs in a thread of its own

    def _send(self) -> None:
        """The device: every period in, bytes out; what is not read for some periods is lost, as on a cable."""
        while (drive_v := self._periods.get()) is not None:
            wire = self.device.play(drive_v)
            while wire and self._periods.qsize() < HELD_PERIODS:
                if select.select([], [self._master], [], 0.01)[1]:
                    wire = wire[os.write(self._master, wire) :]

    def __enter__(self) -> Self:
        self._link.symlink_to(self.port)
        self._sender.start()
        self._client.activate()
        return self

    def __exit__(self, *exc: object) -> None:
        self._link.unlink(missing_ok=True)
        self._client.deactivate()
        self._client.close()
        for _ in range(HELD_PERIODS):
            self._periods.put(None)
        self._sender.join(5.0)
        os.close(self._master)
        os.close(self._slave)
