"""Simulate the whole bench, seed by seed, and say what was broken.

    python -m benchmarks.bench_simulation --seeds 0:1000 --minutes 1
    python -m benchmarks.bench_simulation --plan '{...}'
    python -m benchmarks.bench_simulation --mutant each --plans tests/benchmarks/simulated_plans.txt --seeds 0:5000

A seed that fails is printed with its plan, shrunk to the fewest faults that still break something.
"""

from __future__ import annotations

import argparse
import gc
import logging
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from benchmarks.bench_simulation.disk import Disk, with_library
from benchmarks.bench_simulation.mutants import MUTANTS, mutate

MODULE = "benchmarks.bench_simulation"


def main(arguments: list[str]) -> int:
    """Simulate; the number of seeds that broke something."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:100", help="first and one past the last")
    parser.add_argument("--minutes", type=float, default=1.0, help="of the bench's own time, of a ramp")
    parser.add_argument("--plan", help="one plan, as a failure prints it")
    parser.add_argument("--plans", type=Path, help="file of plans, one a line (# words); of a mutant, before the seeds")
    parser.add_argument(
        "--only", help="plans with a fault of this kind (for an error put in: of the kind that shows it)"
    )
    parser.add_argument("--mutant", choices=["each", *sorted(MUTANTS)], help="with this error in the product")
    parser.add_argument("--twice", type=int, default=10, help="every so many seeds is run twice and compared")
    parser.add_argument("--most", type=int, default=10, help="failures after which it ends")
    given = parser.parse_args(arguments)
    if given.mutant == "each":
        return sum(not _is_found(mutant, arguments) for mutant in MUTANTS)
    with_library(MODULE, arguments)
    only = given.only or (mutate(given.mutant) if given.mutant else "")
    from benchmarks.bench_simulation.judge import simulate, simulate_here
    from benchmarks.bench_simulation.plan import Plan, draw
    from benchmarks.bench_simulation.shrink import shrunk

    logging.disable()
    disk = Disk()
    try:
        first, last = (int(part) for part in given.seeds.split(":"))
        plans: Iterable[Plan] = (draw(seed, given.minutes) for seed in range(first, last))
        if only:
            plans = (plan for plan in plans if any(fault.kind == only for fault in plan.faults))
        if given.plan or given.plans:
            lines = [given.plan] if given.plan else given.plans.read_text(encoding="utf-8").splitlines()
            written = [Plan.from_json(line) for line in lines if not line.startswith("#")]
            plans = chain(written, plans) if given.mutant else written
        simulate_here(draw(0), disk)  # compiled before the clock runs
        gc.collect()
        gc.freeze()
        began, lived_s, n, failed = _processor_s(), 0.0, 0, 0
        faults: Counter[str] = Counter()
        for plan in plans:
            broken, print_, seconds = simulate(plan, disk)
            if given.twice and plan.seed % given.twice == 0 and simulate(plan, disk)[1] != print_:
                broken = [*broken, "the same seed gave other bytes"]
            n, lived_s = n + 1, lived_s + seconds
            faults.update(fault.kind for fault in plan.faults)
            if broken:
                failed += 1
                small, left = shrunk(plan, broken, disk)
                print(f"seed {plan.seed}: {'; '.join(left)}\n  --plan '{small.to_json()}'", flush=True)
                if failed >= given.most:
                    break
        spent = _processor_s() - began
        print(f"{n} runs, {failed} broke something; {sum(faults.values())} faults of {len(faults)} kinds")
        print(f"{spent:.1f} s of processor time, {1e3 * spent / max(n, 1):.0f} ms a run, {lived_s / 3600:.1f} h lived, "
              f"{lived_s / spent:.0f} times real time")  # fmt: skip
        return failed
    finally:
        disk.close()


def _is_found(mutant: str, arguments: list[str]) -> bool:
    """Whether a process of its own finds an error; the plan that shows it is printed."""
    command = [sys.executable, "-m", MODULE, *arguments, "--mutant", mutant, "--most", "1", "--twice", "0"]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    print(f"{mutant}: {'' if 'seed ' in said else 'not found, '}{said}", flush=True)
    return "seed " in said


def _processor_s() -> float:
    """Of this process and those that it started."""
    return time.process_time() + os.times().children_user + os.times().children_system


if __name__ == "__main__":
    status = min(main(sys.argv[1:]), 1)
    sys.stdout.flush()
    os._exit(status)  # HDF5 would close what killed processes held
