"""The first minute: `bench demo` with an empty folder of kernels, and again with a full one.

    python -m benchmarks.bench.cold_start [--against PATH] [--kernels 20]

Processor seconds of all threads of the process, and wall seconds. `--against` names another tree of this software,
measured first, in the same run. Then the kernels that take longest to compile, each with the line that called for it.
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

from benchmarks.spent import processor_seconds

GOALS_S = {"cold": 45.0, "warm": 15.0, "bench --help": 0.15}
DEMO = "import sys; from bench.cli import main; sys.argv = ['bench', *sys.argv[1:]]; main()"


def compiled(out: Path) -> None:
    """Run a demo in this process, and write what was compiled as JSON rows: seconds, function, caller."""
    import traceback

    from numba.core import event

    rows: list[tuple[float, str, str]] = []
    inside: list[float] = []

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            inside.append(time.thread_time())

        def on_end(self, ended: Any) -> None:
            took, function = time.thread_time() - inside.pop(), ended.data["dispatcher"].py_func
            if not inside:  # what it calls is part of it
                ours = [f for f in traceback.extract_stack() if Path(f.filename).parts[-2:-1] != ("kernels",)]
                here = next(f for f in reversed(ours) if "numba" not in f.filename and f.filename != __file__)
                caller = f"{Path(here.filename).name}:{here.lineno}"
                rows.append((took, f"{function.__module__}.{function.__name__}", caller))

    event.register("numba:compile", Listener())
    from bench.cli import app

    app(["demo", "--out", str(out / "demo")], prog_name="bench", standalone_mode=False)
    (out / "rows.json").write_text(json.dumps(rows), encoding="utf-8")


def table(tree: Path, most: int) -> None:
    """Print the kernels that take longest to compile."""
    with tempfile.TemporaryDirectory() as name:
        environment = os.environ | {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": name}
        command = [sys.executable, __file__, "--compiled", name]
        subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        rows = json.loads((Path(name) / "rows.json").read_text(encoding="utf-8"))
    print(f"{len(rows)} kernels, {sum(row[0] for row in rows):.1f} s")
    for took, function, caller in sorted(rows, reverse=True)[:most]:
        print(f"{took:7.2f} s  {function:<60} {caller}")


def main() -> None:
    """Print a line a call, the state before beside the state after."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="another tree of this software, measured first")
    parser.add_argument("--kernels", type=int, default=0, help="list so many kernels by the time they take to compile")
    parser.add_argument("--compiled", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.compiled is not None:
        compiled(given.compiled)
        return
    own = Path(__file__).resolve().parents[2]
    trees = {"now": own} if given.against is None else {"before": given.against.resolve(), "now": own}
    found: dict[str, dict[str, float]] = {}
    for which, tree in trees.items():
        with tempfile.TemporaryDirectory() as name:
            calls = {"cold": ["demo", "--out", "cold"], "warm": ["demo", "--out", "warm"], "bench --help": ["--help"]}
            for call, arguments in calls.items():
                spent, wall = processor_seconds(DEMO, arguments, tree, Path(name))
                found.setdefault(call, {})[which] = spent
                goal = GOALS_S[call]
                print(f"{which:<7} {call:<13} {spent:6.2f} s processor, {wall:6.1f} s wall (goal {goal:g})", flush=True)
    if given.against is not None:
        print("before / now:", ", ".join(f"{call} {row['before'] / row['now']:.2f}" for call, row in found.items()))
    if given.kernels:
        for which, tree in trees.items():
            print(f"{which}:")
            table(tree, given.kernels)


if __name__ == "__main__":
    main()
