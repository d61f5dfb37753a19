"""Speed of `bench import` of a text table: numpy.loadtxt, the reader now, and the whole import.

Run: python -m benchmarks.daq.import_csv [MINUTES] [--against PATH]; `--against` names another tree of this software,
measured on the same file first. Processor seconds of one process, and what a clock on the wall says; ratios are of one
run.
"""

from __future__ import annotations

import argparse
import io
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from daq.importers.formats.open import open_source
from daq.importers.import_recording import import_recording
from daq.setup.setup import Setup

RATE_HZ = 20000.0
HOLD_S = 10.0
NAMES = ("time_s", "continuity_v", "accelerometer_v", "drive_v")


def table(path: Path, minutes: float) -> None:
    """A ramp of steps that hold for ten seconds, with noise, six decimals."""
    rng = np.random.default_rng(1)
    with path.open("w") as file:
        file.write(",".join(NAMES) + "\n")
        for start in range(0, round(minutes * 60.0 * RATE_HZ), 200_000):
            t = (start + np.arange(200_000)) / RATE_HZ
            drive = (0.1 + 0.01 * (t // HOLD_S)) * np.sin(2 * np.pi * 25.37 * t)
            contact = np.where((t * 25.37) % 1 < 0.4, 5.0, 0.0) + rng.normal(0, 0.01, len(t))
            plate = 0.2 * drive + rng.normal(0, 1e-3, len(t))
            np.savetxt(file, np.column_stack([t, contact, plate, drive]), "%.6f", ",")


def loadtxt(path: Path) -> None:
    """numpy.loadtxt over blocks of 4 MiB, for comparison."""
    with path.open() as file:
        file.readline()
        while text := file.read(1 << 22) + file.readline():
            np.loadtxt(io.StringIO(text), delimiter=",", ndmin=2, comments=None)


def main() -> None:
    """Print megabytes a second of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("minutes", type=float, nargs="?", default=4.0)
    parser.add_argument("--against", type=Path, help="another tree of this software, measured first")
    options = parser.parse_args()
    minutes = options.minutes
    if options.against is not None:
        from benchmarks.beside import run_in  # the other tree may not have it

        run_in(options.against, __file__, [str(minutes)])
    setup = Setup.model_validate(
        {
            "name": "benchmark",
            "sampling": {"rate_hz": RATE_HZ},
            "forcing": {"frequency_hz": 25.37},
            "drive": {"g_per_volt": 2.0},
            "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}},
            "ball": {"mass_kg": 0.25},
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "a.csv"
        table(raw, minutes)
        small = Path(folder) / "b.csv"
        table(small, 200_000 / RATE_HZ / 60.0)
        for _ in open_source(small).pieces(NAMES):
            pass  # libraries are loaded and kernels compiled before the clock runs
        import_recording(open_source(small), Path(folder) / "b.h5", setup, "")

        def parse() -> None:
            for _ in open_source(raw).pieces(NAMES):
                pass

        def whole() -> None:
            import_recording(open_source(raw), Path(folder) / "a.h5", setup, "")

        cases: list[tuple[str, Callable[[], object]]] = [
            ("bytes read", raw.read_bytes),
            ("numbers read, numpy.loadtxt", lambda: loadtxt(raw)),
            ("numbers read, now", parse),
            ("whole import, now", whole),
        ]
        megabytes = raw.stat().st_size / 1e6
        for name, job in cases:
            began, began_wall = time.process_time(), time.perf_counter()
            job()
            spent, wall = time.process_time() - began, time.perf_counter() - began_wall
            speed = f"{spent:6.2f} s  {megabytes / spent:7.0f} MB/s"
            print(f"{name:<40} {megabytes:.0f} MB  {speed}, on the wall {wall:.2f} s", flush=True)


if __name__ == "__main__":
    main()
