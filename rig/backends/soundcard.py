"""The sound card: drive out and three channels in, full duplex, through PortAudio (`sounddevice`).

Everything is counted in the card's own frames since the stream began. The callback copies to and
from a ring at the frame it is at, and nothing else; what was handed over too late is not played later, so the drive
keeps its phase, and frames that never came are declared where they are missing. The driver's own reports are not used.
"""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable

import numpy as np

from daq.clocks.clock_sync import find_marker, start_marker
from daq.files.tables import Block, volts_per_code
from daq.setup.clock import SYSTEM, Clock
from kernels.arrays import Floats
from rig.backends.base import BackendError, checked_drive
from rig.backends.kinds.base import OpenOptions
from rig.backends.kinds.soundcard import card_options
from rig.backends.portaudio import CardRing, CardStream, open_stream
from rig.profile import Profile

SILENCE_S = 0.5  # without a callback: the card is stuck, or gone
FADE_S = 0.1


class SoundcardBackend:
    """One card, one clock: plays the drive on one output, records continuity, accelerometer and looped-back drive.

    Parameters
    ----------
    profile
        Its ``[backend]`` names the card and its channels, ``[channels]`` their ranges.
    play_only
        Whether nothing is recorded: another device does that (`rig.backends.serial_daq`).
    opener, clock
        What opens the stream instead of PortAudio, and the machine's clock; a simulation has its own.

    Attributes
    ----------
    lag_samples : float
        From a sample handed over to its frame, measured at the start; NaN before, and where nothing is recorded.
    output_lag_samples : int
        Of these, what this back end itself keeps ahead.
    """

    name = "soundcard"
    simulated = False
    scenario_sha256: str | None = None

    def __init__(
        self,
        profile: Profile,
        *,
        play_only: bool = False,
        opener: Callable[..., CardStream] | None = None,
        clock: Clock = SYSTEM,
    ) -> None:
        self._opener, self._clock = opener, clock
        table = card_options(profile.backend)
        wired = {} if play_only else table.inputs.wired(profile.channels)
        self.channels = tuple(wired)
        self.rate_hz = profile.sampling.rate_hz
        described = profile.channels.recorded()
        self.scales = {name: (volts_per_code(described[name].range_v), 0.0) for name in self.channels}
        self.lag_samples = float("nan")
        self.output_lag_samples = max(1, round(table.buffer_s * self.rate_hz))
        self._table, self._inputs = table, [wired[name] - 1 for name in self.channels]
        self._stream: CardStream | None = None
        self._ring = CardRing(self.rate_hz, max(self._inputs, default=-1) + 1)
        self._changed = threading.Event()
        self._due: int | None = None  # the frame up to which the caller has played
        self._given = 0
        self._flags = 0
        self._woken = (0, 0)  # the card's frame after the last callback, and when that was

    def start(self) -> None:
        """Open the card, and find how long the drive takes to come back; raises `BackendError`."""
        self.stop()
        # another thread keeps the callback from running for half a millisecond at most
        sys.setswitchinterval(0.0005)
        gc.collect()
        gc.freeze()  # what is there now is not looked through again while the callback waits
        self._ring.reset()
        self._flags = self._given = 0
        self._due = None
        self._stream = (self._opener or open_stream)(
            self._table.device, self.rate_hz, self._table.output, self._ring.n_inputs, self._ring.exchange, self._woke
        )
        try:
            self._await(1, 5.0)
            if self.channels:
                self.lag_samples = self._listen()
        except BackendError:
            self.stop()
            raise
        self._due, self._given = None, 0

    def exchange(self, drive_v: Floats) -> Block:
        """Play ``drive_v`` (n,) after what was handed over before, and return the card's next n frames.

        The frames lie `lag_samples` behind the drive. Where the card skipped frames the block ends, and the next says
        how many they were.

        Raises `BackendError` when the card failed, went away, or is not started.
        """
        drive = checked_drive(drive_v)
        if self._stream is None:
            raise BackendError("not started")
        if self._due is None:  # time begins with the first exchange, however long that took to come
            self._due = self._ring.begin(self.output_lag_samples)
        self._due += len(drive)
        self._ring.write((drive / self._table.output_range_v).astype(np.float32))
        self._await(self._due, SILENCE_S + len(drive) / self.rate_hz)
        lost, frames, own_flags = self._ring.take(self._due)
        # inputs frozen to the last bit while the drive moved: some drivers go on calling when the card is gone
        if self.channels and self._ring.still(round(0.02 * self.rate_hz), 0.002):
            raise BackendError(self._failed("every input is frozen while the drive moves"))
        flags, self._flags = self._flags | own_flags, 0
        codes = np.rint(frames[:, self._inputs] * 32768.0).clip(-32768, 32767).astype(np.int16)
        stop = self._ring.taken
        frame, woken_ns = self._woken
        block = Block(
            self._given,
            codes,
            flags=flags,
            clock_ns=woken_ns - self._ns(frame - stop),  # the card's time, however late the caller comes
            lost_before=lost,
            adc_ns=self._ns(stop - len(codes)) if self._ring.counted else 0,
        )
        self._given += len(codes)
        return block

    def stop(self) -> None:
        """Fade what is being played to 0 V, and let the card go."""
        stream, self._stream = self._stream, None
        self._due = None
        if stream is None:
            return
        self._ring.fade_out(round(FADE_S * self.rate_hz))
        alive, until = self._calls(), self._clock.monotonic_s() + FADE_S + 2.0 * self._table.buffer_s + SILENCE_S
        while alive and self._ring.at < self._ring.written and self._clock.monotonic_s() < until:
            alive = self._calls()
        alive = alive and self._calls()  # what the last callback took is played until the next
        stream.close(alive=alive)

    def _calls(self) -> bool:
        """Whether the driver calls within `SILENCE_S`."""
        self._changed.clear()
        return self._clock.wait(self._changed, SILENCE_S)

    def _woke(self, flags: int) -> None:
        """Called after each callback, and with `BlockFlag` bits that the driver claims."""
        self._flags |= flags
        self._woken = (self._ring.at, self._clock.monotonic_ns())
        self._changed.set()

    def _ns(self, frames: int) -> int:
        """Frames as nanoseconds."""
        return round(1e9 * frames / self.rate_hz)

    def _await(self, frame: int, patience_s: float) -> None:
        """Until the card has reached ``frame``."""
        until = self._clock.monotonic_s() + patience_s
        while self._ring.known < frame:
            self._changed.clear()
            if self._ring.known >= frame:
                break
            if self._stream is None or not self._stream.active:
                raise BackendError(self._failed("the stream ended"))
            if not self._clock.wait(self._changed, 0.05) and self._clock.monotonic_s() > until:
                raise BackendError(self._failed(f"no samples for {patience_s:.2g} s"))
        if self._ring.at - frame > self._ring.size // 2:
            raise BackendError(self._failed("its samples were not taken for seconds"))

    def _failed(self, what: str) -> str:
        return (
            f"sound card {self._table.device!r}: {what}; is it still plugged in, and its driver running? "
            "`bench devices` lists what is there; then resume the run"
        )

    def _listen(self) -> float:
        """Play the marker and find it in the looped-back drive: samples from handing over to recording."""
        marker = start_marker(self.rate_hz)
        piece = round(0.05 * self.rate_hz)
        quiet = np.zeros(piece)
        column, scale = self.channels.index("drive"), self.scales["drive"][0]
        block = self.exchange(np.concatenate([quiet, self._table.marker_v * marker, quiet]))
        heard: Floats = np.asarray(block.codes[:, column] * scale, np.float64)
        found = find_marker(heard, marker)
        while found is None and len(heard) < 1.0 * self.rate_hz:
            heard = np.concatenate([heard, self.exchange(quiet).codes[:, column] * scale])
            found = find_marker(heard, marker)
        if found is None:
            raise BackendError(
                f"sound card {self._table.device!r}: input {self._table.inputs.drive} (the looped-back drive) does not "
                f"record the start marker of {self._table.marker_v:g} V on output {self._table.output}; is the drive "
                "looped back into it, and not turned round?"
            )
        return found - piece


def open_soundcard(profile: Profile, options: OpenOptions) -> SoundcardBackend:
    """The card that the profile names."""
    return SoundcardBackend(profile)
