"""The catalogue of many recordings, and the scope over a long one: times, processor time and memory.

python -m benchmarks.bench.runs --recordings 1000 --minutes 60
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.daq.recordings import RATE_HZ, SETUP, frames, peak_mb
from daq.files.tables import Block
from daq.recording import CHANNELS, open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup

BLOCK = 1024
SCALE = (10 / 32768, 0.0)


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Print wall and processor time of a block."""
    wall, own = time.perf_counter(), time.process_time()
    yield
    took, busy = time.perf_counter() - wall, time.process_time() - own
    print(f"{what}: {took:.3f} s, processor {busy:.3f} s, peak {peak_mb():.0f} MB", flush=True)


def record(path: Path, seconds: float, channels: int = 3) -> None:
    """A recording; a minute of frames, again and again."""
    setup = Setup.model_validate(SETUP)
    names = (*CHANNELS, "spare")[:channels]
    n, rng = round(seconds * RATE_HZ), np.random.default_rng(1)
    minute = frames(0, min(n, 60 * RATE_HZ), rng)
    if channels > 3:
        minute = np.column_stack([minute, rng.normal(0, 300, len(minute)).astype(np.int16)])
    scales = dict.fromkeys(names, SCALE)
    writer = RecordingWriter(path, setup, profile_text="", channels=names, backend="b", simulated=True, scales=scales)
    for first in range(0, n, BLOCK):
        at = np.arange(first, min(first + BLOCK, n)) % len(minute)
        lost = 500 if first == 300 * BLOCK else 0
        writer.append(Block(first, minute[at], lost_before=lost))
    for k in range(int(seconds // 5)):
        writer.mark_step({"first_sample": k * 5 * RATE_HZ, "n_samples": 5 * RATE_HZ, "gamma": 0.5 + 0.001 * k})
    writer.close()


def catalogue(folder: Path, n: int) -> None:
    """Copies of a small recording, each with a name and a start of its own, in folders of 50."""
    from bench.runs.catalogue import Catalogue, Query

    record(folder / "small.h5", 2.0)
    for k in range(n):
        place = folder / f"day{k // 50:03d}"
        place.mkdir(exist_ok=True)
        shutil.copy(folder / "small.h5", place / f"run{k:05d}.h5")
    for anew, what in ((True, "rescan"), (False, "warm call")):
        with timed(f"{what} of {n + 1} recordings"):
            known = Catalogue(folder, anew=anew)
            read = known.update()
            rows = known.runs(Query(sort="gamma", text="run0", limit=50))
        print(f"   {read} files read, {len(rows)} rows shown")


def long_recording(folder: Path, minutes: float) -> None:
    """Raw read, pyramid, opening and zooms of a long recording with four channels."""
    from bench.runs.scope import Scope
    from daq.pyramid import build_pyramid

    path, pyramid = folder / "long.h5", folder / "long.pyramid"
    record(path, 60 * minutes, channels=4)
    print(f"{path.stat().st_size / 1e6:.0f} MB on disk, {minutes * 60 * RATE_HZ * 4 * 2 / 1e6:.0f} MB of samples")
    with open_recording(path) as recording:
        buffer = np.empty(65536, np.int16)
        with timed("raw read of all channels"):
            for name in recording.channels:
                for start in range(0, recording.n_samples, len(buffer)):
                    recording.codes(name, start, start + len(buffer), out=buffer)
        for turn in ("first, with loading of its kernels", "again"):
            with timed(f"pyramid ({turn})"):
                build_pyramid(recording, pyramid)
    print(f"   {pyramid.stat().st_size / 1e6:.1f} MB")
    with timed("open"):
        scope = Scope(pyramid, path)
        whole = scope.facts()["duration_s"]
        scope.view(0.0, whole, 1200)
    rng = np.random.default_rng(2)
    for span_s in (3600.0, 600.0, 60.0, 15.0, 7.0, 1.0, 0.05, 0.002):
        took = []
        for _ in range(20):
            start_s = rng.uniform(0, max(whole - span_s, 0))
            began = time.perf_counter()
            scope.view(start_s, start_s + min(span_s, whole), 1200)
            took.append(1e3 * (time.perf_counter() - began))
        print(f"zoom of {span_s:g} s in 1200 columns: median {np.median(took):.1f} ms, longest {max(took):.1f} ms")
    print(f"peak {peak_mb():.0f} MB")


def main() -> None:
    """Run and print one line a stage."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=60.0)
    options = parser.parse_args()
    print(f"start: {peak_mb():.0f} MB, Python {sys.version.split()[0]}")
    with tempfile.TemporaryDirectory() as folder:
        if options.minutes:
            long_recording(Path(folder), options.minutes)
    with tempfile.TemporaryDirectory() as folder:
        if options.recordings:
            catalogue(Path(folder), options.recordings)


if __name__ == "__main__":
    main()
