"""Error rate of the verdict so far: ``python -m benchmarks.bench.live_verdict [--runs 200] [--c 1]``.

Drives simulated runs at full speed and looks at each recording after every step as the live page does, with the samples
that it has by then. Prints JSON: runs accused at any look, and the step at which each accused run was accused first.
"""

from __future__ import annotations

import argparse
import json
import time
from multiprocessing import Pool
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from bench.jobs.run_ramp import make_backend, record
from bench.live.analyst import cut_to, reduce_run, verdict_of
from bench.profiles.find import load
from daq.recording import open_recording

PROFILES = {1: "simulated", 2: "c2"}


def accused(c: int, friction: float, seed: int) -> list[int]:
    """Steps (from 1) after which the verdict so far of one run is "more than noise"."""
    profile, text = load(PROFILES[c])
    found = []
    with TemporaryDirectory() as folder:
        path, hidden = Path(folder) / "run.h5", Path(folder) / "hidden.toml"
        size = f"mu_up = {friction}\nmu_down = {friction}\n"
        hidden.write_text(
            'name = "hidden"\n' + f"[effects.coulomb_friction]\n{size}" * (friction > 0.0), encoding="utf-8"
        )
        record(profile, text, make_backend(profile, scenario=hidden, seed=seed), path, quiet=True)
        with open_recording(path) as recording:
            ends = (recording.steps["first_sample"] + recording.steps["n_samples"]).tolist()
        for k, end in enumerate(ends):
            with open_recording(path) as recording:
                cut_to(recording, end)
                seen = reduce_run(recording, {})[1]
            if not verdict_of(seen, k, k + 1, ())["within"]:
                found.append(k + 1)
    return found


def main() -> None:
    """All runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in (("runs", 200), ("c", 1), ("first-seed", 0), ("workers", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--friction", type=float, default=0.0, help="hidden dry friction; 0: an ideal rig")
    asked = parser.parse_args()
    began = time.monotonic()
    with Pool(asked.workers) as pool:
        seeds = range(asked.first_seed, asked.first_seed + asked.runs)
        found = pool.starmap(accused, [(asked.c, asked.friction, seed) for seed in seeds], chunksize=1)
    first = [steps[0] for steps in found if steps]
    answer = {
        "friction": asked.friction, "c": asked.c, "runs": asked.runs, "runs_accused": len(first), "first_steps": first,
        "median_first_step": float(np.median([steps[0] if steps else np.inf for steps in found])),
        "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
