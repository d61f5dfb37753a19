"""Any bytes at the serial decoder, and a million random frames through the C encoder.

Every code of the fuzzed device says which sample it is, so a wrong sample shows itself. The stream is cut, spliced,
flipped, repeated, delayed and mixed with noise; what comes out must be what went in, at the counter it went in with.

    python -m benchmarks.daq.serial_fuzz --bytes 10000000
    python -m benchmarks.daq.serial_fuzz --agree 1000000
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from daq.clocks.serial_frames import HEADER, VERSION, FrameDecoder, SerialFrame, encode_frame

CHANNELS = 3
FIRMWARE = Path(__file__).parents[2] / "firmware"


def codes_of(first: int, rows: int) -> np.ndarray:
    """Codes (rows, CHANNELS) that hold their own counter."""
    n = np.arange(first, first + rows, dtype=np.uint64)[:, None] * np.uint64(0x9E3779B97F4A7C15)
    mixed = (n + np.arange(CHANNELS, dtype=np.uint64) * np.uint64(40503)) >> np.uint64(23)
    return mixed.astype(np.uint16).view(np.int16)


def device(rng: np.random.Generator) -> list[bytes]:
    """Some dozens of frames of one device, overruns and all."""
    sequence, sample, overruns = int(rng.integers(2**32)), int(rng.integers(2**40)), int(rng.integers(2**32))
    packets = []
    for _ in range(int(rng.integers(2, 60))):
        dropped = int(rng.integers(1, 50)) if rng.random() < 0.05 else 0
        rows = int(rng.integers(1, 200))
        sample, overruns = sample + dropped, (overruns + dropped) % 2**32
        packets.append(encode_frame(SerialFrame(sequence, sample, overruns, codes_of(sample, rows))))
        sequence, sample = (sequence + 1) % 2**32, sample + rows
    return packets


def mangle(packets: list[bytes], rng: np.random.Generator) -> bytes:
    """The packets after a bad cable: each operation on bytes, or on whole packets, as often as chance has it."""
    kind = int(rng.integers(8))
    if kind == 0:
        return rng.bytes(int(rng.integers(1, 4000)))
    if kind == 1:
        return bytes(rng.choice([0, 1, 2, 255], int(rng.integers(1, 4000))).astype(np.uint8))
    if kind == 2:  # order, repeats, losses
        return b"".join(packets[int(i)] for i in rng.integers(0, len(packets), len(packets)))
    stream = bytearray(b"".join(packets))
    for _ in range(int(rng.integers(1, 30))):
        at = int(rng.integers(len(stream)))
        length = int(rng.integers(1, 300))
        if kind == 3:
            stream[at] ^= 1 << int(rng.integers(8))
        elif kind == 4:
            del stream[at : at + length]
        elif kind == 5:
            stream[at:at] = rng.bytes(length)
        elif kind == 6:  # a piece again, elsewhere
            other = int(rng.integers(len(stream)))
            stream[at:at] = stream[other : other + length]
        elif kind == 7:
            stream[at : at + length] = bytes(length)
        if len(stream) < 2:
            break
    return bytes(stream)


def fuzz(n_bytes: int, seed: int) -> dict[str, float]:
    """Feed ``n_bytes`` in random pieces; count what came out, and what of it was wrong."""
    rng = np.random.default_rng(seed)
    fed = wrong = samples = exceptions = good = damaged = stale = lost = streams = 0
    began = time.perf_counter()
    while fed < n_bytes:
        decoder = FrameDecoder(CHANNELS)
        packets = device(rng)
        stream = b"".join(packets) + mangle(packets, rng) + b"".join(packets[:3])
        cuts = np.sort(rng.integers(0, len(stream), int(rng.integers(0, 40))))
        position = None
        for piece in (stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)):
            try:
                frames = decoder.feed(piece)
            except Exception as error:  # noqa: BLE001 (that there is none is what is shown)
                exceptions += 1
                print(f"{type(error).__name__}: {error}")
                continue
            for frame in frames:
                wrong += int(np.count_nonzero(frame.codes != codes_of(frame.first_sample, len(frame.codes))))
                wrong += int(position is not None and frame.first_sample != position + frame.lost_before)
                position = frame.next_sample
                samples += frame.codes.size
        fed += len(stream)
        streams += 1
        good, damaged = good + decoder.counts.accepted, damaged + decoder.counts.damaged
        stale, lost = stale + decoder.counts.stale, lost + decoder.counts.lost_samples
    return {
        "bytes": fed, "streams": streams, "frames accepted": good, "samples accepted": samples, "damaged": damaged,
        "stale": stale, "rows declared lost": lost, "exceptions": exceptions, "wrong samples": wrong,
        "seconds": round(time.perf_counter() - began, 1),
    }  # fmt: skip


def agree(n_frames: int, seed: int) -> dict[str, float]:
    """Random frames through the C encoder and the Python decoder, and against the Python encoder byte for byte."""
    rng = np.random.default_rng(seed)
    same_bytes = same_frames = 0
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        binary = Path(folder) / "host_encode"
        sources = [str(FIRMWARE / name) for name in ("shaker_frame.c", "shaker_packet.c", "host_encode.c")]
        subprocess.run(["cc", "-std=c99", "-O2", *sources, "-o", str(binary)], check=True)
        for start in range(0, n_frames, 20_000):
            frames = [random_frame(rng) for _ in range(min(20_000, n_frames - start))]
            plain = b"".join(
                HEADER.pack(VERSION, f.codes.shape[1], len(f.codes), f.sequence, f.first_sample, f.overruns)
                + f.codes.tobytes()
                for f in frames
            )
            wire = subprocess.run([str(binary)], input=plain, stdout=subprocess.PIPE, check=True).stdout
            packets = wire.split(b"\0")[:-1]
            for frame, packet in zip(frames, packets, strict=True):
                same_bytes += packet + b"\0" == encode_frame(frame)
                (came,) = FrameDecoder(frame.codes.shape[1]).feed(packet + b"\0") or [None]
                same_frames += came is not None and same(came, frame)
    return {
        "frames": n_frames, "same frames": same_frames, "same bytes": same_bytes,
        "seconds": round(time.perf_counter() - began, 1),
    }  # fmt: skip


def random_frame(rng: np.random.Generator) -> SerialFrame:
    """Any frame: any counters; codes of any size, many zeros, or none at all."""
    channels = int(rng.integers(1, 17))
    rows = int(rng.integers(1, 2048 // channels + 1)) if rng.random() < 0.01 else int(rng.integers(1, 9))
    codes = rng.integers(-32768, 32768, (rows, channels)).astype(np.int16)
    style = rng.random()
    if style < 0.2:
        codes[rng.random(codes.shape) < 0.7] = 0
    elif style < 0.4:
        codes |= np.int16(0x0101)  # runs without a zero byte, longer than a COBS group
    return SerialFrame(int(rng.integers(2**32)), int(rng.integers(2**63)), int(rng.integers(2**32)), codes)


def same(a: SerialFrame, b: SerialFrame) -> bool:
    """Whether two frames say the same."""
    counters = (a.sequence, a.first_sample, a.overruns) == (b.sequence, b.first_sample, b.overruns)
    return counters and np.array_equal(a.codes, b.codes)


def main() -> int:
    """Print the figures; exit status 1 where something was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bytes", type=int, default=0)
    parser.add_argument("--agree", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    bad = False
    if options.bytes:
        figures = fuzz(options.bytes, options.seed)
        bad |= bool(figures["exceptions"] or figures["wrong samples"])
        print(figures)
    if options.agree:
        figures = agree(options.agree, options.seed)
        bad |= figures["same frames"] != options.agree or figures["same bytes"] != options.agree
        print(figures)
    return int(bad)


if __name__ == "__main__":
    sys.exit(main())
