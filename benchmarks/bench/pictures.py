"""What the pictures and the report of a recording cost, in the process that draws them.

    python -m benchmarks.bench.pictures RECORDING [--against PATH] [--rounds 5]

Processor seconds of the nine pictures of a `bench demo` and of its report page, each time in a new process, with
the imports of matplotlib: the first number. The second is the same again in that process. `--against` names another
tree of this software, which takes turns.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def drawn(recording: Path, verdict: Path) -> None:
    """Draw everything twice in this process, and print both processor times."""
    import bench.commands.demo  # noqa: F401 - what a demo has loaded by then is loaded before the clock starts
    from analysis.flights.assemble import flights_of
    from analysis.flights.compare import compare
    from analysis.loop.result import load_verdict
    from bench.jobs.report import draw
    from daq.recording import open_recording

    loop = load_verdict(verdict)
    with open_recording(recording) as opened, tempfile.TemporaryDirectory() as name:
        table = flights_of(opened)
        held = compare(table, opened.setup, steps_table=opened.steps)
        for _ in range(2):
            began = time.process_time()
            from analysis.report.page import write_report

            draw(opened, table, Path(name) / "pictures", held)
            write_report(loop, Path(name) / "report")
            print(time.process_time() - began)


def main() -> None:
    """Print a line a round and tree, and the medians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--against", type=Path, help="another tree of this software")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--verdict", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.verdict is not None:
        drawn(given.recording, given.verdict)
        return
    from analysis.loop.close_loop import close_loop
    from analysis.loop.result import save_verdict

    trees = {"now": Path(__file__).resolve().parents[2]}
    if given.against is not None:
        trees = {"before": given.against.resolve()} | trees
    spent: dict[str, list[tuple[float, ...]]] = {which: [] for which in trees}
    with tempfile.TemporaryDirectory() as name:
        verdict = Path(name) / "verdict"
        save_verdict(close_loop([given.recording]), verdict)
        for _ in range(given.rounds):
            for which, tree in trees.items():
                command = [sys.executable, __file__, str(given.recording.resolve()), "--verdict", str(verdict)]
                told = subprocess.run(
                    command, check=True, env=os.environ | {"PYTHONPATH": str(tree)}, cwd=name, stdout=subprocess.PIPE
                )
                spent[which].append(tuple(map(float, told.stdout.split())))
                print(which, *(f"{x:.2f}" for x in spent[which][-1]), flush=True)
    for which, rows in spent.items():
        columns = list(zip(*rows, strict=True))
        medians = " ".join(f"{statistics.median(x):.2f}" for x in columns)
        print(f"{which:<7} median {medians}; fewest", *(f"{min(x):.2f}" for x in columns))


if __name__ == "__main__":
    main()
