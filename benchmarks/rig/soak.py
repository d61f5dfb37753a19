"""Half an hour of a paced run as an operator has it: memory, processor share, samples.

    python -m benchmarks.rig.soak --minutes 30

The simulated rig is paced to the clock, so that all that a real run does happens at its time: closed loop, interlock,
recorder in a process of its own. Memory is the resident size of this process and of the recorder, every few seconds.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from bench.jobs.run_ramp import record
from bench.profiles.find import load
from daq.recording import verify
from rig.backends.simulated import SimulatedBackend
from rig.profile import ControlTable, Profile
from rig.programme.ramp import plan
from rig.sim.scenario import Scenario

EVERY_S = 5.0
PAGE_MB = 4096 / 1e6


def resident_mb(pid: int) -> float:
    """Resident size of a process (Linux)."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * PAGE_MB


class Watch(threading.Thread):
    """Notes the memory of this process and its children until told to stop."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.rows: list[tuple[float, float, float]] = []
        self.over = threading.Event()

    def run(self) -> None:
        """Look every few seconds."""
        while not self.over.wait(EVERY_S):
            pids = [child.pid for child in multiprocessing.active_children() if child.pid is not None]
            try:
                self.rows.append((time.monotonic(), resident_mb(os.getpid()), sum(map(resident_mb, pids))))
            except OSError:  # a child ended between the two looks
                continue


def lasting(minutes: float) -> Profile:
    """The shipped profile under control, with as many steps as fill the time."""
    profile, _ = load("simulated")
    cycles = 60.0 * minutes * profile.forcing.frequency_hz
    hold = 200
    gammas = tuple(float(g) for g in np.resize(np.linspace(0.4, 2.6, 23), max(1, round(cycles / (hold + 30)))))
    ramp = profile.ramp.model_copy(update={"gamma": gammas, "order": None, "hold_cycles": hold})
    return profile.model_copy(update={"ramp": ramp, "control": ControlTable()})


def main() -> None:
    """Run and say what it took."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    options = parser.parse_args()
    profile, watch = lasting(options.minutes), Watch()
    rig = SimulatedBackend(profile.sampling.rate_hz, Scenario("ideal"), 1, real_time=True)
    print(f"{plan(profile).n_samples / rig.rate_hz / 60:.1f} min planned, settling as it comes", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "soak.h5"
        watch.start()
        began, cpu = time.monotonic(), time.process_time()
        summary = record(profile, "", rig, path, quiet=True, paced=True)
        wall, own = time.monotonic() - began, time.process_time() - cpu
        watch.over.set()
        report, size = verify(path), path.stat().st_size
    children = os.times()
    at = np.array(watch.rows)
    print(
        f"{summary.how} {summary.why}: {summary.n_samples} samples, {summary.lost_samples} lost, in {wall:.0f} s; "
        f"{report.state}{', suspect' if report.suspect else ''}, {size / 1e6:.0f} MB"
    )
    shares = 100 * own / wall, 100 * (children[2] + children[3]) / wall
    print(f"processor: run {shares[0]:.1f} %, recorder {shares[1]:.1f} % of a core (its closing included)")
    ended = began + summary.n_samples / rig.rate_hz  # afterwards the recorder writes the columns
    whole = at[(at[:, 2] > 0) & (at[:, 0] > began + 30) & (at[:, 0] < ended)]
    for name, column in (("run", 1), ("recorder", 2)):
        slope = np.polyfit((whole[:, 0] - began) / 60.0, whole[:, column], 1)[0] if len(whole) > 2 else np.nan
        quarter = max(1, len(whole) // 4)
        first, last = whole[:quarter, column].mean(), whole[-quarter:, column].mean()
        print(
            f"memory of the {name}: {first:.1f} MB in the first quarter, {last:.1f} MB in the last, at most "
            f"{whole[:, column].max():.1f} MB, {slope:+.3f} MB a minute; {at[:, column].max():.1f} MB while closing"
        )


if __name__ == "__main__":
    main()
