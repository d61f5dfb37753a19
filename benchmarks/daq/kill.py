"""Kill a recorder at random moments: no acknowledged block may be lost, every file must be recovered.

Each trial forks a process that records blocks whose content follows from their place, marks steps, and closes; it
reports each block once its flush has returned. It is killed with SIGKILL at a random moment. Run on a POSIX system:

    python -m benchmarks.daq.kill --trials 200
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from daq.recording import CHANNELS, Block, open_recording, verify
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup

BLOCK = 512
SETUP = {
    "name": "kill",
    "forcing": {"frequency_hz": 25.37},
    "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}},
    "ball": {"mass_kg": 0.25},
}


def content(first: int, n: int) -> np.ndarray:
    """Frames that follow from their place in the recording, int16 (n, 3)."""
    index = np.arange(first, first + n, dtype=np.int64)[:, None] * 3 + np.arange(3)
    return ((index * 2654435761) >> 7).astype(np.int16)


def record(path: Path, acknowledged: Connection, n_blocks: int) -> None:
    """Record, telling the parent of each block that is safe."""
    writer = RecordingWriter(
        path, Setup.model_validate(SETUP), profile_text="", channels=CHANNELS, backend="kill", simulated=True
    )
    acknowledged.send(0)
    for i in range(n_blocks):
        writer.append(Block(i * BLOCK, content(i * BLOCK, BLOCK)))
        acknowledged.send((i + 1) * BLOCK)
        if i % 20 == 19:
            writer.mark_step({"first_sample": (i - 19) * BLOCK, "n_samples": 20 * BLOCK, "gamma": i / 100})
    writer.close()


def trial(folder: Path, seconds: float, n_blocks: int) -> tuple[int, bool, str]:
    """One kill after ``seconds``: acknowledged samples lost, whether the file was recovered whole, its state."""
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    path = folder / "run.h5"
    child = context.Process(target=record, args=(path, send, n_blocks))
    child.start()
    send.close()
    safe = receive.recv()
    time.sleep(seconds)
    os.kill(child.pid or 0, signal.SIGKILL)
    child.join()
    while True:
        try:
            safe = receive.recv()
        except EOFError:
            break
    state = verify(path).state
    if state == "incomplete":
        try:
            path = recover(path).path
        except InputError:
            return safe, safe == 0, state  # nothing had been acknowledged: nothing to recover
    whole = verify(path).state in ("complete", "stopped")
    with open_recording(path) as recording:
        n = recording.n_samples
        same = all(
            np.array_equal(recording.codes(name), content(0, n)[:, i]) for i, name in enumerate(recording.channels)
        )
    return max(safe - n, 0), whole and same, state


def main() -> None:
    """Run the trials and print what was lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--blocks", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    states: dict[str, int] = {}
    lost = recovered = 0
    began = time.perf_counter()
    for _ in range(options.trials):
        with tempfile.TemporaryDirectory() as folder:
            n_blocks = int(rng.integers(20, options.blocks))
            missing, whole, state = trial(Path(folder), float(rng.uniform(0.0, 0.25)), n_blocks)
        lost += missing
        recovered += whole
        states[state] = states.get(state, 0) + 1
    print(f"trials {options.trials}, acknowledged samples lost {lost}, files recovered whole {recovered}")
    print(f"states found after the kill: {states}; {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
