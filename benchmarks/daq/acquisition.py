"""No lost block at 4 x 200 kHz: a device that cannot wait, the recorder, and an operator's process under load.

The device is a process of its own that puts a block of 1024 x 4 codes into the ring when its time has come; a block
that finds the ring full is lost. The recorder is `daq.recorder.recorder_process`. The load runs in the operator's
process, which is where a naive recorder would run: pure Python work, object churn with the garbage collector, or gzip
reading by h5py.

    python -m benchmarks.daq.acquisition --seconds 600 --load python churn gzip
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from daq.files.tables import Block
from daq.recorder.recorder_process import RecorderProcess
from daq.recorder.shared_ring import Ring
from daq.recording import verify
from daq.setup.setup import Setup

RATE_HZ, BLOCK, CHANNELS = 200_000.0, 1024, ("continuity", "accelerometer", "drive", "spare")
SETUP = {
    "name": "acquisition",
    "sampling": {"rate_hz": RATE_HZ},
    "forcing": {"frequency_hz": 25.37},
    "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}},
    "ball": {"mass_kg": 0.25},
}


def device(shape: tuple[int, int, int, str], seconds: float) -> None:
    """Put blocks into the ring on time, never waiting for room."""
    ring = Ring(*shape)
    codes = np.random.default_rng(1).integers(-3000, 3000, (64, BLOCK, len(CHANNELS))).astype(np.int16)
    began, n = time.monotonic(), int(seconds * RATE_HZ / BLOCK)
    for i in range(n):
        wait = began + (i + 1) * BLOCK / RATE_HZ - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        ring.put(Block(i * BLOCK, codes[i % 64], clock_ns=time.monotonic_ns()))
    ring.close()


def pure_python(until: float, folder: Path) -> None:
    """A busy loop that never lets go of the interpreter by itself."""
    total = 0
    while time.monotonic() < until:
        for i in range(100_000):
            total += i * i % 7


def churn(until: float, folder: Path) -> None:
    """Many small objects in cycles, and full collections."""
    import gc

    held: list[object] = []
    while time.monotonic() < until:
        held.append([{"a": i, "b": [i, held]} for i in range(2000)])
        if len(held) > 200:
            held.clear()
            gc.collect()


def gzip_reading(until: float, folder: Path) -> None:
    """Another thread reads gzip through h5py, which holds HDF5's lock; two at a time."""
    path = folder / "other.h5"
    with h5py.File(path, "w") as file:
        data = np.random.default_rng(2).integers(0, 99, 4_000_000).astype(np.int32)
        file.create_dataset("x", data=data, compression="gzip", chunks=(262_144,))

    def read() -> None:
        with h5py.File(path, "r") as file:
            while time.monotonic() < until:
                file["x"][:]

    threads = [threading.Thread(target=read) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def idle(until: float, folder: Path) -> None:
    """Nothing."""
    time.sleep(max(0.0, until - time.monotonic()))


LOADS: dict[str, Callable[[float, Path], None]] = {
    "idle": idle,
    "python": pure_python,
    "churn": churn,
    "gzip": gzip_reading,
}


def run(load: str, seconds: float, folder: Path) -> str:
    """One run under one load; a line of what came of it."""
    path = folder / f"{load}.h5"
    recorder = RecorderProcess(
        path,
        Setup.model_validate(SETUP),
        profile_text="",
        channels=CHANNELS,
        backend="benchmark",
        simulated=True,
        block_samples=BLOCK,
        private=False,
    )
    ring = recorder.ring
    shape = (ring.slots, BLOCK, len(CHANNELS), ring.name)
    source = multiprocessing.get_context("spawn").Process(target=device, args=(shape, seconds))
    source.start()
    LOADS[load](time.monotonic() + seconds, folder)
    source.join()
    dropped, backlog = ring.counter("dropped_blocks"), ring.counter("worst_backlog") * BLOCK / RATE_HZ
    n = int(seconds * RATE_HZ / BLOCK) * BLOCK
    began = time.monotonic()
    recorder.close(expected_samples=n)
    closing = time.monotonic() - began
    report = verify(path)
    size = path.stat().st_size
    path.unlink()
    wrong = "".join(f", {line}" for line in ["suspect"] * report.suspect + list(report.where))
    return (
        f"{load:7s} {seconds:5.0f} s at 4 x 200 kHz: blocks lost {dropped}, worst backlog {backlog * 1e3:.0f} ms of "
        f"{ring.slots * BLOCK / RATE_HZ * 1e3:.0f} ms, {report.state}, {report.n_samples} of {n} samples"
        f"{wrong}; closed in {closing:.1f} s, {size / 1e6:.0f} MB"
    )


def main() -> None:
    """Run the loads one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--load", nargs="+", choices=list(LOADS), default=["python", "churn", "gzip"])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for load in options.load:
            print(run(load, options.seconds, Path(folder)), flush=True)
    if sys.platform != "win32":
        import resource

        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        print(
            f"recorder and device: {children.ru_utime + children.ru_stime:.0f} s of processor time, at most "
            f"{children.ru_maxrss / 1024:.0f} MB each; {os.cpu_count()} cores"
        )


if __name__ == "__main__":
    main()
