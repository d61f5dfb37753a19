"""The plant as a JACK client: one input (the drive), three outputs (continuity, accelerometer, looped-back drive).

The plant's time is the server's: a period that the server skipped is a period the plant went
through without a drive, and its frames are lost.
"""

from __future__ import annotations

import functools
import gc
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.kinds.soundcard import card_options
from rig.execution.priority import may_run_first
from rig.profile import Profile
from rig.programme.high_pass import HighPass
from rig.sim.plant import Plant
from rig.sim.scenario import Scenario

PRIORITY = 40  # of the server, where it may have one


class PlantLog:
    """All that the plant gave, period by period, written as NPZ (``frame``: the server's frame of each period's first,
    ``codes``) on exit; nothing where ``path`` is None.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._frames: list[int] = []
        self._codes: list[NDArray[np.int16]] = []

    def keep(self, frame: int, codes: NDArray[np.int16]) -> None:
        """One period."""
        if self._path is not None:
            self._frames.append(frame)
            self._codes.append(codes)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        if self._path is not None:
            np.savez(self._path, frame=np.array(self._frames), codes=np.array(self._codes))


class PlantClient:
    """A client of a JACK server that takes the drive, period by period, the server's skipped frames included.

    Raises `InputError` when the profile's back end is no sound card, or there is no such server, or it runs at another
    rate.

    The profile's ``[backend]`` gives the client's name and the full scale of the output.

    Attributes
    ----------
    skipped_frames : int
        Frames that the server skipped: the plant went through them without a drive.
    alive : bool
        Whether the server is there.
    """

    def __init__(self, profile: Profile, server: str) -> None:
        self._card = card_options(profile.backend)
        self._client = jack_client(self._card.device, server, profile.sampling.rate_hz)
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

    Raises `InputError` when there is no such server, or it runs at another rate.

    Parameters
    ----------
    profile
        Its ``[backend]`` gives the client's name and the full scale of the output, ``[channels]`` those of the inputs.
    scenario, seed
        As for the simulated rig.
    server
        Name of the JACK server.
    log
        Record of all that the plant gave.
    """

    def __init__(self, profile: Profile, scenario: Scenario, seed: int, server: str, log: PlantLog) -> None:
        rng = np.random.default_rng(seed)
        made = functools.partial(Plant, scenario, profile.sampling.rate_hz, further=profile.channels.recorded())
        made(rng.spawn(1)[0]).exchange(np.zeros(64))  # compiled before it counts
        self._plant = made(rng)
        self._profile, self._log = profile, log
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
            self._log.keep(frame, codes)

    def __enter__(self) -> Self:
        gc.collect()
        gc.freeze()  # what is there now is not looked through again while the server waits
        self._client.activate()
        return self

    def __exit__(self, *exc: object) -> None:
        self._client.deactivate()
        self._client.close()


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


def jack_client(name: str, server: str, rate_hz: float) -> Any:
    """A client of the server, which must run at ``rate_hz``; raises `InputError`."""
    client = _client(name, server)
    if client.samplerate != rate_hz:
        own_hz = client.samplerate
        client.close()
        raise InputError(
            f"JACK server {server!r} runs at {own_hz} Hz, sampling.rate_hz is {rate_hz:g}: start it at that rate"
        )
    return client


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
