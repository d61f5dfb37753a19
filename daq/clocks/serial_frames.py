"""The serial wire format: bytes in, frames out, no I/O inside; the layout is in docs/reference/serial-frame.md.

Any byte stream yields good frames or counted losses, never an exception and never a wrong sample. A frame counts only
when its CRC-32 fits, its size is what its header says, and its counters go on from those of the frame before by no more
than the frames between could have held.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from cobs import cobs
from numpy.typing import NDArray

VERSION = 1
HEADER = struct.Struct("<BBHIQI")  # version, channels, frames, sequence, first sample, overruns
CRC_BYTES = 4
MAX_CHANNELS = 16
MAX_SAMPLES = 2048  # int16 values in one frame, all channels together
MAX_PACKET_BYTES = HEADER.size + 2 * MAX_SAMPLES + CRC_BYTES
MAX_WIRE_BYTES = MAX_PACKET_BYTES + MAX_PACKET_BYTES // 254 + 1  # COBS adds at most one byte in 254, and one


@dataclass(frozen=True)
class SerialFrame:
    """One frame of the device."""

    sequence: int  # number of the frame since the device started, modulo 2**32
    # the device's counter of conversions at its first row; conversions that it had to drop are counted too
    first_sample: int
    overruns: int  # conversions that the device dropped since it started, modulo 2**32
    codes: NDArray[np.int16]  # (n, channels)
    lost_before: int = 0  # rows missing between the frame before and this one; 0 for the first
    dropped_before: int = 0  # those of them that the device says it dropped itself; the others were lost on the way

    @property
    def next_sample(self) -> int:
        """Counter after the last row."""
        return self.first_sample + len(self.codes)


@dataclass
class WireCounts:
    """Counts of what came over the wire since the decoder was made."""

    accepted: int = 0  # good frames
    damaged: int = 0  # packets thrown away: no valid COBS, wrong size or version, a CRC that does not fit
    # good frames thrown away because their counters cannot follow: sent twice, out of order, from a device that
    # started anew
    stale: int = 0
    lost_samples: int = 0  # rows declared as lost between accepted frames


def encode_frame(frame: SerialFrame) -> bytes:
    """The bytes of a frame on the wire, delimiter included; raises `ValueError` for no rows, or too many values."""
    rows, channels = frame.codes.shape
    if not 1 <= channels <= MAX_CHANNELS or not 1 <= rows * channels <= MAX_SAMPLES:
        raise ValueError(
            f"wanted 1 to {MAX_CHANNELS} channels and 1 to {MAX_SAMPLES} values, came {rows} rows of {channels}"
        )
    head = HEADER.pack(VERSION, channels, rows, frame.sequence, frame.first_sample, frame.overruns)
    packet = head + np.ascontiguousarray(frame.codes, "<i2").tobytes()
    return packed(packet)


def packed(packet: bytes) -> bytes:
    """A packet on the wire: with its CRC-32, zeros stuffed (COBS), a zero at its end."""
    stuffed: bytes = cobs.encode(packet + zlib.crc32(packet).to_bytes(CRC_BYTES, "little"))
    return stuffed + b"\0"


def unpacked(wire: bytes) -> bytes | None:
    """The packet that `packed` gave, from the bytes before the zero; None where it is not as it was sent."""
    try:
        whole = cobs.decode(wire)
    except cobs.DecodeError:
        return None
    packet: bytes = whole[:-CRC_BYTES]
    return packet if zlib.crc32(packet) == int.from_bytes(whole[-CRC_BYTES:], "little") else None


class FrameDecoder:
    """Bytes, however cut, to the frames of ``channels`` columns that are in them."""

    def __init__(self, channels: int) -> None:
        self.counts = WireCounts()
        self._channels = channels
        self._held = bytearray()
        self._skipping = False
        self._last: SerialFrame | None = None

    def feed(self, data: bytes) -> list[SerialFrame]:
        """Take in bytes; gives back the frames that are complete, in order, their losses declared."""
        *ended, open_end = data.split(b"\0")
        frames = []
        for part in ended:
            self._hold(part)
            wire, skipped = bytes(self._held), self._skipping
            self._held.clear()
            self._skipping = False
            if not wire and not skipped:
                continue  # delimiters may stand together
            frame = None if skipped else parse_packet(wire, self._channels)
            if frame is None:
                self.counts.damaged += 1
            elif (following := self._following(frame)) is not None:
                frames.append(following)
        self._hold(open_end)
        return frames

    def _hold(self, part: bytes) -> None:
        """Hold the beginning of a packet, unless it is already longer than any packet."""
        if self._skipping:
            return
        self._held += part
        if len(self._held) > MAX_WIRE_BYTES:
            self._held.clear()
            self._skipping = True

    def _following(self, frame: SerialFrame) -> SerialFrame | None:
        """``frame`` with its losses, or None where its counters contradict those of the frame before."""
        last = self._last
        if last is not None:
            # frames that are missing held at least a row each, and no more than fits a frame
            missing = (frame.sequence - last.sequence - 1) % 2**32
            dropped = (frame.overruns - last.overruns) % 2**32
            lost = frame.first_sample - last.next_sample
            if not dropped + missing <= lost <= dropped + missing * (MAX_SAMPLES // self._channels):
                self.counts.stale += 1
                return None
            frame = SerialFrame(frame.sequence, frame.first_sample, frame.overruns, frame.codes, lost, dropped)
            self.counts.lost_samples += lost
        self._last = frame
        self.counts.accepted += 1
        return frame


def parse_packet(wire: bytes, channels: int) -> SerialFrame | None:
    """The frame in one packet without its delimiter; None where it is not whole or not of this format."""
    if not HEADER.size < len(wire) <= MAX_WIRE_BYTES:
        return None
    packet = unpacked(wire)
    if packet is None or len(packet) <= HEADER.size:
        return None
    version, columns, rows, sequence, first_sample, overruns = HEADER.unpack_from(packet)
    values = rows * columns
    size = HEADER.size + 2 * values
    if version != VERSION or columns != channels or not 1 <= values <= MAX_SAMPLES or len(packet) != size:
        return None
    codes = np.frombuffer(packet, "<i2", values, HEADER.size).astype(np.int16).reshape(rows, columns)
    return SerialFrame(sequence, first_sample, overruns, codes)
