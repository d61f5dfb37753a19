"""One stream of a sound card: which cards PortAudio lists, a stream on one of them, and the rings behind its callback.

What PortAudio refuses becomes a `BackendError` that names the card and lists the others.

The callback copies from and to two rings: the drive to be played and the frames recorded. The drive is played by the
card's time, and samples that come after their time are not played. Frames stay in the order they came, and samples that
the driver skipped are declared where they are missing. Decision 38.
"""

from __future__ import annotations

from collections import deque
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
        try:
            import jack
        except (ImportError, OSError) as error:
            raise BackendError(
                f"JACK leaves out callbacks, and what counts them is missing ({error}): pip install JACK-Client"
            ) from error
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
    keys = "max_input_channels", "max_output_channels", "default_samplerate"
    listed = [
        Card(device["name"], drivers[device["hostapi"]], *(device[key] for key in keys))
        for device in sounddevice.query_devices()
    ]
    _release()
    return listed


def open_stream(
    device: str, rate_hz: float, output: int, n_inputs: int, exchange: Exchange, woke: Callable[[int], None]
) -> CardStream:
    """A running stream on ``device``: full duplex, or output only where ``n_inputs`` is 0.

    Raises `BackendError` when there is no such card, or it refuses.

    ``device`` is a card's name, or words of it that fit only one card; ``output`` the one that plays, from 1 (those
    before it stay silent). ``exchange`` is called in the driver's thread: heard (n, n_inputs) or None, array (n,) to
    fill, the driver's count of frames where it skips callbacks when it is late; ``woke`` after it, with the `BlockFlag`
    bits that the driver claims.
    """
    sounddevice = _scan()
    count: FrameCounter | None = None
    try:
        driver = sounddevice.query_hostapis(sounddevice.query_devices(device, "output")["hostapi"])["name"]
        # only this driver leaves callbacks out, and says how many by a count of its own
        count = FrameCounter() if driver == JACK else None

        def duplex(heard: Samples | None, out: Samples, frames: int, times: Any, status: Any) -> None:
            exchange(heard, out[:, output - 1], count() if count is not None else None)
            over = BlockFlag.OVERFLOW if status and status.input_overflow else 0
            woke(int(over | (BlockFlag.UNDERFLOW if status and status.output_underflow else 0)))

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


DECAY_S = 0.005  # length of the decay to zero where the drive came too late


class CardRing:
    """Both directions of one stream, of which ``n_inputs`` channels are recorded: 0 of a card that only plays.

    ``received`` frames came and ``lost`` ones were skipped by the driver: only the callback moves these. ``written`` is
    the card's frame after the last drive sample handed over: only the writer moves it.
    """

    def __init__(self, rate_hz: float, n_inputs: int) -> None:
        self.n_inputs = n_inputs
        # eight seconds of frames: a caller later than half of it has lost the run
        self.size = 1 << round(8.0 * rate_hz).bit_length()
        self._out: Samples = np.zeros(self.size, np.float32)
        self._in: Samples = np.zeros((self.size, n_inputs), np.float32)
        n = max(1, round(DECAY_S * rate_hz))
        self._decay: Samples = (np.cos(0.5 * np.pi * np.arange(1, n + 1) / n) ** 2).astype(np.float32)
        self.reset()

    def reset(self) -> None:
        """As new."""
        self.received = self.lost = self.written = 0
        self._taken = self._lost_taken = 0
        self._out[:] = 0.0
        self._last = np.float32(0.0)
        self._losses: deque[tuple[int, int, int]] = deque()
        self._unsure_to = 0
        self._suspected: deque[tuple[int, int]] = deque()
        self._origin: int | None = None
        self._late = False

    @property
    def at(self) -> int:
        """The card's next frame: what came and what was skipped."""
        return self.received + self.lost

    @property
    def known(self) -> int:
        """The card's frame up to which it is certain what was skipped."""
        suspected = self._suspected
        return (suspected[0][0] if suspected else self.received) + self.lost

    @property
    def taken(self) -> int:
        """The card's frame after the last one taken."""
        return self._taken + self._lost_taken

    @property
    def counted(self) -> bool:
        """Whether the driver counts its frames."""
        return self._origin is not None

    def exchange(self, recorded: Samples | None, out: Samples, counter: int | None) -> None:
        """The callback's work: play into ``out`` (n,), keep ``recorded`` (n, n_inputs).

        ``counter`` is the driver's own count of frames, where it skips callbacks when it is late; else None.
        """
        n = len(out)
        if counter is not None:
            self._reckon(counter)
        at = self.at
        ready = min(max(self.written - at, 0), n)
        place = at % self.size
        first = min(ready, self.size - place)
        out[:first] = self._out[place : place + first]
        out[first:ready] = self._out[: ready - first]
        if ready:
            self._last = out[ready - 1]
        if ready < n:
            # nothing was handed over for these frames: softly to zero, since a jump would shake the plate
            rest = out[ready:]
            n_decay = min(len(rest), len(self._decay))
            rest[:n_decay] = self._last * self._decay[:n_decay]
            rest[n_decay:] = 0.0
            self._late |= bool(self._last != 0.0)
            self._last = np.float32(0.0)
        if recorded is not None:
            place = self.received % self.size
            first = min(n, self.size - place)
            self._in[place : place + first] = recorded[:first]
            self._in[: n - first] = recorded[first:]
        self.received += n

    def _reckon(self, counter: int) -> None:
        """Compare the driver's count with what came.

        A callback that runs late reads a count that is too high, never one too low: what stays missing for some calls
        on end is missing, and was so since the first of them; that one may itself have been late, and the loss after
        it: its frames are of unsure place.
        """
        if self._origin is None:
            self._origin = counter
        missing = (counter - self._origin - self.received) % 2**32
        if missing >= 2**31:  # the first calls were late themselves
            self._origin += missing - 2**32 - self.lost
            missing = self.lost
        if missing <= self.lost:
            self._suspected.clear()
            return
        self._suspected.append((self.received, missing))
        # what is missing for six callbacks on end is missing: a single late callback reads a count too high
        if len(self._suspected) == 6:
            sure = min(missing for _, missing in self._suspected)
            at, _ = self._suspected.popleft()
            if sure > self.lost:
                self._losses.append((at, sure - self.lost, self._suspected[0][0]))
                self.lost = sure

    def begin(self, ahead: int) -> int:
        """Forget what came so far; the next drive is played ``ahead`` frames from now. Returns the card's frame."""
        self._losses.clear()
        self._taken, self._lost_taken = self.received, self.lost
        self.written = self.at + ahead
        return self.taken

    def write(self, drive: Samples) -> None:
        """Hand over drive samples (n,), to be played from `written` on; those whose frame is over are left out."""
        start = max(self.written, self.at)
        late = min(start - self.written, len(drive))
        self._late |= late > 0 and bool(np.any(drive[:late]))
        rest = drive[late:]
        place = (self.written + late) % self.size
        first = min(len(rest), self.size - place)
        self._out[place : place + first] = rest[:first]
        self._out[: len(rest) - first] = rest[first:]
        self.written += len(drive)

    def take(self, until: int) -> tuple[int, Samples, int]:
        """What was skipped before them, the next frames (n, n_inputs), and their `BlockFlag` bits.

        They end at the card's frame ``until``, at a skip, or where the frames of unsure place after one end (those are
        flagged as filled). Drive that came too late since the last call is flagged as well.
        """
        begun = [(at, n, unsure_to) for at, n, unsure_to in tuple(self._losses) if at <= self._taken]
        lost = sum(n for _, n, _ in begun)
        unsure_to = max([self._unsure_to, *(to for _, _, to in begun)])
        ends = [at for at, _, _ in tuple(self._losses) if at > self._taken]
        ends += [unsure_to] if unsure_to > self._taken else []
        stop = min([until - self._lost_taken - lost, self.known - self.lost, *ends])
        if stop <= self._taken:
            return 0, np.zeros((0, self.n_inputs), np.float32), 0
        for _ in begun:
            self._losses.popleft()
        flags = BlockFlag.FILLED if unsure_to > self._taken else BlockFlag(0)
        frames: Samples = self._in[np.arange(self._taken, stop) % self.size]
        self._taken, self._lost_taken, self._unsure_to = stop, self._lost_taken + lost, unsure_to
        late, self._late = self._late, False
        return lost, frames, int(flags | BlockFlag.UNDERFLOW) if late else int(flags)

    def still(self, n: int, moved: float) -> bool:
        """Whether all inputs were one and the same for ``n`` frames while the drive moved by more than ``moved``."""
        if self.received < n:
            return False
        recorded = self._in[np.arange(self.received - n, self.received) % self.size]
        played = self._out[np.arange(self.at - n, self.at) % self.size]
        return bool(np.ptp(played) > moved and not np.ptp(recorded, axis=0).any())

    def fade_out(self, n: int) -> None:
        """Follow what was handed over by its last ``n`` samples backwards, ever smaller."""
        tail = self._out[np.arange(self.written - n, self.written) % self.size][::-1]
        if self.written > self.at and tail.any():
            self.write(tail * (0.5 + 0.5 * np.cos(np.pi * np.arange(1, n + 1) / n)).astype(np.float32))
