"""Reprocessing a recording: time against the raw read of its file and an obvious whole-file script, and memory.

    python -m benchmarks.analysis.reprocess [--minutes 10 60] [--repeats 3] [--against PATH]

`--against` names another tree of this software: its reprocessing is measured on the same files. Times are processor
seconds.

Goals: at most 2.0 times the time h5py takes to read all channels, at least 30 times faster than the obvious script,
at most 64 MB of memory however long the recording. Every figure is the fastest of the repeats, each in a process of
its own (compiled code cached, imports not counted); memory is the peak above that of the process after its imports.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

RATE_HZ = 20000.0
FREQUENCY_HZ = 25.37
STEP_CYCLES = 100
SETTLE_CYCLES = 20
WARM_MINUTES = 2.0  # up to gamma 1.8: without flights, what times and flags them would be loaded while it is measured
GOALS = {"ratio_to_raw": 2.0, "times_faster": 30.0, "memory_mb": 64.0}


def record(path: Path, minutes: float) -> None:
    """An up-and-down ramp on the ideal simulated rig, gamma 0.4 to 2.6, as long as wanted."""
    import numpy as np

    from daq.files.tables import Block, step_row
    from daq.recording.writer import RecordingWriter
    from daq.setup.setup import Setup
    from rig.profile import load_profile
    from rig.sim.plant import Plant
    from rig.sim.scenario import Scenario

    profile, text = load_profile(Path(__file__).parents[2] / "rig_profiles" / "simulated.toml")
    setup = Setup.model_validate(profile.model_dump(include=set(Setup.model_fields)))
    plant = Plant(Scenario("ideal"), RATE_HZ, np.random.default_rng(1))
    per_step = round(STEP_CYCLES * RATE_HZ / FREQUENCY_HZ)
    up = np.linspace(0.4, 2.6, 45)
    gammas = np.tile(np.concatenate([up, up[::-1]]), 100)[: int(minutes * 60.0 * RATE_HZ / per_step)]
    with_scale = {"profile_text": text, "channels": plant.channels, "backend": "simulated", "simulated": True}
    writer = RecordingWriter(path, setup, **with_scale)
    last, fade = 0.0, round(2 * RATE_HZ / FREQUENCY_HZ)
    for k, gamma in enumerate(gammas):
        n = k * per_step + np.arange(per_step)
        rise = np.minimum(np.arange(per_step) / fade, 1.0)
        size = last + (gamma - last) * 0.5 * (1.0 - np.cos(np.pi * rise))
        drive = -size * np.sin(2.0 * np.pi * ((FREQUENCY_HZ * n / RATE_HZ) % 1.0))
        writer.append(Block(k * per_step, plant.exchange(drive)))
        writer.mark_step(
            step_row(
                {
                    "first_sample": k * per_step,
                    "n_samples": per_step,
                    "settle_samples": per_step * SETTLE_CYCLES // STEP_CYCLES,
                    "gamma": gamma,
                    "frequency_hz": FREQUENCY_HZ,
                    "ratio": 1,
                    "cycles": STEP_CYCLES,
                    "settle_cycles": SETTLE_CYCLES,
                    "fade_samples": fade,
                }
            )[0]
        )
        last = float(gamma)
    writer.close()


def raw_read(path: Path) -> None:
    """Every channel of the file by plain h5py, in pieces."""
    import h5py
    import hdf5plugin  # noqa: F401 (registers the filter)

    with h5py.File(path) as file:
        n = file["continuity"].shape[0]
        for start in range(0, n, 1 << 18):
            for name in ("continuity", "accelerometer", "drive", "timestamp"):
                _ = file[name][start : start + (1 << 18)]


def reprocess(path: Path) -> None:
    """What is measured."""
    from analysis.flights.assemble import flights_of
    from daq.recording import open_recording

    with open_recording(path) as recording:
        flights_of(recording)


def obvious(path: Path) -> None:
    """The script a student would write: everything in memory, thresholds, a zero-phase filter, a lock-in by exp()."""
    import h5py
    import hdf5plugin  # noqa: F401 (registers the filter)
    import numpy as np
    from scipy.signal import butter, filtfilt, find_peaks

    with h5py.File(path) as file:
        names = ("continuity", "accelerometer", "drive")
        columns = {name: file[name][:] * float(file[name].attrs["scale_factor"]) for name in names}
        t = file["timestamp"][:] * 1e-9
        steps = {name: file["steps"][name][:] for name in ("first_sample", "n_samples")}
    open_now = columns["continuity"] > 2.5
    edges = np.flatnonzero(np.diff(open_now.astype(np.int8)))
    _ = t[edges]
    b, a = butter(4, 500.0, fs=RATE_HZ)
    smooth = filtfilt(b, a, columns["accelerometer"])
    find_peaks(np.abs(columns["accelerometer"] - smooth), height=0.02, distance=20)
    turn = np.exp(-2j * np.pi * FREQUENCY_HZ * t)
    for first, n in zip(steps["first_sample"], steps["n_samples"], strict=True):
        for name in ("accelerometer", "drive"):
            _ = 2.0 * np.mean(columns[name][first : first + n] * turn[first : first + n])


JOBS = {"raw": raw_read, "reprocess": reprocess, "obvious": obvious}


def child(job: str, path: Path, warm: Path) -> None:
    """Run one job in this process: first on a short recording (imports, compiled code), then timed."""
    JOBS[job](warm)
    before = _peak_mb(forget=True)
    started = time.process_time()
    JOBS[job](path)
    print(json.dumps({"seconds": time.process_time() - started, "memory_mb": _peak_mb() - before}))


def _peak_mb(*, forget: bool = False) -> float:
    """Peak resident memory of this process since it was last told to forget it; NaN where the system does not tell."""
    status, reset = Path("/proc/self/status"), Path("/proc/self/clear_refs")
    if not status.exists():
        return float("nan")
    if forget:
        reset.write_text("5")
    line = next(row for row in status.read_text().splitlines() if row.startswith("VmHWM"))
    return float(line.split()[1]) / 1024.0


def best(job: str, path: Path, warm: Path, repeats: int, tree: Path | None = None) -> dict[str, float]:
    """The fastest of some runs, each in its own process; of the software in ``tree`` where one is given."""
    environment = os.environ if tree is None else os.environ | {"PYTHONPATH": str(tree.resolve())}
    runs: list[dict[str, float]] = []
    for _ in range(repeats):
        command = [sys.executable, __file__, "--child", job, str(path), str(warm)]
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
        runs.append(json.loads(done.stdout))
    return min(runs, key=lambda run: run["seconds"])


def main() -> None:
    """Print one row a length, with the goals beside."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, nargs="+", default=[10.0, 60.0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--against", type=Path, help="another tree of this software, measured beside")
    parser.add_argument("--child", nargs=3, metavar=("JOB", "PATH", "WARM"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child(given.child[0], Path(given.child[1]), Path(given.child[2]))
        return
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        warm = Path(folder) / "warm.h5"
        record(warm, WARM_MINUTES)
        for minutes in given.minutes:
            path = Path(folder) / f"{minutes:g}.h5"
            record(path, minutes)
            found = {job: best(job, path, warm, given.repeats if job != "obvious" else 1) for job in JOBS}
            ours = found["reprocess"]
            if given.against is not None:
                found["before"] = best("reprocess", path, warm, given.repeats, given.against)
                found["before"]["ratio_to_raw"] = found["before"]["seconds"] / found["raw"]["seconds"]
            rows.append(
                {
                    "minutes": minutes,
                    "file_mb": path.stat().st_size / 1e6,
                    **{f"{job}_s": run["seconds"] for job, run in found.items()},
                    "ratio_to_raw": ours["seconds"] / found["raw"]["seconds"],
                    "times_faster": found["obvious"]["seconds"] / ours["seconds"],
                    "memory_mb": ours["memory_mb"],
                    "before": found.get("before"),
                    "obvious_memory_mb": found["obvious"]["memory_mb"],
                }
            )
            path.unlink()
            print(json.dumps(rows[-1], indent=1))
    print("goals:", json.dumps(GOALS))


if __name__ == "__main__":
    main()
