"""The serial wire format: whole frames or counted losses, whatever the bytes."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.clocks.serial_frames import HEADER, MAX_SAMPLES, VERSION, FrameDecoder, SerialFrame, encode_frame

FIRMWARE = Path(__file__).parents[3] / "firmware"


def row_codes(first: int, rows: int, channels: int = 3) -> np.ndarray:
    """Codes that say which sample they are."""
    numbers = np.arange(first, first + rows)[:, None] * 7 + np.arange(channels)
    return (numbers % 65536).astype(np.uint16).view(np.int16)


def stream_of(n_frames: int, rows: int = 20, start: int = 0) -> list[bytes]:
    """Packets of a device that loses nothing."""
    return [
        encode_frame(SerialFrame(i, start + i * rows, 0, row_codes(start + i * rows, rows))) for i in range(n_frames)
    ]


def test_a_stream_comes_back_whole_however_it_is_cut() -> None:
    """The same frames come out byte by byte and all at once, in order, without a loss."""
    wire = b"".join(stream_of(30))
    decoder = FrameDecoder(3)
    bytewise = [frame for i in range(len(wire)) for frame in decoder.feed(wire[i : i + 1])]
    at_once = FrameDecoder(3).feed(wire)
    assert [f.first_sample for f in bytewise] == [f.first_sample for f in at_once] == list(range(0, 600, 20))
    assert np.array_equal(np.concatenate([f.codes for f in bytewise]), row_codes(0, 600))
    assert (decoder.counts.accepted, decoder.counts.damaged, decoder.counts.lost_samples) == (30, 0, 0)


def test_a_lost_frame_and_a_dropped_conversion_are_told_apart() -> None:
    """What the wire lost shows in the sequence, what the device dropped in its overruns; both count samples."""
    frames = [SerialFrame(5, 100, 9, row_codes(100, 10)), SerialFrame(8, 137, 12, row_codes(137, 10))]
    _, second = FrameDecoder(3).feed(b"".join(map(encode_frame, frames)))
    assert (second.lost_before, second.dropped_before) == (27, 3)


def test_counters_wrap() -> None:
    """Sequence and overruns run over 2**32 without a loss."""
    top = 2**32 - 1
    frames = [SerialFrame(top, 0, top, row_codes(0, 4)), SerialFrame(0, 5, 0, row_codes(5, 4))]
    came = FrameDecoder(3).feed(b"".join(map(encode_frame, frames)))
    assert [(f.lost_before, f.dropped_before) for f in came] == [(0, 0), (1, 1)]


@pytest.mark.parametrize("flipped", range(0, 8 * 60, 7))
def test_a_flipped_bit_costs_a_counted_frame_and_no_other(flipped: int) -> None:
    """One bad bit: the frame it hits is thrown away, its neighbours come, and its samples are declared lost."""
    wire = bytearray(b"".join(stream_of(6)))
    wire[200 + flipped // 8] ^= 1 << (flipped % 8)
    decoder = FrameDecoder(3)
    frames = decoder.feed(bytes(wire))
    assert len(frames) in (4, 5)  # a delimiter that is hit takes two frames with it
    assert decoder.counts.damaged >= 1
    assert sum(f.lost_before for f in frames) == 20 * (6 - len(frames))
    for frame in frames:
        assert np.array_equal(frame.codes, row_codes(frame.first_sample, 20))


def test_repeated_old_and_foreign_frames_are_not_taken() -> None:
    """A good frame whose counters cannot follow (sent twice, from before, from another device) is counted, not used."""
    packets = stream_of(4)
    other = encode_frame(SerialFrame(4, 10**9, 0, row_codes(0, 20)))
    wide = encode_frame(SerialFrame(4, 80, 0, row_codes(80, 20, channels=4)))
    decoder = FrameDecoder(3)
    frames = decoder.feed(b"".join([*packets, packets[3], packets[0], other, wide]))
    assert len(frames) == 4
    assert (decoder.counts.stale, decoder.counts.damaged) == (3, 1)


def test_a_cable_full_of_noise_without_a_delimiter_is_not_kept() -> None:
    """Bytes that never end a packet cost no memory, and the next delimiter begins anew."""
    decoder = FrameDecoder(3)
    for _ in range(50):
        assert decoder.feed(b"\x55" * 10_000) == []
    assert len(decoder._held) == 0
    decoder.feed(b"\0")
    assert len(decoder.feed(stream_of(1)[0])) == 1
    assert decoder.counts.damaged == 1


@settings(max_examples=300, deadline=None)
@given(
    noise=st.lists(st.one_of(st.binary(max_size=80), st.sampled_from(stream_of(12))), max_size=30),
    cut=st.integers(1, 70),
)
def test_any_bytes_give_true_frames_in_order_and_no_exception(noise: list[bytes], cut: int) -> None:
    """Noise and true frames in any order and any pieces: whatever is accepted is true, at its place, losses right."""
    wire = b"".join(noise)
    decoder = FrameDecoder(3)
    position = None
    for at in range(0, len(wire), cut):
        for frame in decoder.feed(wire[at : at + cut]):
            assert np.array_equal(frame.codes, row_codes(frame.first_sample, 20))
            assert position is None or frame.first_sample == position + frame.lost_before
            position = frame.next_sample


@pytest.mark.parametrize("shape", [(0, 3), (1, 17), (MAX_SAMPLES // 3 + 1, 3)])
def test_what_no_frame_can_hold_is_refused(shape: tuple[int, int]) -> None:
    """The encoder refuses an empty frame, too many channels and too many values."""
    with pytest.raises(ValueError, match="wanted 1 to"):
        encode_frame(SerialFrame(0, 0, 0, np.zeros(shape, np.int16)))


@pytest.fixture(scope="module")
def host_encode(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The firmware's encoder, compiled for this machine."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) on this machine")
    binary = tmp_path_factory.mktemp("firmware") / "host_encode"
    strict = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"]
    sources = [str(FIRMWARE / name) for name in ("shaker_frame.c", "shaker_packet.c", "host_encode.c")]
    subprocess.run([compiler, *strict, *sources, "-o", str(binary)], check=True)
    return binary


def test_the_firmware_sends_what_the_decoder_reads(host_encode: Path) -> None:
    """Random frames, zeros and long runs without a zero included: C and Python agree byte for byte, and decode."""
    rng = np.random.default_rng(1)
    frames = []
    for i in range(400):
        channels = int(rng.integers(1, 17))
        rows = MAX_SAMPLES // channels if i % 50 == 0 else int(rng.integers(1, 40))
        codes = rng.integers(-32768, 32768, (rows, channels)).astype(np.int16)
        if i % 3 == 0:
            codes[rng.random(codes.shape) < 0.7] = 0
        elif i % 3 == 1:
            codes |= np.int16(0x0101)
        counters = (int(rng.integers(2**32)), int(rng.integers(2**63)), int(rng.integers(2**32)))
        frames.append(SerialFrame(*counters, codes))
    plain = b"".join(
        HEADER.pack(VERSION, f.codes.shape[1], len(f.codes), f.sequence, f.first_sample, f.overruns) + f.codes.tobytes()
        for f in frames
    )
    wire = subprocess.run([str(host_encode)], input=plain, stdout=subprocess.PIPE, check=True).stdout
    assert wire == b"".join(map(encode_frame, frames))
    for frame, packet in zip(frames, wire.split(b"\0")[:-1], strict=True):
        (came,) = FrameDecoder(frame.codes.shape[1]).feed(packet + b"\0")
        assert (came.sequence, came.first_sample, came.overruns) == (
            frame.sequence, frame.first_sample, frame.overruns,
        )  # fmt: skip
        assert np.array_equal(came.codes, frame.codes)


def test_the_firmware_refuses_what_no_frame_can_hold(host_encode: Path) -> None:
    """A frame without rows makes the C encoder return 0 bytes, which the filter reports."""
    bad = HEADER.pack(VERSION, 3, 0, 0, 0, 0)
    assert subprocess.run([str(host_encode)], input=bad, stdout=subprocess.PIPE, check=False).returncode == 1
