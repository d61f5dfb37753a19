"""Serial DAQ: a thread drains the port, a sound card plays the drive, one time base joins them.

A sample is what the device sent, at the counter it sent it with. The thread does nothing but read
and decode; what is lost is declared, what goes silent or away is an error that names the port, and the drive then
fades out through the card before it is let go.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import cast

import numpy as np
import serial
from numpy.typing import NDArray

from daq.clocks.clock_sync import ClockTracker, compile_now, find_marker, start_marker, window_samples
from daq.clocks.serial_frames import FrameDecoder, SerialFrame
from daq.files.tables import CLOCK_DTYPE, Block, BlockFlag, volts_per_code
from daq.setup.clock import SYSTEM, Clock
from kernels.arrays import Floats
from rig.backends.base import Backend, BackendError, Port, checked_drive, open_port
from rig.backends.kinds.base import OpenOptions
from rig.backends.kinds.soundcard_serial import SoundcardSerialOptions
from rig.backends.soundcard import SoundcardBackend
from rig.profile import Profile

Codes = NDArray[np.int16]

HELD_S = 60.0  # of frames that are not taken, before the reader gives up


class SerialReader:
    """Drain a port in a thread of its own, and hand out frames by the device's counter.

    ``name`` is the port's for messages, ``channels`` the values in a row, ``rate_hz`` nominal, for how much is held; a
    test or a simulation hands in its own ``opener`` of the port and ``clock``. ``newest`` is the device's counter after
    the last row that came, ``position`` that at the next row to be taken.
    """

    def __init__(
        self, name: str, channels: int, rate_hz: float, opener: Callable[[], Port], clock: Clock = SYSTEM
    ) -> None:
        self.name, self.clock = name, clock
        self.rows_in_frame = 1
        self._channels, self._opener = channels, opener
        self._most = round(HELD_S * rate_hz)
        self._thread: threading.Thread | None = None
        self._changed = threading.Condition()
        self._begin()

    def _begin(self) -> None:
        self._decoder = FrameDecoder(self._channels)
        self._frames: deque[SerialFrame] = deque()
        self._held = 0
        self.newest = self.position = -1
        self._fault = ""
        self._stopping = False

    def start(self) -> None:
        """Open the port and wait for the first good frame; raises `BackendError`."""
        self.stop()
        self._begin()
        port = self._opener()
        port.reset_input_buffer()
        self._thread = self.clock.background(self._drain(port), f"serial {self.name}")
        # a port that is opened makes some devices start anew
        self._wait(lambda: self.newest >= 0, 5.0)

    def stop(self) -> None:
        """Close the port; what was not taken is forgotten."""
        self._stopping = True
        if self._thread is not None:
            self._thread.join(5.0)
            self._thread = None

    def take(self, until: int) -> tuple[int, Codes, int]:
        """Rows up to the device's counter ``until``, waiting for them: counter of the first, codes (n, channels), lost.

        Rows that were lost end a piece: the next one begins after them and says how many they were.

        Raises `BackendError` when the device went away, fell silent, or sends nothing that follows.
        """
        self._wait(lambda: self.newest >= until)
        with self._changed:
            first, lost = self.position, 0
            if self._frames and first < self._frames[0].first_sample < until:
                # a gap in the device's counter: the piece begins after it and says how much is missing
                lost = self._frames[0].first_sample - first
                first = self._frames[0].first_sample
            pieces = [np.zeros((0, self._channels), np.int16)]
            at = first
            while at < until and self._frames and self._frames[0].first_sample <= at:
                frame = self._frames[0]
                stop = min(until, frame.next_sample)
                pieces.append(frame.codes[at - frame.first_sample : stop - frame.first_sample])
                at = stop
                if stop == frame.next_sample:
                    self._frames.popleft()
                    self._held -= len(frame.codes)
            self.position = at
        return first, np.concatenate(pieces), lost

    def await_rows(self, counter: int, until_s: float) -> None:
        """Wait for the row before ``counter``, no longer than the monotonic clock's ``until_s``."""
        with self._changed:
            while self.newest < counter and not self._fault:
                left_s = until_s - self.clock.monotonic_s()
                if left_s <= 0.0 or not self.clock.wait(self._changed, left_s):
                    return

    def _wait(self, ready: Callable[[], bool], patience_s: float = 0.5) -> None:
        """Until ``ready``, or what keeps it from coming; silence is counted from the last frame."""
        with self._changed:
            until, seen = self.clock.monotonic_s() + patience_s, self.newest
            while not ready():
                if self._thread is None:
                    raise BackendError("not started")
                if self._fault:
                    raise BackendError(self._fault)
                if self.newest != seen:
                    until, seen = self.clock.monotonic_s() + patience_s, self.newest
                left_s = max(0.0, until - self.clock.monotonic_s())
                if not self.clock.wait(self._changed, left_s) and self.clock.monotonic_s() >= until:
                    counts, why = self._decoder.counts, "is the device running, and is it this port?"
                    if counts.stale:
                        why = f"its counters do not go on ({counts.stale} stale frames): did the device start anew?"
                    elif counts.damaged:
                        damaged = f"{counts.damaged} damaged packets: is the baud rate right"
                        why = f"{damaged}, does it send {self._channels} channels?"
                    raise BackendError(f"serial DAQ {self.name}: no good frame for {patience_s:g} s; {why}")

    def _drain(self, port: Port) -> Iterator[None]:
        """The thread: read what is there, decode, hold; it yields after each read."""
        fault = ""
        try:
            while not self._stopping and not fault:
                frames = self._decoder.feed(port.read(max(1, port.in_waiting)))
                if frames:
                    fault = self._keep(frames)
                yield
        except (serial.SerialException, OSError) as error:
            fault = f"serial DAQ {self.name}: went away ({error}); check its cable, then resume the run"
        finally:
            port.close()
        with self._changed:
            self._fault = fault
            self._changed.notify_all()

    def _keep(self, frames: list[SerialFrame]) -> str:
        """Hold frames for `take`; what is wrong when there are too many."""
        with self._changed:
            if self.newest < 0:
                self.position = frames[0].first_sample
            self._frames.extend(frames)
            self._held += sum(len(frame.codes) for frame in frames)
            self.newest = frames[-1].next_sample
            self.rows_in_frame = max(self.rows_in_frame, *(len(frame.codes) for frame in frames))
            self._changed.notify_all()
        return f"serial DAQ {self.name}: its samples were not taken for {HELD_S:g} s" if self._held > self._most else ""


class SoundcardSerialBackend:
    """Drive through a card, frames from a serial device: two clocks, joined by the drive looped back into the device.

    Of the blocks of ``card`` only the flags are used. ``ranges_v`` are the full scales of the channels of the serial
    device that ``reader`` reads, by name, in the order of its rows; ``drive`` must be one of them. ``marker_v`` is the
    height of the start marker, ``frequency_hz`` that of the forcing.
    """

    name = "soundcard+serial"
    simulated = False
    scenario_sha256: str | None = None

    def __init__(
        self, card: Backend, reader: SerialReader, ranges_v: Mapping[str, float], marker_v: float, frequency_hz: float
    ) -> None:
        if "drive" not in ranges_v:
            raise BackendError("soundcard+serial: the serial device must record the drive, which joins the two clocks")
        self.channels = tuple(ranges_v)
        self.scales = {name: (volts_per_code(range_v), 0.0) for name, range_v in ranges_v.items()}
        self.rate_hz = card.rate_hz
        self._card, self._reader, self._marker_v = card, reader, marker_v
        self._drive = self.channels.index("drive")
        self._window = window_samples(self.rate_hz, frequency_hz)
        self._tracker: ClockTracker | None = None
        self._tail = np.zeros(0)
        self._whole = self._lag = self._played = self._given = 0

    @property
    def readings(self) -> NDArray[np.void]:
        """Raw readings of the two clocks since the start, `CLOCK_DTYPE` rows."""
        if self._tracker is None or not self._tracker.readings:
            return np.zeros(0, CLOCK_DTYPE)
        return np.concatenate(self._tracker.readings)

    def start(self) -> None:
        """Open both, play the start marker, and find it in what the serial device recorded of the drive."""
        self.stop()
        compile_now()
        self._reader.start()
        try:
            self._card.start()
            self._join_clocks()
        except BackendError:
            self.stop()
            raise

    def exchange(self, drive_v: Floats) -> Block:
        """Play ``drive_v`` and return what the serial device recorded meanwhile: as many frames, give or take one.

        Raises `BackendError` when the card or the serial device failed; the drive has then been faded out.
        """
        drive = checked_drive(drive_v)
        tracker = self._tracker
        if tracker is None:
            raise BackendError("not started")
        self._tail = np.concatenate([self._tail, drive])[-round(0.2 * self.rate_hz) :]
        tracker.played(drive)
        heard = self._card.exchange(drive)
        self._played += len(drive)
        lag = tracker.lag(self._reader.position)
        # not at half a sample: a lag that wavers there would add and drop a frame in turn
        if abs(lag - self._whole) > 0.75:
            self._whole = round(lag)
        try:
            first, codes, lost = self._reader.take(self._played - self._lag - self._whole)
        except BackendError:
            self._fade_out()
            raise
        scale, offset_v = self.scales["drive"]
        tracker.heard(first, codes[:, self._drive].astype(np.float64) * scale + offset_v)
        flags = heard.flags & BlockFlag.UNDERFLOW
        # frames that the card skipped: so much of the drive was never played
        if heard.lost_before or len(heard.codes) < len(drive):
            flags |= BlockFlag.UNDERFLOW
        now_ns = self._reader.clock.monotonic_ns()
        block = Block(self._given, codes, flags=flags, clock_ns=now_ns, lost_before=lost, place=first + self._whole)
        self._given += len(codes)
        return block

    def stop(self) -> None:
        """Let both go; the card leaves the drive at 0 V."""
        self._tracker = None
        self._card.stop()
        self._reader.stop()

    def _join_clocks(self) -> None:
        """Play the marker until it is recorded whole; from then on both clocks are counted from here."""
        block = max(16, round(0.01 * self.rate_hz))
        # silence before the marker, and at least after it
        quiet = np.zeros(round(0.1 * self.rate_hz))
        marker = start_marker(self.rate_hz)
        playing = np.concatenate([quiet, self._marker_v * marker, np.zeros(round(4.0 * self.rate_hz))])
        scale, _ = self.scales["drive"]
        pieces: list[Floats] = []
        begin = self._reader.position
        least = len(quiet) + len(marker) + len(quiet)
        found, played = None, 0
        began_s, newest = self._reader.clock.monotonic_s(), self._reader.newest
        while played + block <= len(playing) and (found is None or played < least):
            self._card.exchange(playing[played : played + block])
            played += block
            # two of the device's frames may be on their way between what came and what is asked for
            margin = 2 * self._reader.rows_in_frame
            # a card that takes the drive faster than it plays must not leave the device behind
            self._reader.await_rows(newest + played - margin, began_s + played / self.rate_hz)
            first, codes, lost = self._reader.take(max(self._reader.position, self._reader.newest - margin))
            if lost:
                pieces, begin = [], first
            pieces.append(codes[:, self._drive].astype(np.float64) * scale)
            if played >= least:
                found = find_marker(np.concatenate(pieces), marker)
        if found is None:
            raise BackendError(self._no_marker((self._reader.newest - newest) / played))
        lag = len(quiet) - played - (begin + found)
        self._whole, self._played, self._given = round(lag), 0, 0
        self._lag = -(self._reader.position + self._whole)  # the next row comes behind the drive by so much, and stays
        self._tail = np.zeros(0)
        self._tracker = ClockTracker(lag, self._reader.position, self._window, self.rate_hz)

    def _no_marker(self, rows_a_sample: float) -> str:
        """Error message where the marker was not found: absent, or stretched."""
        # no two quartzes differ by 2 %: the device's timer is set to another rate
        if abs(rows_a_sample - 1.0) > 0.02:
            rate_hz = rows_a_sample * self.rate_hz
            return (
                f"serial DAQ {self._reader.name}: sends about {rate_hz:.0f} rows a second, sampling.rate_hz is "
                f"{self.rate_hz:g}; set the device's timer, or the profile, so that they agree"
            )
        return (
            f"serial DAQ {self._reader.name}: its channel 'drive' does not record the start marker of "
            f"{self._marker_v:g} V; is the drive looped back into it, and not turned round?"
        )

    def _fade_out(self) -> None:
        """Bring the drive to rest through the card: the last of it backwards, which joins on, ever smaller."""
        self._tracker = None
        tail = self._tail[::-1]
        if not tail.size or not tail.any():
            return
        try:
            self._card.exchange(tail * np.cos(0.5 * np.pi * np.arange(1, tail.size + 1) / tail.size) ** 2)
        except BackendError:
            return  # the card is gone as well; its own stop leaves 0 V


def open_soundcard_serial(profile: Profile, options: OpenOptions) -> SoundcardSerialBackend:
    """Drive through the profile's sound card, channels through its serial device."""
    table = cast(SoundcardSerialOptions, profile.backend)
    ranges_v = {name: channel.range_v for name, channel in profile.channels.recorded().items()}
    rate_hz = profile.sampling.rate_hz

    def opener() -> Port:
        return open_port(table.port, table.baud, 0.05, whose="serial DAQ", key="backend.port")

    reader = SerialReader(table.port, len(ranges_v), rate_hz, opener)
    card = SoundcardBackend(profile, play_only=True)
    return SoundcardSerialBackend(card, reader, ranges_v, table.marker_v, profile.forcing.frequency_hz)
