"""PortAudio, as far as it is used here: which cards there are, and one stream on one of them.

What PortAudio refuses becomes a `BackendError` that names the card and lists the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import BlockFlag
from rig.backends.base import BackendError

Samples = NDArray[np.float32]
Exchange = Callable[[Samples | None, Samples, int | None], None]

JACK = "JACK Audio Connection Kit"


@dataclass(frozen=True)
class Card:
    """One device as the driver lists it."""

    name: str
    driver: str
    inputs: int
    outputs: int
    rate_hz: float


class CardStream:
    """A running stream, and what counts its frames."""

    def __init__(self, stream: Any, counter: FrameCounter | None) -> None:
        self._stream, self._counter = stream, counter

    @property
    def active(self) -> bool:
        """Whether the driver still calls."""
        return bool(self._stream.active)

    def close(self, *, alive: bool) -> None:
        """Let the card go, and PortAudio with it.

        A driver that went away is left as it is, at exit too: PortAudio would wait for it for ever, or abort the
        program. It may go away any time, so it is asked again before each step.
        """
        counter = self._counter
        steps: list[Callable[[], object]] = [
            lambda: self._stream.abort(ignore_errors=True),
            lambda: self._stream.close(ignore_errors=True),
            _release if counter is None else counter.close,
            _release,
        ]
        for step in steps:
            if not alive or (counter is not None and counter.gone):
                import sounddevice

                sounddevice._initialized = 0  # so that it is not ended
                if counter is not None:
                    counter.leave()
                return
            step()


class FrameCounter:
    """The JACK server's count of frames at the start of its present period.

    JACK leaves out the callbacks of a client that is late, and PortAudio does not say how many.
    """

    def __init__(self) -> None:
        import jack

        self.gone = False
        jack.set_error_function(lambda text: None)  # what it says is said by exceptions
        try:
            self._client = jack.Client("shakerbench-clock", no_start_server=True)
            self._client.set_shutdown_callback(self._shut_down)
            self._client.activate()
        except jack.JackError as error:
            raise BackendError(f"the JACK server does not answer ({error})") from error

    def _shut_down(self, status: object, reason: str) -> None:
        """The server went away."""
        self.gone = True

    def __call__(self) -> int:
        return int(self._client.last_frame_time)

    def close(self) -> None:
        """Let the server go."""
        self._client.close()

    def leave(self) -> None:
        """Forget a server that died: to close what it left would wait for ever."""
        self._client._ptr = None


def cards() -> list[Card]:
    """Every card that is there now; raises `BackendError` where PortAudio is not installed."""
    sounddevice = _scan()
    drivers = [api["name"] for api in sounddevice.query_hostapis()]
    listed = [
        Card(
            name=device["name"],
            driver=drivers[device["hostapi"]],
            inputs=device["max_input_channels"],
            outputs=device["max_output_channels"],
            rate_hz=device["default_samplerate"],
        )
        for device in sounddevice.query_devices()
    ]
    _release()
    return listed


def open_stream(
    device: str, rate_hz: float, output: int, n_inputs: int, exchange: Exchange, woke: Callable[[int], None]
) -> CardStream:
    """A running stream on ``device``: full duplex, or output only where ``n_inputs`` is 0.

    Raises `BackendError` when there is no such card, or it refuses.

    Parameters
    ----------
    device
        A card's name, or words of it that fit only one card.
    rate_hz
        Frames a second.
    output
        The output that plays, from 1; those before it stay silent.
    exchange
        Called in the driver's thread: heard (n, n_inputs) or None, array (n,) to fill, the driver's count of frames
        where it skips callbacks when it is late.
    woke
        Called after it, with `BlockFlag` bits that the driver claims.
    """
    sounddevice = _scan()
    count: FrameCounter | None = None
    try:
        driver = sounddevice.query_hostapis(sounddevice.query_devices(device, "output")["hostapi"])["name"]
        count = _counter(driver)

        def duplex(heard: Samples | None, out: Samples, frames: int, times: Any, status: Any) -> None:
            exchange(heard, out[:, output - 1], count() if count is not None else None)
            woke(_flags(status) if status else 0)

        def simplex(out: Samples, frames: int, times: Any, status: Any) -> None:
            duplex(None, out, frames, times, status)

        options = {"samplerate": rate_hz, "dtype": "float32", "latency": "low", "blocksize": 0}
        if n_inputs:
            stream = sounddevice.Stream(
                device=(device, device), channels=(n_inputs, output), callback=duplex, **options
            )
        else:
            stream = sounddevice.OutputStream(device=device, channels=output, callback=simplex, **options)
        stream.start()
    except (sounddevice.PortAudioError, ValueError) as error:
        if count is not None:
            count.close()
        there = ", ".join(repr(card.name) for card in cards()) or "none"
        raise BackendError(
            f"sound card {device!r}: cannot be opened at {rate_hz:g} Hz with {n_inputs} inputs and {output} outputs "
            f"({error}); cards that are there: {there}"
        ) from error
    return CardStream(stream, count)


def _flags(status: Any) -> int:
    """The driver's claims as `BlockFlag` bits."""
    over = BlockFlag.OVERFLOW if status.input_overflow else 0
    under = BlockFlag.UNDERFLOW if status.output_underflow else 0
    return int(over) | int(under)


def _counter(driver: str) -> FrameCounter | None:
    """What counts the frames of a driver that leaves callbacks out; None where none is needed, or cannot be had."""
    if driver != JACK:
        return None
    try:
        return FrameCounter()
    except (ImportError, OSError) as error:
        raise BackendError(
            f"JACK leaves out callbacks, and what counts them is missing ({error}): pip install JACK-Client"
        ) from error


def _scan() -> Any:
    """`sounddevice` with a fresh list: PortAudio looks for cards only when it begins."""
    try:
        import sounddevice
    except OSError as error:
        raise BackendError(f"PortAudio is not installed ({error}); on Debian: apt-get install libportaudio2") from error
    try:
        _release()
        sounddevice._initialize()
    except sounddevice.PortAudioError as error:
        raise BackendError(f"PortAudio does not start ({error})") from error
    return sounddevice


def _release() -> None:
    """End PortAudio."""
    import sounddevice

    while sounddevice._initialized:
        sounddevice._terminate()
