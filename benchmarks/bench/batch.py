"""`bench batch` on a Dask cluster: time with one worker and with more, and the table after a worker was killed.

    python -m benchmarks.bench.batch --recordings 12 --workers 1 2 4 --kill

A cluster is started and its workers are warmed by one recording each before the clock begins. Speed-up is the ratio of
times by the clock, of the same recordings on the same machine; a worker's part is the speed-up over the number of
workers. Processor seconds are those of the examinations themselves, and what of the workers' time they are says whether
the cores were free: a machine with fewer free cores than workers gives no more speed-up than it has.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil  # type: ignore[import-untyped]

import shakerbench as sb
from bench.batch import PARTS, Batch, Row, examine, run_batch
from daq.files.disk import Journal

RAMP = {"ramp.gamma": [0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0], "ramp.settle_cycles": 6, "ramp.hold_cycles": 12}


def recordings(folder: Path, count: int) -> list[Path]:
    """Short runs of the simulated rig, every other one with friction."""
    profile = sb.load_profile("simulated").with_values(RAMP)
    out = []
    for i in range(count):
        out.append(folder / f"run{i:02d}.h5")
        sb.run(profile, out[-1], seed=400 + i, scenario="friction" if i % 2 else None)
    return out


def kill_one(cluster: Any, client: Any) -> None:
    """End the process of a worker that has work."""
    busy = next(address for address, tasks in client.processing().items() if tasks)
    psutil.Process(next(x.pid for x in cluster.workers.values() if x.worker_address == busy)).kill()


def on_cluster(paths: list[Path], workers: int, folder: Path, *, kill: bool = False) -> tuple[list[Row], float]:
    """Rows, and seconds by the clock; with ``kill`` a worker is killed after a third of the rows."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        client.run(examine, paths[0], PARTS)  # compiled code is loaded
        left = [len(paths) // 3]

        def told(done: int, total: int, path: Path, row: Row) -> None:
            left[0] -= 1
            if kill and left[0] == 0:
                kill_one(cluster, client)

        began = time.perf_counter()
        journal = Journal(folder / f"{workers}-{kill}.rows")
        rows = run_batch(Batch(paths, PARTS), journal, cluster=cluster.scheduler_address, told=told)
        return rows, time.perf_counter() - began


def table(rows: list[Row]) -> list[Row]:
    """What the rows found, processor seconds apart."""
    return [{k: x for k, x in row.items() if k != "processor_s"} for row in rows]


def main() -> None:
    """Print a line for each number of workers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=12)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--kill", action="store_true", help="with the most workers again, one of them killed")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = recordings(folder, args.recordings)
        print(f"{len(paths)} recordings, {os.cpu_count()} cores, load {psutil.getloadavg()[0]:.1f} before\n")
        print("| workers | clock, s | processor, s | speed-up | for each worker | workers computing | table |")
        print("|---|---|---|---|---|---|---|")
        first: tuple[list[Row], float] | None = None
        cases = [(n, False) for n in args.workers] + ([(max(args.workers), True)] if args.kill else [])
        for workers, kill in cases:
            rows, seconds = on_cluster(paths, workers, folder, kill=kill)
            first = first or (rows, seconds)
            processor_s = sum(row["processor_s"] for row in rows)
            same = "the same" if table(rows) == table(first[0]) else "DIFFERS"
            words = f"{workers}, one killed" if kill else str(workers)
            gain, busy = first[1] / seconds, processor_s / (seconds * workers)
            figures = f"{seconds:.1f} | {processor_s:.1f} | {gain:.2f} | {gain / workers:.2f} | {busy:.0%}"
            print(f"| {words} | {figures} | {same} |", flush=True)


if __name__ == "__main__":
    main()
