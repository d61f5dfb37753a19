"""Cost of a parameter point at 1e3, 1e4 and 1e5 points, and what a second worker brings.

Run: ``python -m benchmarks.model.ensemble [--points 100000] [--dask]``. Prints one table; wall times of whole runs into
HDF5.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from model.surveys import ensemble
from model.surveys.ensemble import Axis, Job


def job(points: int, *, rough: bool) -> Job:
    """c = 1, gamma from 0.5 to 4; with friction 0 to 0.3 and restitution 0 to 0.6 on ten by ten axes."""
    if not rough:
        return Job(ratio=1, gammas=tuple(np.linspace(0.5, 4.0, points)), keep=16)
    axes = (
        Axis("coulomb_friction.mu", tuple(np.linspace(0.0, 0.3, 10))),
        Axis("restitution.e0", tuple(np.linspace(0.0, 0.6, 10))),
    )
    return Job(ratio=1, gammas=tuple(np.linspace(0.5, 4.0, points // 100)), axes=axes, keep=16)


def seconds(work: Job, folder: Path, **options: object) -> float:
    """Wall time of one run."""
    path = folder / f"{time.monotonic_ns()}.h5"
    began = time.perf_counter()
    ensemble.run(work, path, **options)  # type: ignore[arg-type]
    return time.perf_counter() - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=100_000, help="of the largest job")
    parser.add_argument("--dask", action="store_true", help="also on a local Dask cluster")
    options = parser.parse_args()
    print(f"{'ball':<24}{'points':>10}{'workers':>9}{'seconds':>10}{'us a point':>12}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for rough in (False, True):
            label = "friction, restitution" if rough else "ideal"
            seconds(job(1000, rough=rough), folder)  # compiled and cached before anything is timed
            for points in (1000, 10_000, options.points):
                for workers in (1, 2):
                    took = seconds(job(points, rough=rough), folder, workers=workers)
                    print(f"{label:<24}{points:>10}{workers:>9}{took:>10.2f}{1e6 * took / points:>12.1f}")
            if options.dask:
                took = seconds(job(options.points, rough=rough), folder, workers=2, cluster="local")
                print(f"{label:<24}{options.points:>10}{'2 Dask':>9}{took:>10.2f}{1e6 * took / options.points:>12.1f}")


if __name__ == "__main__":
    main()
