"""Write, close, verify, read, export and import a recording; how fast, how large, how much memory.

    python -m benchmarks.daq.recordings --minutes 10 [--against PATH]

`--against` names another tree of this software, measured first. Processor seconds, and what a clock on the wall says;
the columns are written while blocks are appended, so `append` and `close` are also given together.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.spent import peak_mb
from daq.export.export import export
from daq.files.tables import Block
from daq.importers.formats.open import open_source
from daq.importers.import_recording import import_recording
from daq.recording import CHANNELS, open_recording, verify
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup

RATE_HZ, BLOCK, STEP_S = 20_000, 1024, 5.0
SETUP = {
    "name": "benchmark",
    "sampling": {"rate_hz": RATE_HZ},
    "forcing": {"frequency_hz": 25.37},
    "drive": {"g_per_volt": 2.0},
    "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}},
    "ball": {"mass_kg": 0.25},
}


def frames(first: int, n: int, rng: np.random.Generator) -> np.ndarray:
    """What a rig would give: steps of drive, acceleration with noise, a contact circuit, as codes (n, 3)."""
    t = np.arange(first, first + n) / RATE_HZ
    drive = np.sin(2 * np.pi * 25.37 * t) * (0.2 + 0.05 * np.floor(t / STEP_S % 20))
    continuity = np.where((t * 25.37) % 1 < 0.5, 5.0, 0.0) + rng.normal(0, 0.01, n)
    volts = np.column_stack([continuity, 0.2 * drive + rng.normal(0, 3e-3, n), drive + rng.normal(0, 2e-4, n)])
    return np.rint(volts / 10 * 32768).astype(np.int16)


def main() -> None:
    """Run and print one line a stage."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--text", action="store_true", help="also export to CSV and import again")
    parser.add_argument("--against", type=Path, help="another tree of this software, measured first")
    options = parser.parse_args()
    if options.against is not None:
        from benchmarks.beside import run_in  # the other tree may not have it

        run_in(options.against, __file__, ["--minutes", str(options.minutes), *(["--text"] if options.text else [])])
    rng = np.random.default_rng(1)
    n = int(options.minutes * 60 * RATE_HZ)
    setup = Setup.model_validate(SETUP)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="b", simulated=True)
        print(f"start: {peak_mb():.0f} MB")
        spent = 0.0
        for first in range(0, n, BLOCK):
            block = Block(first, frames(first, min(BLOCK, n - first), rng))
            began = time.process_time()
            writer.append(block)
            spent += time.process_time() - began
        per_block_us = spent / (n / BLOCK) * 1e6
        print(f"append: {per_block_us:.0f} us a block, {path.stat().st_size / 1e6:.0f} MB, {peak_mb():.0f} MB")
        frames_mb = n * len(CHANNELS) * 2 / 1e6
        stages = {
            "close (columns, checked)": writer.close,
            "verify": lambda: print("  ", verify(path).state),
            "read all channels": lambda: read(path),
        }
        if options.text:
            text, back = Path(folder) / "run.csv", Path(folder) / "back.h5"
            stages |= {
                "export to CSV": lambda: to_text(path, text),
                "import from CSV": lambda: from_text(text, back, setup),
            }
        for name, stage in stages.items():
            began, began_wall = time.process_time(), time.perf_counter()
            stage()
            took, wall = time.process_time() - began, time.perf_counter() - began_wall
            speed, size_mb = frames_mb / took, path.stat().st_size / 1e6
            print(
                f"{name}: {took:.2f} s ({wall:.2f} s on the wall), {speed:.0f} MB/s of frames, {size_mb:.0f} MB, "
                f"{peak_mb():.0f} MB"
            )
            if stage == writer.close:
                print(f"   append and close together: {spent + took:.2f} s")


def read(path: Path) -> None:
    """Every sample of every channel, in pieces, into one buffer."""
    with open_recording(path) as recording:
        buffer = np.empty(65536, np.int16)
        for name in recording.channels:
            for start in range(0, recording.n_samples, len(buffer)):
                recording.codes(name, start, start + len(buffer), out=buffer)


def to_text(path: Path, text: Path) -> None:
    """The CSV export."""
    with open_recording(path) as recording:
        export(recording, text, "csv")
    print(f"   {text.stat().st_size / 1e6:.0f} MB of text")


def from_text(text: Path, back: Path, setup: Setup) -> None:
    """The CSV import."""
    summary = import_recording(open_source(text), back, setup, "")
    print(f"   {summary.n_samples} samples, {len(summary.steps)} steps")


if __name__ == "__main__":
    main()
