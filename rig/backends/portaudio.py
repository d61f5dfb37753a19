"""PortAudio, as far as it is used here: which cards there are, and one stream on one of them.

The rule kept here: what PortAudio says no to becomes a `BackendError` that names the card and lists the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.block import BlockFlag
from rig.backends.base import BackendError

Samples = NDArray[np.float32]
Exchange = Callable[[Samples | None, Samples, float | None], None]

SKIPPING = "JACK Audio Connection Kit"
"""The driver that skips whole callbacks when it is late, and whose clock says so."""


@dataclass(frozen=True)
class Card:
    """One device as the driver lists it."""

    name: str
    driver: str
    inputs: int
    outputs: int
    rate_hz: float


def cards() -> list[Card]:
    """Every card that is there now; raises `BackendError` where PortAudio is not installed."""
    sounddevice = _scan()
    drivers = [api["name"] for api in sounddevice.query_hostapis()]
    return [
        Card(d["name"], drivers[d["hostapi"]], d["max_input_channels"], d["max_output_channels"], d["default_samplerate"])
        for d in sounddevice.query_devices()
    ]


def open_stream(
    device: str, rate_hz: float, output: int, n_inputs: int, exchange: Exchange, woke: Callable[[int], None]
) -> Any:
    """A running stream on ``device``: full duplex, or output alone where ``n_inputs`` is 0.

    Parameters
    ----------
    device
        A card's name, or words of it that fit one card alone.
    rate_hz
        Frames a second.
    output
        The output that plays, from 1; those before it stay silent.
    exchange
        Called in the driver's thread: heard (n, n_inputs) or None, array (n,) to fill, the driver's clock or None.
    woke
        Called after it, with `BlockFlag` bits that the driver claims.

    Raises
    ------
    BackendError
        When there is no such card, or it refuses.
    """
    sounddevice = _scan()

    def callback(heard: Samples | None, out: Samples, time_s: float | None, status: Any) -> None:
        exchange(heard, out[:, output - 1], time_s)
        woke(_flags(status) if status else 0)

    try:
        driver = sounddevice.query_hostapis(sounddevice.query_devices(device, "output")["hostapi"])["name"]
        skipping = driver == SKIPPING

        def duplex(heard: Samples, out: Samples, frames: int, times: Any, status: Any) -> None:
            callback(heard, out, times.currentTime if skipping else None, status)

        def simplex(out: Samples, frames: int, times: Any, status: Any) -> None:
            callback(None, out, times.currentTime if skipping else None, status)

        options = {"samplerate": rate_hz, "dtype": "float32", "latency": "low", "blocksize": 0}
        if n_inputs:
            stream = sounddevice.Stream(
                device=(device, device), channels=(n_inputs, output), callback=duplex, **options
            )
        else:
            stream = sounddevice.OutputStream(device=device, channels=output, callback=simplex, **options)
        stream.start()
    except (sounddevice.PortAudioError, ValueError) as error:
        there = ", ".join(repr(card.name) for card in cards()) or "none"
        raise BackendError(
            f"sound card {device!r}: cannot be opened at {rate_hz:g} Hz with {n_inputs} inputs and {output} outputs "
            f"({error}); cards that are there: {there}"
        ) from error
    return stream


def _flags(status: Any) -> int:
    """The driver's claims as `BlockFlag` bits."""
    over = BlockFlag.OVERFLOW if status.input_overflow else 0
    under = BlockFlag.UNDERFLOW if status.output_underflow else 0
    return int(over) | int(under)


def _scan() -> Any:
    """`sounddevice` with a fresh list: PortAudio looks for cards only when it begins."""
    try:
        import sounddevice
    except OSError as error:
        raise BackendError(f"PortAudio is not installed ({error}); on Debian: apt-get install libportaudio2") from error
    try:
        sounddevice._terminate()
        sounddevice._initialize()
    except sounddevice.PortAudioError as error:
        raise BackendError(f"PortAudio does not start ({error})") from error
    return sounddevice
