"""Job J in a process of its own, kernels kept: ``python -m benchmarks.model.whole_process [--before TREE]``.

Processor seconds of a process that draws J's three diagrams (`benchmarks.model.roofline.GRIDS`) and nothing else,
beside those of one that imports NumPy alone, or numba; with ``--before`` another tree of this software in turn.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path

from benchmarks.spent import processor_seconds

JOB = """
import numpy as np
from model.orbits.exact_ball import IdealBall
from model.surveys.diagram import diagram
from model.tones import Forcing

for c, first in ((1, 0.55), (2, 0.25), (3, 0.12)):
    diagram(IdealBall(Forcing.superposition(c)), np.linspace(first, 6, 2000))
"""
ALONE = {"import numpy": "import numpy", "import numba": "import numba"}


def main() -> None:
    """Print a line a process: fastest and median."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, help="another tree of this software, in turn")
    parser.add_argument("--rounds", type=int, default=10)
    given = parser.parse_args()
    own = Path(__file__).resolve().parents[2]
    trees = {"J now": own} if given.before is None else {"J before": given.before.resolve(), "J now": own}
    with tempfile.TemporaryDirectory() as folder:
        jobs = {name: (JOB, [], tree, Path(folder, name)) for name, tree in trees.items()}
        jobs |= {name: (code, [], own, Path(folder)) for name, code in ALONE.items()}
        for job in jobs.values():
            job[-1].mkdir(exist_ok=True)
            processor_seconds(*job)  # compiles
        found: dict[str, list[float]] = {}
        for _ in range(given.rounds):
            for name, job in jobs.items():
                found.setdefault(name, []).append(processor_seconds(*job)[0])
    for name, times in found.items():
        print(f"{name:<13} {min(times):.2f} s, median {statistics.median(times):.2f}")
    if given.before is not None:
        ratios = [now / before for before, now in zip(found["J before"], found["J now"], strict=True)]
        print(f"now / before  {statistics.median(ratios):.2f}")


if __name__ == "__main__":
    main()
